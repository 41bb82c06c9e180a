"""The facts of generation are those of the brute-force oracle, whether or not the rules judge who is in clear view."""

import random
from collections import Counter

import pytest
from environment import copy_real, needs_real
from keyframe_layers import memory_graph
from loaded_stores import MemoryStore, memory_store
from oracle_candidates import MAYBE, NO, NOWHERE, OTHERS, PLACES, POSES, RELATIONS, TOGETHER, WINDOWS, YES, People
from random_worlds import in_crowds, lively_world, random_world, sociable_world
from worlds import member, person

from jrdb_avr.engine.generate.describe import describe, find_leads
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import LoadRules, Rules

WORDS = {
    "gender": ("male", "female"),
    "age": ("childhood", "adolescence", "young adulthood", "middle adulthood", "late adulthood"),
    "pose": POSES,
    "action": OTHERS,
    "interaction": TOGETHER,
    "group_size": range(1, 8),
    "sector": ("ahead", "right", "behind", "left"),
    "distance": ("very close", "close", "moderate", "far", "very far"),
}


def read_facts(store, root, rules):
    """Per sequence: the oracle, and the facts by Cypher."""
    sequences = store.sequences if isinstance(store, MemoryStore) else sorted(store.manifest().sequences)
    graph = memory_graph(store, sequences)
    for sequence in sequences:
        oracle = People(root, sequence, judged=rules.visibility == "clear")
        yield oracle, Facts(graph, sequence, rules, with_faces="pose" in oracle.layers)


def condition_of(kind, value):
    """A condition of the oracle, (kind, value), as plans have it."""
    if kind == "object":
        return Condition(object=value[0], verb=value[1], at="t0")
    if kind in ("gender", "age"):
        return Condition(attribute=kind, value=value)
    if kind in ("pose", "action"):
        return Condition(action=value, at="t0")
    if kind == "interaction":
        return Condition(interaction=value, at="t0")
    return Condition(attribute=kind, value=value, at="t0")


def check_fit(fit, values, about):
    """The people whom a fact may and certainly does fit are those of the oracle: {track: value}."""
    expected = {who for who, value in values.items() if value != NO}, {who for who, v in values.items() if v == YES}
    assert tuple(map(set, fit)) == expected, about


def check_conditions(oracle, facts):
    """Each condition has the same people at each keyframe; return how many certain and unknown facts were compared."""
    compared = Counter()
    every = [(kind, value) for kind, values in WORDS.items() for value in values]
    every += [("object", pair) for pair in sorted(oracle.pairs)]
    for frame in oracle.keyframes:
        people = oracle.counting(frame)
        assert facts.uncovered[frame] == set(people)
        for kind, value in every:
            values = {who: oracle.value((kind, value), frame, who) for who in people}
            check_fit(facts.match(condition_of(kind, value), frame), values, (oracle.sequence, frame, kind, value))
            compared.update((kind, state) for state in values.values())
    return compared


def check_relations(oracle, facts):
    """Each relation from each person, covered ones included, leads to the same people; return what was compared."""
    compared = Counter()
    for frame in oracle.keyframes:
        for who in oracle.in_frame(frame):
            for label in (*RELATIONS, *WINDOWS):
                others = [other for other in oracle.counting(frame) if other != who]
                values = {other: oracle.related(frame, who, label, other) for other in others}
                check_fit(facts.follow(label, who, frame), values, (oracle.sequence, frame, who, label))
                kind = "window" if label in WINDOWS else "place" if label in PLACES else label
                compared.update((kind, state) for state in values.values())
    return compared


def check_descriptions(oracle, facts):
    """Each person has the same descriptions and leads; return their number."""
    compared = Counter()
    for frame in oracle.keyframes:
        for who in oracle.counting(frame):
            expected = {}
            for quiet in (True, False):
                if (conditions := oracle.description(frame, who, quiet)) is not None:
                    expected[frozenset(condition_of(*one) for one in conditions)] = not quiet
            described = describe(facts, oracle.sequence, who, frame, Rules())
            found = {frozenset(conditions): general for conditions, general in described.items()}
            assert found == expected, (oracle.sequence, frame, who)
            leads = {label: oracle.step(frame, who, label) for label in RELATIONS}
            leads = {label: other for label, other in leads.items() if other not in NOWHERE}
            assert find_leads(facts, who, frame) == leads
            compared.update(descriptions=len(found), leads=len(leads))
    return compared


CHECKS = (check_conditions, check_relations, check_descriptions)


@pytest.mark.parametrize("visibility", ("clear", "any"))
def test_facts_of_random_worlds_equal_those_of_the_oracle(tmp_path, visibility):
    rng, world, compared, covered = random.Random(7), {}, Counter(), 0
    for number in range(18):
        make = (random_world, lively_world, sociable_world)[number % 3]
        world |= (in_crowds(make) if number % 2 else make)(rng, f"yard-2020-01-01_{number}")
    store = memory_store(tmp_path, world, visibility=visibility)
    for oracle, facts in read_facts(store, tmp_path / "root", LoadRules(visibility=visibility)):
        compared += sum((check(oracle, facts) for check in CHECKS), Counter())
        covered += sum(len(people) - len(facts.uncovered[frame]) for frame, people in facts.people.items())
    for kind in (*WORDS, "object", "window", "place", *RELATIONS[: -len(PLACES)]):
        if kind in TOGETHER and not compared[kind, YES]:
            continue
        assert all(compared[kind, state] for state in (YES, NO, MAYBE)), kind
    assert min(compared["descriptions"], compared["leads"]) > 200
    assert (covered > 100) == (visibility == "clear")


def test_a_partner_without_a_box_gives_no_interaction_in_a_closed_gap(tmp_path):
    name, world = "yard-2020-01-01_0", {"2d": {}, "social": {}}
    for frame in range(46):
        there = [who for who in range(1, 5) if (who, frame) != (2, 30)]
        boxes = {who: (700 * who, 100, 50, 150) for who in there}
        world["2d"][frame] = [person(who, boxes[who], {"standing": 1}, (1, 1)) for who in there]
        met = {who: [(who + 1, {"conversation": 1})] if who % 2 and who + 1 in there else [] for who in there}
        world["social"][frame] = [member(who, boxes[who], interactions=met[who]) for who in there]
    (facts,) = (facts for _, facts in read_facts(memory_store(tmp_path, {name: world}), tmp_path / "root", LoadRules()))
    conversation = condition_of("interaction", "conversation")
    assert [facts.match(conversation, frame).could for frame in (15, 30)] == [{1, 2, 3, 4}, {3, 4}]


@pytest.mark.slow
@needs_real
def test_facts_of_real_sequences_equal_those_of_the_oracle(tmp_path):
    copy_real(tmp_path, last=4)
    store = Store(tmp_path / "store")
    load(find_root(tmp_path / "root"), store, LoadRules(), 1)
    for oracle, facts in read_facts(store, tmp_path / "root", LoadRules()):
        assert all(check(oracle, facts) for check in CHECKS)
