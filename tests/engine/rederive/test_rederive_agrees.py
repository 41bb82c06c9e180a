"""The second path against the first: the same facts, relations, conditions and people in random worlds."""

import itertools
import random
from collections import Counter, defaultdict

import loaded_stores
import pytest
from environment import DEEP
from keyframe_layers import all_proofs, forms_in, make_prover, memory_graph, proposals, searched
from random_worlds import (
    SEQUENCE,
    build,
    in_other_words,
    lively_world,
    random_world,
    sociable_world,
    with_chorus,
)

from jrdb_avr.engine.generate.asked import Question
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.pool import make_candidate
from jrdb_avr.engine.rederive import FALSE, TRUE, UNKNOWN, Annotations, prove_again, rederive
from jrdb_avr.schema.labels import POSES, choice_text
from jrdb_avr.schema.plan import canonical
from jrdb_avr.schema.relations import RELATIONS
from jrdb_avr.schema.rules import LoadRules, Rules

RULES = Rules(load=LoadRules(visibility="any"))
CLEAR = Rules(load=LoadRules(visibility="clear"))


def memory_store(folder, world, rules=RULES):
    return loaded_stores.memory_store(folder, world, visibility=rules.load.visibility)


def random_worlds(folder, rules):
    world = {}
    for seed in range(40 if DEEP else 20):
        make = in_other_words(random_world) if seed % 2 else random_world
        world |= make(random.Random(seed), f"yard-{seed:02d}")
    return memory_store(folder, world, rules)


@pytest.fixture(scope="module")
def random_store(tmp_path_factory):
    return random_worlds(tmp_path_factory.mktemp("random"), RULES)


@pytest.fixture(scope="module")
def judged_store(tmp_path_factory):
    """The same worlds, with people in clear view, covered and uncertain."""
    return random_worlds(tmp_path_factory.mktemp("judged"), CLEAR)


@pytest.fixture(scope="module", params=["any", "clear"])
def store_and_rules(request):
    names = {"any": ("random_store", RULES), "clear": ("judged_store", CLEAR)}
    name, rules = names[request.param]
    return request.getfixturevalue(name), rules


def test_both_paths_see_the_same_actions_in_random_worlds(store_and_rules):
    random_store, rules = store_and_rules
    segments = 0
    for sequence in random_store.sequences:
        annotations = Annotations.read(random_store, sequence, rules)
        values = {}
        for row in random_store.facts("actions", sequence).to_pylist():
            for frame in range(row["first"], row["last"] + 1, annotations.step):
                values[row["track"], row["action"], frame] = TRUE if row["certain"] else UNKNOWN
        pairs = {key[:2] for key in values}
        for row in random_store.interval("sightings", sequence).to_pylist():
            track, frame = row["track"], row["frame"]
            for _, action in (pair for pair in pairs if pair[0] == track):
                known = row["listed"] and (action not in POSES or row["posed"])
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
def facts_of(store_and_rules):
    """Both programs' facts of each sequence: of the second one, and read from a graph."""
    store, rules = store_and_rules
    graph, found = memory_graph(store, store.sequences), {}
    for name in store.sequences:
        (layers,) = store.interval("sequence", name)["layers"].to_pylist()
        facts = Facts(graph, name, rules.load, with_faces="pose" in layers)
        found[name] = Annotations.read(store, name, rules), facts
    return found


def state_of(fit, who):
    return TRUE if who in fit.certain else UNKNOWN if who in fit.could else FALSE


def test_both_paths_see_the_same_relations_in_random_worlds(facts_of):
    """Every relation from everybody to everybody else who is not covered, at every keyframe."""
    seen = {}
    for annotations, facts in facts_of.values():
        for frame, people in facts.uncovered.items():
            for (source, other), relation in itertools.product(itertools.permutations(people, 2), RELATIONS):
                state = annotations.related(relation, source, other, frame)
                assert state == state_of(facts.follow(relation, source, frame), other), (relation, source, other, frame)
                seen.setdefault(RELATIONS[relation].kind, set()).add(state)
    assert seen == {kind: {TRUE, UNKNOWN, FALSE} for kind in ("social", "group", "first", "person", "window")}


def test_both_paths_see_the_same_conditions_in_random_worlds(facts_of):
    seen = {}
    for sequence, (annotations, facts) in facts_of.items():
        assert set(facts.keyframes) == annotations.keyframes
        assert all(sorted(facts.uncovered[one]) == annotations.uncovered_people(one) for one in facts.keyframes)
        sighted = [(who, frame) for frame, people in facts.uncovered.items() for who in people]
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


def choices_of(search, one):
    """The choices of a proposal, as texts; None if it has too few."""
    candidate = make_candidate(one)
    sets = wrong_sets(candidate.wrong) if one.template.asks_action else [tuple(candidate.wrong)]
    return None if not sets else tuple(map(choice_text, Question(candidate, sets[0]).choices))


def compare_refused(store, sequence, most=30):
    """Compare the outcomes of perturbations of candidates that they refuse, at most so many of each form and rule.

    Returns how often each proof of a form had each outcome.
    """
    annotations, counts = Annotations.read(store, sequence, RULES), Counter()
    with searched(store, sequence, RULES) as search:
        for template in forms_in(store, sequence):
            prover, refused = make_prover(search), defaultdict(list)
            for one in some_of([*proposals(search, template)], 150):
                if choices_of(search, one) is not None:
                    before = Counter(prover.counts)
                    prover.prove(one)
                    for rule in prover.counts - before:
                        refused[rule].append(one)
            for rule in ("hop.stop", "hop.skip", "time.shift", "time.drop"):
                for one in some_of(refused[rule], most):
                    own = rederive(annotations, one.plan, template.name, RULES, choices_of(search, one))
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
        world = with_chorus(make)(random.Random(seed), sequence)
        counts += compare_refused(memory_store(tmp_path / sequence, world), sequence)
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
    world = with_chorus(lambda *_, few=world: few)(None, SEQUENCE)
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
