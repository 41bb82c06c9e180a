"""Descriptions and leads by the facts are those of the set-wise search and of its graph."""

import random

import pytest
from keyframe_layers import searched
from random_worlds import lively_world, random_world, sociable_world
from worlds import load_world

from jrdb_avr.engine.generate.describe import describe, find_leads
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.rules import Rules

RULES = Rules()


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    rng, layers = random.Random(11), {}
    for number in range(12):
        make = (random_world, lively_world, sociable_world)[number % 3]
        layers |= make(rng, f"yard-2020-01-01_{number}")
    return load_world(tmp_path_factory.mktemp("describe"), layers)


def check_descriptions(context, facts):
    """Each person has the same descriptions for the same uses; return their number."""
    scene, old = context.scene, context.descriptions
    expected = {}
    for name, moment in enumerate(old.moment.tolist()):
        key = scene.track(moment), int(scene.frames(moment))
        expected.setdefault(key, set()).add((old.of(name), bool(old.general[name]), bool(old.poseless[name])))
    found = {}
    for frame, people in facts.people.items():
        for who in people:
            for one in describe(facts, scene.sequence, who, frame, context.rules):
                found.setdefault((who, frame), set()).add((one.conditions, one.general, one.poseless))
    assert found == expected
    return sum(map(len, found.values()))


def check_leads(context, facts):
    """Each relation leads to the same person; return the number of leads."""
    scene = context.scene
    expected = {
        (int(scene.frames(source)), scene.track(source), RELATIONS[code]): scene.track(target)
        for (source, code), target in context.leads.items()
    }
    found = {
        (frame, who, relation): target
        for frame, people in facts.people.items()
        for who in people
        for relation, target in find_leads(facts, who, frame).items()
    }
    assert found == expected
    return len(found)


def test_descriptions_and_leads_equal_those_of_the_set_wise_search(worlds):
    described = led = 0
    with Graph.open(worlds.graph_path, read_only=True) as graph:
        for sequence in sorted(worlds.manifest().sequences):
            with searched(worlds, sequence, RULES) as context:
                facts = Facts(graph, sequence, RULES.load, with_faces="pose" in context.scene.layers)
                described += check_descriptions(context, facts)
                led += check_leads(context, facts)
    assert described > 200 and led > 300
