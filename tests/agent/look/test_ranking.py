"""Hypotheses are ranked as brute force ranks them, the right person is found, and slots say what is known."""

import itertools
import math
import random

import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import VALUES, Noise, ReadWorld, asked_of, identified, toward

from jrdb_avr.agent.look.ranking import (
    PlanPart,
    absence_evidence,
    edges_of,
    frames_of,
    join,
    parts_of,
    rank,
    slot_supports,
)
from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel, ReadTie
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


def enumerated(plan, people, odds):
    """All bindings of a plan's nodes to different people with their log-odds, the best first."""
    nodes = [node.id for node in plan.nodes]
    bindings = [dict(zip(nodes, chosen, strict=True)) for chosen in itertools.permutations(people, len(nodes))]
    return sorted(((odds(bound), bound) for bound in bindings), key=lambda binding: -binding[0])


def is_ranked_as(ranked, best, target):
    """Check the first hypothesis, its margin and the order of all against an enumeration."""
    odds_of = {tuple(sorted(bound.items())): odds for odds, bound in best}
    assert ranked[0].log_odds == pytest.approx(best[0][0])
    for each in ranked:
        assert each.log_odds == pytest.approx(odds_of[tuple(sorted(each.nodes.items()))])
    others = [odds for odds, bound in best if bound[target] != ranked[0].nodes[target]]
    assert ranked[0].margin == pytest.approx(ranked[0].log_odds - max(others, default=float("-inf")))
    order = [round(each.log_odds, 6) for each in ranked]
    assert order == sorted(order, reverse=True)


@given(some_tracks(), st.sampled_from((HOP, FORK)))
@settings(max_examples=examples(60))
def test_the_best_binding_of_readings_is_the_best_of_all_bindings(tracks, plan):
    def odds(bound):
        seen = sum(
            absence_evidence(tracks, bound[node.id], frame) for node in plan.nodes for frame in frames_of(plan, node.id)
        )
        return seen + sum(
            part.evidence(part.support(tracks, [bound[node] for node in part.nodes]).log_odds)
            for part in parts_of(plan)
        )

    ranked = rank(plan, tracks)
    if len(tracks.people) < len(plan.nodes):
        assert ranked and all(len(each.nodes) == len(tracks.people) for each in ranked)
        return
    is_ranked_as(ranked, enumerated(plan, tracks.people, odds), plan.target)


ODDS = st.sampled_from((-3.0, -1.0, -0.1, 0.0, 0.7, 2.5))


@given(st.integers(3, 5), st.sampled_from((HOP, FORK)), st.data())
@settings(max_examples=examples(60))
def test_a_join_of_tables_is_the_best_of_all_bindings(count, plan, data):
    people, edges = [f"p{n}" for n in range(count)], edges_of(plan)
    alone = {(node.id, entity): data.draw(ODDS) for node in plan.nodes for entity in people}
    keys = [(index, *pair) for index in range(len(edges)) for pair in itertools.permutations(people, 2)]
    pairs = {key: data.draw(ODDS) for key in keys if data.draw(st.booleans())}

    def odds(bound):
        joined = [
            pairs.get((index, *(bound[end] for end in edge.nodes)), edge.evidence(0.0))
            for index, edge in enumerate(edges)
        ]
        return sum(joined) + sum(alone[binding] for binding in bound.items())

    is_ranked_as(join(plan, alone, pairs), enumerated(plan, people, odds), plan.target)


def test_the_evidence_of_a_part_weighs_what_few_share_more():
    walks, talk, beside = (
        PlanPart(("a",), "action", "walking", 15),
        PlanPart(("a", "b"), "conversation", "", 15),
        PlanPart(("a", "b"), FIRST_LEFT, "", 15),
    )
    for part, often in ((walks, 0.4), (talk, 0.2), (PlanPart(("a",), "object", "holding: bag", 15), 0.03)):
        for log_odds in (-3.0, 0.0, 0.5, 3.0):
            expected = -math.log(often + (1 - often) * math.exp(-log_odds))
            assert part.evidence(log_odds) == pytest.approx(expected)
        assert part.evidence(0.0) == pytest.approx(0.0) and part.evidence(99.0) == pytest.approx(-math.log(often))
    assert beside.evidence(2.0) == pytest.approx(talk.evidence(2.0) + math.log(0.2))


def test_an_earlier_node_may_be_anybody_who_is_kept_by_the_beam():
    """The beam keeps the best binding of each entity for the newest node, however many are better."""
    people = [f"p{n:02}" for n in range(40)]
    alone = {(node, entity): -0.01 * n for node in "ab" for n, entity in enumerate(people)}
    pairs = {(0, "p39", "p38"): 9.0}
    ranked = join(HOP, alone, pairs)
    assert ranked[0].nodes == {"a": "p39", "b": "p38"}
    assert {each.nodes["b"] for each in ranked} == {*people}
    assert join(HOP, {}, {}) == ()


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
    assert [support.state for _, support in slot_supports(HOP, tracks, first)] == ["certain", "contradicted", "certain"]
    alone = Tracks({"p1": tuple(woman)}, ALL)
    assert [support.state for _, support in slot_supports(HOP, alone, rank(HOP, alone)[0])] == [
        "certain",
        "contradicted",
        "open",
    ]
    assert rank(HOP, Tracks({}, {})) == ()


def test_a_neighbor_does_not_say_who_the_source_is():
    people = {f"p{n}": (read(n, 100 - 10 * n, ties=(ReadTie("conversation", 3 - n),)),) * 2 for n in (1, 2)}
    beside, talk = (part for part in parts_of(FORK) if part.name in (FIRST_LEFT, "conversation"))
    seen, unseen = (Tracks(people, looks) for looks in (ALL, {}))
    odds = [part.evidence(part.support(seen, ("p1", "p2")).log_odds) for part in (beside, talk)]
    assert -0.4 < odds[0] <= 0 < odds[1]
    assert beside.evidence(beside.support(unseen, ("p1", "p2")).log_odds) < -1


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
    assert thrice.votes >= once.votes == once.newest


def test_a_described_person_is_found_without_noise():
    for seed in range(20):
        world = ReadWorld(random.Random(seed), 6)
        plan, target = asked_of(world)
        ranked = rank(plan, world.read_round(1, Noise(jitter=0.0)))
        assert ranked[0].nodes[plan.target] == target
