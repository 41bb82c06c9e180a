"""People who join and leave groups, as read from pictures: frames of the facts, changes and answers."""

from readings import SeenColumns

from jrdb_avr.agent.look.answer import conclude
from jrdb_avr.agent.look.moments import group_changes, is_in_group
from jrdb_avr.agent.look.ranking import rank
from jrdb_avr.agent.perceive.fields import fields_of, perceivable
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.perceive.votes import Tracks
from jrdb_avr.schema.answers import FrameAnswer
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.relations import SAME_GROUP

BAG = Condition(object="bag", verb="carrying", at="m")
TIMES = {"t0": Time(frame=30), "j": Time(event="joins_group", of="a", after="t0"), "m": Time(after="t0", before="j")}
NODES = (Node("a", (BAG,)), Node("b"))
EDGES = (Edge("a", SAME_GROUP, "b", "j"),)
JOINS = Plan("a", "a", TIMES, NODES, EDGES, AnswerSpec("frame", "start", "a", "j"))


def pictures(states, bag=True):
    """Panoramas of persons a and b, who are in one group at the frames with True."""
    people = {"a": (), "b": ()}
    for frame, together in states.items():
        label = ReadLabel("object", "carrying: bag", bag)
        ties = (ReadTie(SAME_GROUP, 2, together),)
        people["a"] += (PersonReading(f"o{frame}", 1, frame, Box(500, 100, 50, 150), (label,), ties),)
        people["b"] += (PersonReading(f"o{frame}", 2, frame, Box(700, 100, 50, 150)),)
    return Tracks(people, {frame: (SeenColumns(0, WIDTH),) for frame in states})


def test_facts_at_a_group_event_are_read_at_its_frame():
    guessed, known = perceivable(JOINS), perceivable(JOINS, {"j": 90})
    assert (guessed.times["j_frame"].frame, guessed.times["m"].frame) == (60, 45)
    assert (known.times["j_frame"].frame, known.times["m"].frame) == (90, 60)
    assert known.edges[0].at == "j_frame" and known.nodes[0].conditions == (BAG,)
    assert f"relation {SAME_GROUP}" in {field.key for field in fields_of(known)}


def test_a_change_of_group_is_bracketed_by_readings():
    tracks = pictures({30: False, 60: False, 90: True, 120: True})
    assert [is_in_group(tracks, "a", frame) for frame in (30, 45, 90)] == [False, None, True]
    assert group_changes(JOINS, tracks, {"a": "a"}) == {"j": 90}
    assert group_changes(JOINS, pictures({30: True, 60: True}), {"a": "a"}) == {}
    # The state before is not known, or is the same.
    assert group_changes(JOINS, pictures({30: True, 60: False, 90: False, 120: True}), {"a": "a"}) == {"j": 120}
    assert group_changes(JOINS, pictures({60: True, 90: True}), {"a": "a"}) == {}
    plan = perceivable(JOINS, {"j": 90})
    conclusion = conclude(plan, tracks, rank(plan, tracks), (), range(0, 151, 15))
    assert (conclusion.answer, conclusion.entity) == (FrameAnswer(75), "a")


def test_an_attribute_of_a_thing_is_read_of_the_person_who_has_it():
    spec = AnswerSpec("multiple_choice", "attribute", "t", "t0", attribute="colour")
    edges = (Edge("a", "holding", "t", "t0"),)
    plan = perceivable(Plan("a", "t", {"t0": Time(frame=30)}, (Node("a"), Node("t", kind="bag")), edges, spec))
    assert (plan.target, plan.answer.of, plan.answer.attribute) == ("a", "a", "bag_colour")
    assert plan.nodes == (Node("a", (Condition(object="bag", verb="holding", at="t0"),)),)
