"""The facts by Cypher are those of the set-wise search: on random worlds of all layers, and on real annotations."""

import os
import random
from pathlib import Path

import numpy as np
import pytest
from random_worlds import lively_world, random_world, sociable_world
from worlds import load_world

from jrdb_avr.engine.generate.conditions import FALSE, TRUE
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.fork_join import find_joins
from jrdb_avr.engine.generate.relations import KIND, RELATIONS
from jrdb_avr.engine.generate.scene import load_scene
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.relations import RELATIONS as ROWS
from jrdb_avr.schema.rules import LoadRules, Rules

REAL = Path(os.environ.get("JRDB_REAL", Path(__file__).parents[4] / "shared" / "jrdb-real"))
RULES = Rules()


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    """A store of random worlds: of every layer, with much happening, and with many groups and interactions."""
    rng, layers = random.Random(7), {}
    for number in range(18):
        make = (random_world, lively_world, sociable_world)[number % 3]
        layers |= make(rng, f"yard-2020-01-01_{number}")
    return load_world(tmp_path_factory.mktemp("facts"), layers)


def contexts(store):
    """Per sequence: the set-wise search, and the facts by Cypher."""
    with Graph.open(store.graph_path, read_only=True) as graph:
        for sequence in sorted(store.manifest().sequences):
            scene = load_scene(store, sequence)
            with_faces = "pose" in scene.layers
            yield SearchContext(scene, RULES), Facts(graph, sequence, RULES.load, with_faces=with_faces)


def check_conditions(context, facts):
    """Each condition that holds of some person at a keyframe has the same people; return the number of comparisons."""
    scene, conditions, compared = context.scene, context.conditions, 0
    tracks = scene.tracks[scene.people(conditions.moment)]
    for place, frame in enumerate(scene.keyframes.tolist()):
        here = np.flatnonzero(conditions.keyframe == place)
        assert facts.people.get(frame, {}).keys() == set(tracks[here].tolist())
        for code, condition in enumerate(conditions.vocabulary):
            states = conditions.states[here, code]
            expected = set(tracks[here[states != FALSE]].tolist()), set(tracks[here[states == TRUE]].tolist())
            found = facts.match(condition, frame) if len(here) else ((), ())
            assert tuple(map(set, found)) == expected, (scene.sequence, frame, condition)
            compared += 1
    return compared


def relations(context):
    """(relation, source, frame): the people who could have it and who certainly do, of the set-wise search."""
    scene, facts, found = context.scene, context.facts, {}
    columns = zip(facts.source, facts.relation, facts.target, facts.certain, strict=True)
    for source, code, target, certain in columns:
        pair = found.setdefault((RELATIONS[code], int(source)), (set(), set()))
        pair[0].add(scene.track(int(target)))
        if certain:
            pair[1].add(scene.track(int(target)))
    return found


def check_relations(context, facts):
    """Each relation from each person leads to the same people; return the number of comparisons."""
    scene, known, labelled, compared = context.scene, context.facts.known, relations(context), 0
    by_frame = {}
    for moment in scene.seen_moments.tolist():
        by_frame.setdefault(int(scene.frames(np.array([moment]))[0]), []).append(moment)
    for frame, moments in by_frame.items():
        for code, label in enumerate(RELATIONS):
            if ROWS[label].kind == "window":
                continue
            for source in moments:
                could, certain = (set(people) for people in labelled.get((label, source), ((), ())))
                others = [other for other in moments if other != source]
                if ROWS[label].kind != "first":
                    open_to = [o for o in others if not (known[KIND[code], source] and known[KIND[code], o])]
                    could |= {scene.track(other) for other in open_to}
                found = facts.follow(label, scene.track(source), frame)
                assert tuple(map(set, found)) == (could, certain), (scene.sequence, frame, source, label)
                compared += 1
    return compared


def check_joins(context, facts):
    """The joining relations lead to the same people as the masks of fork-joins, windows included."""
    scene, joins, compared = context.scene, find_joins(context), 0
    for sighting, moment in enumerate(context.conditions.moment.tolist()):
        place, frame = context.conditions.keyframe[sighting], int(scene.frames(np.array([moment]))[0])
        for code in joins.relations.tolist():
            masks = joins.could[sighting, joins.column[code]], joins.sure[sighting, joins.column[code]]
            expected = [{scene.track(m) for m in context.conditions.members(place, mask)} for mask in masks]
            found = facts.follow(RELATIONS[code], scene.track(moment), frame)
            assert list(map(set, found)) == expected, (scene.sequence, frame, moment, RELATIONS[code])
            compared += 1
    return compared


def test_facts_of_random_worlds_equal_those_of_the_set_wise_search(worlds):
    checks = (check_conditions, check_relations, check_joins)
    compared = np.sum([[check(*pair) for check in checks] for pair in contexts(worlds)], axis=0)
    assert (compared > (5_000, 20_000, 2_000)).all(), compared
    kinds = {kind for context, _ in contexts(worlds) for kind in (c.kind for c in context.conditions.vocabulary)}
    assert kinds == set(RULES.condition_order)


@pytest.mark.slow
@pytest.mark.skipif(not REAL.is_dir(), reason="there are no real annotations here")
def test_facts_of_real_sequences_equal_those_of_the_set_wise_search(tmp_path):
    store = Store(tmp_path / "store")
    load(find_root(REAL), store, LoadRules(), 1)
    for number, (context, facts) in enumerate(contexts(store)):
        assert check_conditions(context, facts)
        if number % 9 == 0:
            assert check_relations(context, facts) and check_joins(context, facts)
