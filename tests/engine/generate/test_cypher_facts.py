"""Facts by statements over the stored graph are those of the sets, for each condition, relation and read."""

import random
from collections import Counter

import pytest
from random_worlds import in_crowds, lively_world, random_world, sociable_world
from worlds import load_world, person

from jrdb_avr.engine.generate.cypher_facts import CypherFacts, statement_of
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.perturb import MissingFactsError
from jrdb_avr.loaders.intervals import neighbors
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.relations import FIRST_LEFT, QUESTION_RELATIONS, RELATIONS, SAME_GROUP
from jrdb_avr.schema.rules import CONDITION_KINDS, LoadRules

RULES = LoadRules()


@pytest.fixture(scope="module", params=("clear", "any"))
def worlds(request, tmp_path_factory):
    rng, layers = random.Random(37), {}
    for number in range(15):
        make = (random_world, lively_world, sociable_world)[number % 3]
        layers |= (in_crowds(make) if number % 2 else make)(rng, f"yard-2020-01-01_{number}")
    return load_world(tmp_path_factory.mktemp("cypher_facts"), layers, rules=LoadRules(visibility=request.param))


def keys_of(facts, sequence, rng, most=300):
    """Keys of facts of one sequence, at most so many of each kind: those that perturbed programs may ask for."""
    tracks = sorted({who for people in facts.people.values() for who in people})
    keys = {}
    for frame in facts.keyframes:
        people = facts.people.get(frame, {})
        keys.setdefault("people_at", []).append(("people_at", sequence, frame))
        held = {condition for who in people for condition in facts.conditions_of(who, frame)}
        for condition in sorted(held, key=repr):
            moments = facts.keyframes if condition.object else rng.sample(facts.keyframes, min(3, len(facts.keyframes)))
            for moment in moments:
                keys.setdefault(condition.kind, []).append(("match", sequence, condition, moment))
        for who in facts.uncovered[frame]:
            for relation in QUESTION_RELATIONS:
                key = ("follow", sequence, relation, who, frame)
                keys.setdefault(RELATIONS[relation].kind, []).append(key)
        for who in tracks:
            keys.setdefault("seen", []).append(("seen", sequence, who, frame))
            keys.setdefault("labels", []).append(("labels", sequence, who, frame))
    return [key for kind in keys.values() for key in rng.sample(kind, min(most, len(kind)))]


def check_facts(graph, sequences, rng, rules=RULES, with_faces=lambda sequence: True):
    """Each fact is the same; return how many were compared by statement."""
    compared, source = Counter(), CypherFacts(graph, rules)
    for sequence in sequences:
        facts = Facts(graph, sequence, rules, with_faces=with_faces(sequence))
        keys = keys_of(facts, sequence, rng)
        if not keys:
            continue
        with pytest.raises(MissingFactsError):
            source.ask(keys)
        stated = source.complete(lambda keys=keys: source.ask(keys))
        for key, expected, found in zip(keys, facts.ask(keys), stated, strict=True):
            if statement_of(key) not in ("seen", "labels"):
                expected, found = tuple(map(set, expected)), tuple(map(set, found))
            assert found == expected, key
            compared[statement_of(key)] += 1
    return compared


def test_each_fact_by_statement_equals_that_of_the_sets(worlds):
    manifest = worlds.manifest()
    with Graph.open(worlds.graph_path, read_only=True) as graph:
        compared = check_facts(graph, sorted(manifest.sequences), random.Random(5), manifest.load_rules)
    kinds = {"word", *CONDITION_KINDS} - {"gender", "age"}
    relations = ("pair", "group", "window")
    assert compared.keys() == {
        *(f"condition_{kind}" for kind in kinds),
        *(f"relation_{kind}" for kind in relations),
        *("people_at", "seen", "labels"),
    }
    assert min(compared.values()) > 5, compared


def test_places_that_load_left_out_are_unknown(tmp_path, monkeypatch):
    """Too many places are left out as a whole. Then anybody may have each place."""
    monkeypatch.setattr(neighbors, "MAX_BESIDE", 1)
    name = "yard-2020-01-01_0"
    store = load_world(tmp_path, sociable_world(random.Random(3), name))
    with Graph.open(store.graph_path, read_only=True) as graph:
        assert check_facts(graph, [name], random.Random(5))
        facts = Facts(graph, name, RULES, with_faces=True)
    crowded = {frame: people for frame, people in facts.uncovered.items() if len(people) > 2}
    assert crowded
    for frame, people in crowded.items():
        for who in people:
            assert facts.follow(FIRST_LEFT, who, frame) == (people - {who}, set())


def test_a_group_that_is_left_for_a_few_frames_stays_possible(tmp_path):
    """Person 2 is certainly in group 1 around frame 30, and a closed gap leaves group 2 possible there."""
    name = "yard-2020-01-01_0"
    groups = {1: lambda frame: 1, 2: lambda frame: 1 if 28 <= frame <= 32 else 2, 3: lambda frame: 2}
    rows = {
        frame: [
            person(who, (400 * who, 100, 60, 200), {"standing": 1}, (group(frame), 1)) for who, group in groups.items()
        ]
        for frame in range(61)
    }
    store = load_world(tmp_path, {name: {"2d": rows}})
    with Graph.open(store.graph_path, read_only=True) as graph:
        assert check_facts(graph, [name], random.Random(5))
        facts = Facts(graph, name, RULES, with_faces=True)
    could, certain = facts.follow(SAME_GROUP, 2, 30)
    assert set(could) == {1, 3} and 3 not in certain
