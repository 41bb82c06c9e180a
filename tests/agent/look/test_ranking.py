"""Hypotheses are ranked as brute force ranks them, the right person is found, and slots say what is known."""

import itertools
import random

import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import VALUES, Noise, ReadWorld, asked_of, identified, toward

from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
from jrdb_avr.agent.look.ranking import parts_of, rank, shares, slot_supports
from jrdb_avr.agent.perceive.votes import UNIT, Tracks
from jrdb_avr.schema.panorama import WIDTH, Box
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time, validate
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT

ALL = {15: (SeenColumns(0, WIDTH),)}
T0 = {"t0": Time(frame=15)}


def plan_of(*nodes, edges=()):
    plan = Plan("a", nodes[-1].id, T0, nodes, edges, AnswerSpec("multiple_choice", "action", nodes[-1].id, "t0"))
    validate(plan)
    return plan


WOMAN, WALKS = Condition(attribute="gender", value="female"), Condition(action="walking", at="t0")
HOP = plan_of(Node("a", (WOMAN, WALKS)), Node("b"), edges=(Edge("a", FIRST_LEFT, "b", "t0"),))
FORK = plan_of(Node("a", (WOMAN,)), Node("b", (WALKS,)), Node("c"),
               edges=(Edge("a", FIRST_LEFT, "b", "t0"), Edge("a", "conversation", "c", "t0"),
                      Edge("b", FIRST_RIGHT, "c", "t0")))  # fmt: skip


def read(number, angle, *labels, observation="o", ties=()):
    box = Box(toward(angle), 100.0, 50.0, 150.0)
    return PersonReading(observation, number, 15, box, tuple(ReadLabel(*label) for label in labels), ties)


@st.composite
def some_tracks(draw):
    people = {}
    for number in range(draw(st.integers(1, 5))):
        angle = draw(st.sampled_from((0, 20, 40, 300, 355))) + number * 2
        labels = [(name, draw(st.sampled_from(VALUES[name]))) for name in ("gender", "action") if draw(st.booleans())]
        ties = (ReadTie("conversation", draw(st.integers(0, 4))),) if draw(st.booleans()) else ()
        looks = ("o", "q")[: draw(st.integers(1, 2))]
        people[f"p{number}"] = tuple(read(number, angle, *labels, observation=look, ties=ties) for look in looks)
    return Tracks(people, draw(st.sampled_from((ALL, {15: (SeenColumns(0, 400),)}))))


@given(some_tracks(), st.sampled_from((HOP, FORK)))
@settings(max_examples=examples(60))
def test_the_best_hypothesis_is_that_of_brute_force(tracks, plan):
    nodes = [node.id for node in plan.nodes]
    best = {}
    for people in itertools.permutations(tracks.people, len(nodes)):
        bound = dict(zip(nodes, people, strict=True))
        odds = sum(part.evidence(tracks, [bound[node] for node in part.nodes]) for part in parts_of(plan))
        best[bound[plan.target]] = max(best.get(bound[plan.target], -99), odds)
    ranked = rank(plan, tracks)
    if len(tracks.people) < len(nodes):
        assert ranked and all(len(one.nodes) == len(tracks.people) for one in ranked)
        return
    assert ranked[0].log_odds == pytest.approx(max(best.values()))
    others = [odds for who, odds in best.items() if who != ranked[0].nodes[plan.target]]
    assert ranked[0].margin == pytest.approx(ranked[0].log_odds - max(others, default=float("-inf")))
    assert [one.log_odds for one in ranked] == sorted((one.log_odds for one in ranked), reverse=True)
    share = shares(ranked, plan.target)
    assert sum(share.values()) == pytest.approx(1) and [*share.values()] == sorted(share.values(), reverse=True)


def test_the_margin_is_that_over_the_best_hypothesis_with_another_target():
    talk = plan_of(Node("a", (WOMAN,)), Node("b"), edges=(Edge("a", "conversation", "b", "t0"),))
    said, with_p3 = ("gender", "female"), (ReadTie("conversation", 3),)
    people = {"p1": (read(1, 100, said, ties=with_p3),), "p2": (read(2, 80, said, ties=with_p3),), "p3": (read(3, 60),)}
    first, second, *others = rank(talk, Tracks(people, ALL))
    assert first.nodes["b"] == second.nodes["b"] == "p3"
    assert first.margin == pytest.approx(first.log_odds - max(one.log_odds for one in others if one.nodes["b"] != "p3"))
    assert first.margin > first.log_odds - second.log_odds


def test_slots_say_what_is_open_supported_certain_or_contradicted():
    woman = [read(1, 100, ("gender", "female"), ("action", "standing"), observation=look) for look in ("o", "q")]
    tracks = Tracks({"p1": tuple(woman), "p2": (read(2, 80),)}, ALL)
    first = rank(HOP, tracks)[0]
    assert first.nodes == {"a": "p1", "b": "p2"} and len(rank(HOP, tracks)) == 2
    assert [slot.state for slot in slot_supports(HOP, tracks, first)] == ["certain", "contradicted", "supported"]
    alone = Tracks({"p1": tuple(woman)}, ALL)
    assert [slot.state for slot in slot_supports(HOP, alone, rank(HOP, alone)[0])] == [
        "certain",
        "contradicted",
        "open",
    ]
    assert rank(HOP, Tracks({}, {}))[0].nodes == {}


def test_a_neighbour_tells_nothing_of_whose_it_is():
    people = {f"p{n}": (read(n, 100 - 10 * n, ties=(ReadTie("conversation", 3 - n),)),) * 2 for n in (1, 2)}
    beside, talk = (part for part in parts_of(FORK) if part.name in (FIRST_LEFT, "conversation"))
    pair = ("p1", "p2")
    assert beside.support(Tracks(people, ALL), pair).settled and talk.support(Tracks(people, ALL), pair).settled
    assert -0.3 < beside.evidence(Tracks(people, ALL), pair) <= 0 < talk.evidence(Tracks(people, ALL), pair)
    assert beside.evidence(Tracks(people, {}), pair) < -1


def test_whoever_is_not_where_they_should_be_is_less_likely():
    earlier = PersonReading("o1", 1, 0, Box(toward(100), 100, 50, 150), (ReadLabel("gender", "female"),))
    there = read(1, 300, ("gender", "female"))
    plan = plan_of(Node("a", (WOMAN, WALKS)))
    ranked = rank(plan, Tracks({"p1": (earlier,), "p2": (there,)}, ALL))
    assert [one.nodes["a"] for one in ranked] == ["p2", "p1"] and ranked[0].margin == pytest.approx(UNIT)
    unseen = {0: (SeenColumns(0, WIDTH),), 15: (SeenColumns(2000, 480),)}
    assert rank(plan, Tracks({"p1": (earlier,), "p2": (there,)}, unseen))[0].margin == 0


@pytest.mark.slow
def test_more_readings_find_more_people_and_votes_find_more_than_the_newest_reading():
    once, thrice = (identified(range(60), readings, Noise(wrong=0.1)) for readings in (1, 3))
    assert thrice.votes > once.votes == once.newest and thrice.votes > thrice.newest + 0.1


def test_a_described_person_is_found_without_noise():
    for seed in range(20):
        world = ReadWorld(random.Random(seed), 6)
        plan, target = asked_of(world)
        ranked = rank(plan, world.read_round(1, Noise(jitter=0.0)))
        assert ranked[0].nodes[plan.target] == target
