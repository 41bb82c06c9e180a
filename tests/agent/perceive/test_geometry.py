"""Places derived from boxes: those of the second program, and unknown only where somebody unseen could matter."""

import itertools

import pytest
from environment import examples
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from readings import World, toward

from jrdb_avr.agent.perceive.geometry import (
    CIRCLE,
    DERIVED,
    Arc,
    SeenColumns,
    angle_of,
    at_distance,
    covered,
    deciding_arc,
    first_beside,
    gaps,
    in_sector,
    seen_from,
    standing,
)
from jrdb_avr.engine.rederive.truth import TRUE, UNKNOWN
from jrdb_avr.schema.labels import DISTANCE_WORDS, ROBOT_SECTORS
from jrdb_avr.schema.panorama import WIDTH, Box, clockwise
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, RELATIONS

ALL = (SeenColumns(0, WIDTH),)
PERSON = st.builds(
    Box,
    st.integers(-200, WIDTH).map(float),
    st.sampled_from((10.0, 40.0, 60.0, 61.0)),
    st.sampled_from((50.0, 100.0)),
    st.sampled_from((30.0, 150.0)),
)
PEOPLE = st.lists(PERSON, min_size=2, max_size=6).map(lambda boxes: {f"p{i}": box for i, box in enumerate(boxes)})
# Seldom all round: about half of the circle.
LOOKS = st.lists(st.builds(SeenColumns, st.integers(0, WIDTH - 1), st.sampled_from((480, 480, 1000))), max_size=6)


def fact(value):
    """The second program's value as one of ours."""
    return None if value == UNKNOWN else value == TRUE


def annotated(boxes):
    """The people as the annotations of frame 15, tracks in their order."""
    world = World([0, 15, 30])
    for track, box in enumerate(boxes.values(), start=1):
        world.see(track, [15], x=box.x, y=box.y, w=box.w, h=box.h)
    return world.read()


def related(annotations, relation, boxes, source, target):
    tracks = {name: track for track, name in enumerate(boxes, start=1)}
    return fact(annotations.related(relation, tracks[source], tracks[target], 15))


@given(PEOPLE)
@settings(max_examples=examples(60))
def test_where_all_is_seen_facts_are_those_of_the_second_program(boxes):
    annotations = annotated(boxes)
    for track, (source, box) in enumerate(boxes.items(), start=1):
        for word in ROBOT_SECTORS:
            assert in_sector(angle_of(box), word) == fact(annotations.in_sector(track, word, 15))
        for target in boxes.keys() - {source}:
            for relation in DERIVED:
                ours = standing(relation, boxes, source, ALL)[target]
                assert ours == related(annotations, relation, boxes, source, target), (relation, source, target)


@given(st.floats(0.1, 14))
def test_words_of_distances_are_those_of_the_second_program(metres):
    world = World([0, 15, 30]).see(1, [15], at=(metres, 0.0))
    for word in DISTANCE_WORDS:
        words = world.read().distance_words(1, 15)
        assert at_distance(metres, word) == (word in words and (True if len(words) == 1 else None))


@pytest.mark.slow
@given(PEOPLE, LOOKS, st.sampled_from((FIRST_LEFT, FIRST_RIGHT)))
@settings(max_examples=examples(100))
def test_what_is_certain_of_the_people_seen_is_so_of_all(boxes, looks, relation):
    seen = {name: box for name, box in boxes.items() if inside(looks, angle_of(box))}
    assume(len(seen) >= 2)
    annotations = annotated(boxes)
    for source in seen:
        for target in seen.keys() - {source}:
            ours = standing(relation, seen, source, looks)[target]
            assert ours is None or ours == related(annotations, relation, boxes, source, target)


@given(PEOPLE, LOOKS, st.sampled_from(("left", "right")))
@example({"p0": Box(200, 10, 100, 150), "p1": Box(214, 10, 50, 30)}, [SeenColumns(240, 480)], "right")
@settings(max_examples=examples(100))
def test_unknown_is_only_what_somebody_unseen_could_change(boxes, looks, side):
    reach = [angle_of(box) + turn for box in boxes.values() for turn in (-59.9999, 59.9999)]
    # A part that no look shows may be narrower than the steps.
    edges = [(look.left + side) * 360 / WIDTH for look in looks for side in (-0.001, look.width + 0.001)]
    tried = (*(tick / 8 for tick in range(8 * 360)), *reach, *edges)
    unseen = [angle for angle in tried if not inside(looks, angle)]
    more = [{**boxes, "q": Box(toward(angle), 100.0, 50.0, 150.0)} for angle in unseen]
    for source, target in itertools.permutations(boxes, 2):
        known = first_beside(boxes, source, side, ALL)[target]
        if known is not None and first_beside(boxes, source, side, looks)[target] is None:
            assert any(first_beside(people, source, side, ALL)[target] != known for people in more)


def inside(looks, angle):
    return any((angle / 360 * WIDTH - look.left) % WIDTH < look.width for look in looks)


@given(LOOKS, st.floats(0, 359), st.floats(1, 360))
def test_gaps_and_looks_share_the_arc(looks, start, span):
    arc = Arc(start, span)
    missing = gaps(looks, arc)
    for turned in range(round(span)):
        angle = (start + turned + 0.5) % 360
        if turned + 0.5 < span:
            away = not any(clockwise(gap.start, angle) < gap.span for gap in missing)
            assert inside(looks, angle) == away
    assert covered(looks, arc) == (not missing)


def test_eight_looks_go_round_and_seven_leave_a_gap_over_the_seam():
    looks = [seen_from(angle) for angle in range(0, 360, 45)]
    assert covered(looks)
    (gap,) = gaps(looks[1:], CIRCLE)[1:]
    assert gap.start == pytest.approx(337.979, abs=0.01) and not covered(looks[1:])


def test_the_first_to_the_left_is_unknown_until_the_way_there_is_seen():
    boxes = {"a": Box(toward(10), 100, 50, 150), "b": Box(toward(330), 100, 50, 150)}
    assert first_beside(boxes, "a", "left", [seen_from(10.0)])["b"] is None
    assert first_beside(boxes, "a", "left", [seen_from(10.0), seen_from(335.0)])["b"] is True
    assert first_beside(boxes, "b", "left", [seen_from(10.0), seen_from(335.0)])["a"] is False


def test_the_deciding_arc_is_where_the_target_can_stand():
    source = Box(toward(45), 100, 50, 150)
    assert deciding_arc(FIRST_LEFT, source) == Arc(315.0, 90.0)
    assert deciding_arc("within 90 degrees to the right of (robot view)", source) == Arc(45.0, 90.0)
    assert deciding_arc("conversation", source) == CIRCLE
    assert deciding_arc(FIRST_RIGHT, source).middle == 90.0
    assert {RELATIONS[label].kind for label in DERIVED} == {"first", "window"}
