"""What the marker knows again from the reference agent's graph: looks, marks and events, and what it then writes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.agent.policy.enclosing import BoundedEvent, between, bounded_events
from jrdb_avr.agent.policy.explorer import (
    Sighting,
)
from jrdb_avr.agent.simulated.notes import attribute_of, read_notes
from jrdb_avr.agent.simulated.requests import Request
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.markers import Mark
from jrdb_avr.schema.panorama import Box, center_angle
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time, canonical

GRAPH = """{"observations": [
  {"observation": "o1", "frame_id": "000015", "angle_deg": 180.0},
  {"observation": "o2", "frame_id": "000060", "angle_deg": 0.0},
  {"observation": "o3", "frame_id": "000060", "angle_deg": 40.0}],
 "entities": [
  {"id": "p7", "kind": "person", "node": "a",
   "sightings": [{"observation": "o1", "frame_id": "000015", "angle_deg": 185.0, "box": [1900, 100, 60, 200]},
                 {"observation": "o3", "frame_id": "000060", "angle_deg": 5.0, "box": [22, 100, 60, 200]}],
   "attributes": [{"name": "gender", "value": "female", "observation": "o1"},
                  {"name": "action", "value": "sitting", "frame_id": "000015", "observation": "o1"},
                  {"name": "action", "value": "reading", "frame_id": "000060", "observation": "o3"},
                  {"name": "object", "value": "holding: bag", "frame_id": "000060", "observation": "o3"},
                  {"name": "distance_m", "value": 3.2, "frame_id": "000060", "observation": "o3"}]},
  {"id": "somebody", "kind": "person", "sightings": [], "attributes": []}],
 "relations": [], "missing": []}""".replace("\n", " ")


def asking(action="reading", end=False):
    times = {"t0": Time(frame=15), "t1": Time(event="start", of="a", action=action, after="t0")}
    spec = AnswerSpec(mode="frame", read="start", of="a", at="t1")
    if end:
        times["t2"] = Time(event="end", of="a", action=action, after="t1")
        spec = AnswerSpec(mode="span", read="span", of="a", at=("t1", "t2"))
    return Plan(root="a", target="a", times=times, nodes=(Node(id="a"),), edges=(), answer=spec)


def request(graph=GRAPH, looks=()):
    lines = (f"Plan: {canonical(asking())}", f"Graph: {graph}")
    return Request("", lines, "q", asking(), (), tuple(range(0, 600, 5)), tuple(looks))


def seen(frame, identity=7, x=200.0, **mark):
    return Sighting(frame, Mark(identity, **mark), Box(x, 100, 60, 200), True, 180.0)


def test_marks_are_put_together_from_what_was_written_at_a_frame():
    notes = read_notes(request())
    first, second = notes.of(7, 15), notes.of(7, 60)
    assert (first.mark.gender, first.mark.pose, first.mark.distance_dm) == ("female", "sitting", None)
    assert "reading" not in first.mark.actions and "reading" in second.mark.actions
    assert (second.mark.pose, second.mark.object, second.mark.verb) == (None, "bag", "holding")
    assert second.mark.distance_dm == 32
    assert notes.holders == {"a": 7}
    assert first.angle == center_angle(1900.0, 60.0)


@pytest.mark.parametrize("graph", ["{", '{"observations": [{"observation": "o1"}]}', '{"entities": 3}'])
def test_a_graph_that_cannot_be_read_is_named(graph):
    with pytest.raises(DecodeError, match="graph"):
        read_notes(request(graph))


# -- looking ----------------------------------------------------------------------------------------------------------


# -- events -----------------------------------------------------------------------------------------------------------


def reads(frames, action="reading"):
    return {frame: seen(frame, actions=(action,) if does else ()) for frame, does in frames.items()}


def test_an_event_lies_between_the_last_sighting_before_it_and_the_first_after_it():
    found = bounded_events(asking(end=True), 15, reads({60: False, 90: False, 110: True, 150: True, 200: False}))
    assert found == {"t1": BoundedEvent(90, 110), "t2": BoundedEvent(150, 200)}
    assert found["t1"].known and not found["t2"].known
    assert found["t1"].middle == 100


def test_an_end_waits_for_its_start_and_a_start_for_the_description():
    assert bounded_events(asking(end=True), 15, reads({60: False})) == {}
    assert bounded_events(asking(end=True), 15, reads({10: True, 60: True})) == {"t1": BoundedEvent(15, 60)}


@given(st.sets(st.integers(0, 60)), st.integers(0, 59), st.integers(1, 60))
def test_what_is_looked_at_next_lies_inside_and_is_new(tried, low, width):
    legal = range(0, 61, 3)
    inside = [frame for frame in legal if low < frame < low + width and frame not in tried]
    chosen = between(BoundedEvent(low, low + width), legal, tried)
    assert (chosen in inside) if inside else chosen is None


# -- writing ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("condition", "written"),
    [
        (Condition(attribute="gender", value="female"), ("gender", "female")),
        (Condition(attribute="group_size", value=3, at="t0"), ("group_size", 3.0)),
        (Condition(action="reading", at="t0"), ("action", "reading")),
        (Condition(interaction="conversation", at="t0"), ("interaction", "conversation")),
        (Condition(object="bag", verb="holding", at="t0"), ("object", "holding: bag")),
    ],
)
def test_conditions_are_attributes_in_the_solvers_words(condition, written):
    assert attribute_of(condition) == written
