"""The second path against the first: the same facts, relations, conditions and people in random worlds."""

import itertools
import random
from collections import Counter

import pytest
from environment import DEEP
from keyframe_layers import all_proofs, forms_in, make_prover, memory_graph, proposals, searched
from loaded_stores import memory_store
from random_worlds import SEQUENCE, build, in_other_words, lively_world, random_world, sociable_world

from jrdb_avr.engine.generate.distractors import Choices
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.question import make_record
from jrdb_avr.engine.rederive import FALSE, TRUE, UNKNOWN, Annotations, prove_again, rederive
from jrdb_avr.schema.labels import DISTANCE_WORDS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.plan import Condition, canonical
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

RULES = Rules()


def at_t0(**kwargs):
    return Condition(at="t0", **kwargs)


@pytest.fixture(scope="module")
def random_store(tmp_path_factory):
    world = {}
    for seed in range(40 if DEEP else 20):
        make = in_other_words(random_world) if seed % 2 else random_world
        world |= make(random.Random(seed), f"yard-{seed:02d}")
    return memory_store(tmp_path_factory.mktemp("random"), world)


def test_both_paths_see_the_same_facts_in_random_worlds(random_store):
    """Facts of the per-frame tables and of the interval tables, worked out by programs that share nothing."""
    seen = 0
    for sequence in random_store.sequences:
        annotations = Annotations.read(random_store, sequence, RULES)
        for row in random_store.interval("sightings", sequence).to_pylist():
            track, frame = row["track"], row["frame"]
            seen += 1
            assert annotations.clear(track, frame) == row["clear"]
            assert annotations.pose(track, frame) == row["pose"]
            assert annotations.group_size(track, frame) == row["group_size"]
            assert annotations.distance(track, frame) == (
                pytest.approx(row["distance"], rel=1e-12) if row["located"] else None
            )
            could = {row["distance_word"], row["distance_word_other"]} - {None} or set(DISTANCE_WORDS)
            for word in DISTANCE_WORDS:
                expected = FALSE if word not in could else TRUE if len(could) == 1 else UNKNOWN
                assert annotations.holds(at_t0(attribute="distance", value=word), track, frame) == expected
            for word in ROBOT_SECTORS:
                here = annotations.holds(at_t0(attribute="sector", value=word), track, frame) == TRUE
                assert here == (row["sector"] == word)
        head = random_store.interval("sequence", sequence).to_pylist()[0]
        assert annotations.keyframes == set(head["keyframes"])
    assert seen > 2500


def test_both_paths_see_the_same_actions_in_random_worlds(random_store):
    segments = 0
    for sequence in random_store.sequences:
        annotations = Annotations.read(random_store, sequence, RULES)
        values = {}
        for row in random_store.facts("actions", sequence).to_pylist():
            for frame in range(row["first"], row["last"] + 1, annotations.step):
                values[row["track"], row["action"], frame] = TRUE if row["certain"] else UNKNOWN
        pairs = {key[:2] for key in values}
        for row in random_store.interval("sightings", sequence).to_pylist():
            track, frame = row["track"], row["frame"]
            for _, action in (pair for pair in pairs if pair[0] == track):
                known = row["listed"] and (action not in POSES or row["pose"] is not None)
                expected = values.get((track, action, frame), FALSE if known else UNKNOWN)
                assert annotations.state(track, action, frame) == expected, (sequence, track, action, frame)
        found = {
            (track, action, s.first, s.last, s.start, s.end, s.closed)
            for track, action in pairs
            for s in annotations.segments(track, action)
        }
        stored = random_store.interval("segments", sequence).to_pylist()
        names = ("track", "action", "first", "last", "start", "end", "closed")
        assert found == {tuple(row[name] for name in names) for row in stored}
        segments += len(found)
    assert segments > 10


@pytest.fixture(scope="module")
def facts_of(random_store):
    """The facts of each sequence, read from a graph."""
    graph = memory_graph(random_store, random_store.sequences)
    layers = {name: random_store.interval("sequence", name)["layers"].to_pylist()[0] for name in random_store.sequences}
    return {name: Facts(graph, name, RULES.load, with_faces="pose" in layers[name]) for name in random_store.sequences}


def state_of(fit, who):
    return TRUE if who in fit.certain else UNKNOWN if who in fit.could else FALSE


def test_both_paths_see_the_same_relations_in_random_worlds(random_store, facts_of):
    """Every relation from everybody to everybody else at every keyframe."""
    seen = {}
    for sequence, facts in facts_of.items():
        annotations = Annotations.read(random_store, sequence, RULES)
        for frame, people in facts.people.items():
            for (source, other), relation in itertools.product(itertools.permutations(people, 2), RELATIONS):
                state = annotations.related(relation, source, other, frame)
                assert state == state_of(facts.follow(relation, source, frame), other), (relation, source, other, frame)
                seen.setdefault(RELATIONS[relation].kind, set()).add(state)
    assert seen == {kind: {TRUE, UNKNOWN, FALSE} for kind in ("social", "group", "first", "person", "window")}


def test_both_paths_see_the_same_conditions_in_random_worlds(random_store, facts_of):
    seen = {}
    for sequence, facts in facts_of.items():
        annotations = Annotations.read(random_store, sequence, RULES)
        assert set(facts.keyframes) == annotations.keyframes
        sighted = [(who, frame) for frame, people in facts.people.items() for who in people]
        for condition in {condition for place in sighted for condition in facts.conditions_of(*place)}:
            for who, frame in sighted:
                state = state_of(facts.match(condition, frame), who)
                assert annotations.holds(condition, who, frame) == state, (sequence, condition, who, frame)
                seen.setdefault(condition.kind, set()).add(state)
        for who, frame in sighted:
            assert annotations.pose(who, frame) == facts.pose(who, frame)
    assert set(seen) == set(RULES.condition_order)
    assert all(states >= {TRUE, UNKNOWN} for states in seen.values())


