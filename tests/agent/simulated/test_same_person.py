"""Telling people apart by place and looks: what a name holds on to, and what it cannot."""

import pytest

from jrdb_avr.agent.policy.explorer import Look, Sighting
from jrdb_avr.agent.simulated.same_person import told_apart
from jrdb_avr.schema.markers import FRAME_COLORS, Mark
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, angle_of_column, crop_left

COLORS = len(FRAME_COLORS)
PIXELS = WIDTH / 360


def look(frame, *people, angle=180.0, name=""):
    """A crop; people as (identity, panorama angle) with any fields of marks and "h"."""
    left = int(crop_left(angle))
    sightings = []
    for identity, at, fields in people:
        h = fields.get("h", 200)
        mark = Mark(identity, **{key: value for key, value in fields.items() if key != "h"})
        x = (at * PIXELS - left) % WIDTH - h / 6
        sightings.append(Sighting(frame, mark, Box(x, 100, h / 3, h), True, float(angle_of_column(left + x + h / 6))))
    return Look(frame, angle, tuple(sightings), name=name, left=left, size=(CROP, CROP))


def names(looks, **more):
    return [[seen.identity for seen in one.sightings] for one in told_apart(looks, **more)]


WOMAN, MAN = {"gender": "female", "age": "young adulthood"}, {"gender": "male", "age": "young adulthood"}


def test_who_stays_in_place_keeps_the_name_and_others_have_others():
    first, second, third = names(
        [
            look(0, (3, 175, WOMAN), (4, 190, MAN)),
            look(15, (3, 176, WOMAN), (4, 189, MAN)),
            look(15, (4, 189, MAN), angle=195.0),
        ]
    )
    assert first == second and third == second[1:]
    assert len(set(first)) == 2


def test_one_who_left_is_taken_for_another_in_the_same_place_with_the_same_looks():
    """An identity would tell these two apart."""
    (first,), (second,) = names([look(0, (3, 175, WOMAN)), look(30, (3 + COLORS, 176, WOMAN))])
    assert first == second


@pytest.mark.parametrize("other", [(3, 90, WOMAN), (4, 177, MAN), (3, 175, {**WOMAN, "h": 60})])
def test_another_place_or_other_looks_are_another_person(other):
    shown = [look(0, (3, 175, WOMAN)), look(0, other, angle=other[1] + 5.0)]
    assert len({name for one in names(shown) for name in one}) == 2


def test_who_was_written_down_in_a_picture_has_that_name():
    shown = [look(0, (3, 175, WOMAN), (4, 190, MAN), name="o4")]
    box = shown[0].sightings[1].box
    ((first, second),) = names(shown, written={"o4": {804: box}, "o9": {999: box}})
    assert second == 804 and first > 999
