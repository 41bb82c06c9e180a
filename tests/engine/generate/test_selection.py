"""What a selection counts by: bins of answers and waits, near-duplicates, and the caps of a person."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.generate.asked import Candidate, doublings
from jrdb_avr.engine.generate.bins import answer_bin
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.schema.rules import Rules


def admitted(rules, *candidates):
    """The candidates that are chosen if each is that may be, one after the other."""
    taken, chosen = Taken(rules), []
    for one in candidates:
        if taken.admits(one):
            chosen.append(one)
            taken.add(one)
    return chosen


def about(template, *read, event=None, track=1):
    return Candidate("", template, "s", track, "", read, "", frozenset(), (), event)


def test_a_person_is_in_no_more_questions_of_all_templates_than_the_cap():
    every = [about(template, 200 * number) for template in ("change", "distance") for number in range(3)]
    for cap, most in ((24, 6), (3, 3)):
        assert len(admitted(Rules(max_per_person_in_all=cap), *every)) == most


def test_questions_that_are_near_at_one_time_only_are_both_chosen():
    every = [about("presence", *read) for read in ((100, 300), (100, 600), (400, 600))]
    assert admitted(Rules(), *every, about("presence", 175, 525)) == every


def test_a_start_and_a_span_of_one_segment_are_not_both_chosen():
    start, span = about("start", 100, event="start 7"), about("span", 100, 160, event="start 7")
    assert admitted(Rules(), start, span) == [start]
    assert len(admitted(Rules(), start._replace(event="start 8"), span)) == 2


def are_alike(one, other):
    """Whether two questions are of one person, and of one event or, in a template, read at nearly the same times."""
    if one.person != other.person:
        return False
    near = 75 if one.template == "presence" else 30
    same = all(abs(x - y) <= near for x, y in zip(one.asked, other.asked, strict=False))
    return (one.event and one.event == other.event) or (one.template == other.template and same)


SUBJECTS = st.tuples(
    st.sampled_from(["start", "change", "presence"]),
    st.integers(0, 300),
    st.sampled_from(["start 1", "start 2"]),
    st.integers(0, 2),
)


@given(st.lists(SUBJECTS, max_size=60), st.integers(1, 4))
@settings(deadline=None)
def test_each_question_is_chosen_that_is_like_none_and_under_the_cap_of_its_template(drawn, cap):
    kept = []
    every = [
        about(
            name, *((at, at + 90) if name == "presence" else (at,)), event=event if name == "start" else None, track=n
        )
        for name, at, event, n in drawn
    ]
    for one in every:
        own = [other for other in kept if (other.person, other.template) == (one.person, one.template)]
        if len(own) < cap and not any(are_alike(one, other) for other in kept):
            kept.append(one)
    assert admitted(Rules(max_per_person=cap, max_per_person_in_all=99), *every) == kept


@pytest.mark.parametrize(
    ("seconds", "number"),
    [(3, 1), (5.9, 1), (6, 2), (9.9, 2), (10, 3), (14.9, 3), (15, 4), (20.9, 4), (21, 5), (99, 5)],
)
def test_offset_bins(seconds, number):
    frame = round(150 + seconds * 15)
    assert answer_bin("frame", f'{{"frame":{frame}}}', [150], "start") == number
    assert answer_bin("span", f'{{"start_frame":{frame},"end_frame":9999}}', [150], "span") == number


def test_bins_of_gaps_and_doublings_of_waits():
    for seconds, number in {5: 1, 9.9: 1, 10: 2, 20: 3, 39.9: 3, 40: 4, 400: 4}.items():
        assert answer_bin("number", f'{{"value":{seconds}}}', [0], "seconds_between") == number
    assert [doublings(round(s * 15)) for s in (3, 3.9, 4, 7.9, 8, 16)] == [2, 2, 3, 3, 4, 5]