def some_of(rows, most):
    return rows[:: max(1, len(rows) // most)]


def compare(store, sequence, most=60):
    """Ask the second path for what the first has proven, at most so many of a template; how many were asked for."""
    annotations, counts = Annotations.read(store, sequence, RULES), Counter()
    with searched(store, sequence, RULES) as search:
        for template in forms_in(store, sequence):
            prover = make_prover(search)
            proven = [(one, proofs) for one in proposals(search, template) if (proofs := prover.prove(one)) is not None]
            for one, proofs in some_of(proven, most):
                second = rederive(annotations, one.plan, template.name, RULES)
                told = (second.outcome, second.answer, second.target, second.faults)
                assert told == ("defined", one.answer, one.target, ()), canonical(one.plan)
                record = make_record(search, one, proofs, Choices((), 0, ()))
                assert dict(second.people) | dict(second.times) == record.bindings, record.plan
                assert set(second.needed) == set(record.needed), record.plan
                assert set(prove_again(annotations, one.plan, template.name, RULES, second)) == set(record.proofs)
                counts[template.query] += 1
    return counts


def compare_refused(store, sequence, most=30):
    """Compare the outcomes of perturbations of candidates that they refuse, at most so many of each form and rule.

    Returns how often each proof of a form had each outcome.
    """
    annotations, counts = Annotations.read(store, sequence, RULES), Counter()
    with searched(store, sequence, RULES) as search:
        for template in forms_in(store, sequence):
            prover = make_prover(search)
            for one in proposals(search, template):
                prover.prove(one)
            for rule in ("hop.stop", "hop.skip", "time.shift", "time.drop"):
                for one, _, _ in some_of([refused for refused in prover.refused if refused.rule == rule], most):
                    own = rederive(annotations, one.plan, template.name, RULES)
                    again = prove_again(annotations, one.plan, template.name, RULES, own)
                    again = {(proof.kind, proof.variant): (proof.outcome, proof.answer) for proof in again}
                    for proof in all_proofs(search, one):
                        found = proof.outcome, proof.answer
                        if proof.kind != "anchor":
                            assert again[proof.kind, proof.variant] == found, (proof.kind, canonical(one.plan))
                        counts[template.query, proof.kind, proof.variant, proof.outcome] += 1
    return counts


def test_both_paths_perturb_alike_where_a_candidate_is_refused(tmp_path):
    counts = Counter()
    for seed in range(8 if DEEP else 4):
        sequence, make = f"yard-{seed:02d}", sociable_world if seed < 2 else lively_world
        counts += compare_refused(memory_store(tmp_path / sequence, make(random.Random(seed), sequence)), sequence)
    assert {"hop.stop", "hop.skip", "time.shift", "time.drop"} < {kind for _, kind, _, _ in counts}


@pytest.mark.parametrize(("reading", "outcome"), [("7", "unknown"), ("7-10", "same")])
def test_both_paths_find_the_start_that_may_score_at_the_keyframe_after_the_targets(tmp_path, reading, outcome):
    """The target starts at second 6; the person before it, in the same place by then, may or does at second 7."""
    world = build(
        [
            "1 | ssssssssssssssss | column 1000",
            f"2 | tttttttttttttttt | column 1200 1200 1200 1200 2650 | reading {reading}",
            "3 | tttttttttttttttt | column 1400 1400 1400 1400 2600 | reading 6-9",
        ]
    )
    counts = compare_refused(memory_store(tmp_path, world), SEQUENCE)
    assert {found for *proof, found in counts if proof == ["action_search", "hop.stop", "1"]} == {outcome}


def test_both_paths_know_that_one_branch_without_anybody_empties_a_fork(tmp_path):
    """From second 8 on the first person talks to two others and hugs nobody."""
    world = build(
        [
            "1 | ssssssssssss | column 3100 | conversation with 2 0-11 | conversation with 5 8-11 | hugging with 3 0-7",
            "2 | tttttttttttt | column 1044",
            "3 | tttttttttttt | column 1880",
            "4 | wwwwwwwwwwww | column 1462",
            "5 | tttttttttttt | column 1149",
            "6 | tttttttttttt | column 1775",
        ]
    )
    counts = compare_refused(memory_store(tmp_path, world), SEQUENCE)
    assert counts["fork_join", "time.shift", "+3 s", "empty"]


def test_both_paths_know_no_distance_of_whoever_is_not_in_clear_view(tmp_path):
    world = build(
        [
            "1 | ssssssssssssssss | column 400 | tiny 7-15 | metres 9 9 9 9 6 6 6 12 12 12 12 12 12 12 12 12",
            "2 | tttttttttttttttt | column 900",
        ]
    )
    counts = compare_refused(memory_store(tmp_path, world), SEQUENCE)
    assert (
        counts["distance", "time.shift", "+3 s", "unknown"]
        and not counts["distance", "time.shift", "+3 s", "different"]
    )


def test_the_second_path_confirms_all_that_is_proven(tmp_path):
    counts = Counter()
    worlds = [(lively_world, 0), (sociable_world, 7), (sociable_world, 12)]
    for make, seed in worlds + [(in_other_words(lively_world), 3)] * DEEP:
        sequence = f"yard-{seed:02d}"
        counts.update(compare(memory_store(tmp_path / sequence, make(random.Random(seed), sequence)), sequence))
    assert counts.keys() == {template.query for template in TEMPLATES.values()}
