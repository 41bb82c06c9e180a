"""The second path against the first: the same facts, relations, conditions and people in random worlds."""

import random
from collections import Counter

import loaded_stores
import numpy as np
import pytest
from environment import DEEP
from keyframe_layers import all_steps, searched
from random_worlds import SEQUENCE, build, in_other_words, lively_world, random_world, sociable_world

from jrdb_avr.engine.generate.candidates import OUTCOMES, PASSED, VALUES, to_table
from jrdb_avr.engine.generate.candidates import RULES as RULE_NAMES
from jrdb_avr.engine.generate.conditions import find_conditions
from jrdb_avr.engine.generate.proofs import stored_proofs
from jrdb_avr.engine.generate.records import bindings, needed_boxes
from jrdb_avr.engine.generate.relations import find_facts
from jrdb_avr.engine.generate.scene import NOBODY, load_scene
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.engine.rederive import FALSE, TRUE, UNKNOWN, Annotations, prove_again, rederive
from jrdb_avr.schema.labels import DISTANCE_WORDS, POSES, ROBOT_SECTORS
from jrdb_avr.schema.plan import Condition, parse_plan
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import LoadRules, Rules
from jrdb_avr.schema.templates import TEMPLATES

RULES = Rules(load=LoadRules(visibility="any"))
CLEAR = Rules(load=LoadRules(visibility="clear"))


def at_t0(**kwargs):
    return Condition(at="t0", **kwargs)


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


def possible_sizes(row):
    return [] if row["group_size_min"] is None else [*range(row["group_size_min"], row["group_size_max"] + 1)]


@pytest.fixture(params=["any", "clear"])
def store_and_rules(request):
    names = {"any": ("random_store", RULES), "clear": ("judged_store", CLEAR)}
    name, rules = names[request.param]
    return request.getfixturevalue(name), rules


def test_both_paths_see_the_same_facts_in_random_worlds(store_and_rules):
    """Facts of the per-frame tables and of the interval tables, worked out by programs that share nothing."""
    random_store, rules = store_and_rules
    seen = 0
    for sequence in random_store.sequences:
        annotations = Annotations.read(random_store, sequence, rules)
        for row in random_store.interval("sightings", sequence).to_pylist():
            track, frame = row["track"], row["frame"]
            seen += 1
            assert annotations.clear(track, frame) == row["clear"]
            assert annotations.covered(track, frame) == row["covered"]
            assert annotations.pose(track, frame) == row["pose"]
            assert [*annotations.group_sizes(track, frame)] == possible_sizes(row)
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


def test_both_paths_see_the_same_relations_in_random_worlds(random_store):
    """Every relation that leads to somebody anywhere, from everybody at every keyframe."""
    seen = {}
    for sequence in random_store.sequences:
        annotations = Annotations.read(random_store, sequence, RULES)
        with searched(random_store, sequence, RULES) as context:
            for frame, track, relation, outcome, target in zip(*all_steps(context).to_pydict().values(), strict=True):
                found = annotations.step_to(relation, track, frame)
                assert found == (outcome, target), (sequence, relation, track, frame)
                seen.setdefault(relation, set()).add(outcome)
    assert sum("defined" in outcomes for outcomes in seen.values()) > 10
    assert set().union(*seen.values()) == {"defined", "empty", "ambiguous", "unknown"}


def test_both_paths_see_the_same_conditions_in_random_worlds(random_store):
    seen = {}
    for sequence in random_store.sequences:
        annotations = Annotations.read(random_store, sequence, RULES)
        scene = load_scene(random_store, sequence)
        conditions = find_conditions(scene, find_facts(scene), RULES)
        for code, condition in enumerate(conditions.vocabulary):
            for sighting, moment in enumerate(conditions.moment.tolist()):
                person, place = divmod(moment, len(scene.keyframes))
                track, frame = int(scene.tracks[person]), int(scene.keyframes[place])
                state = int(conditions.states[sighting, code])
                assert annotations.holds(condition, track, frame) == state, (sequence, condition, track, frame)
                seen.setdefault(conditions.vocabulary[code].kind, set()).add(state)
    assert set(seen) == set(RULES.condition_order)
    assert all(states >= {TRUE, UNKNOWN} for states in seen.values())


def compare(store, sequence, most=60):
    """Ask the second path for what the first has proven, at most so many of a template; how many were asked for."""
    annotations = Annotations.read(store, sequence, RULES)
    counts = {}
    with searched(store, sequence, RULES) as context:
        for template in TEMPLATES.values():
            if not set(template.layers) <= context.scene.layers:
                continue
            found = find_candidates(context, template)
            rows = np.flatnonzero(found.rule == PASSED)
            rows = rows[:: max(1, len(rows) // most)]
            for line in to_table(context, found, rows, keyed=False).to_pylist():
                second = rederive(annotations, parse_plan(line["plan"]), template.name, RULES)
                told = (second.outcome, second.answer, second.target, second.faults)
                assert told == ("defined", line["answer"], line["target_track"], ()), line["plan"]
                assert dict(second.people) | dict(second.times) == bindings(context, found, line["row"]), line["plan"]
                needed = needed_boxes(context, found, line["row"])
                assert set(second.needed) == set(needed), line["plan"]
                proofs = stored_proofs(context, found, line["row"], line["answer"], needed)
                again = prove_again(annotations, parse_plan(line["plan"]), template.name, RULES, second)
                assert set(again) - set(proofs) == {Proof("rederive", "annotations", True, "same", line["answer"])}, (
                    line["plan"]
                )
                assert set(proofs) < set(again), line["plan"]
                counts[template.query] = counts.get(template.query, 0) + 1
    return counts


def compare_refused(store, sequence, most=30):
    """Compare the outcomes of perturbations of candidates that they refuse, at most so many of each form and rule.

    Returns how often each proof of a form had each outcome.
    """
    annotations = Annotations.read(store, sequence, RULES)
    counts = Counter()
    with searched(store, sequence, RULES) as context:
        for template in TEMPLATES.values():
            found = find_candidates(context, template) if set(template.layers) <= context.scene.layers else None
            for rule in ("hop.stop", "hop.skip", "time.shift", "time.drop") if found and found.perturbed else ():
                rows = np.flatnonzero(found.rule == RULE_NAMES.index(rule))
                rows = rows[:: max(1, len(rows) // most)]
                for line in to_table(context, found, rows, keyed=False).to_pylist():
                    plan = parse_plan(line["plan"])
                    own = rederive(annotations, plan, template.name, RULES)
                    again = prove_again(annotations, plan, template.name, RULES, own)
                    again = {(proof.kind, proof.variant): (proof.outcome, proof.answer) for proof in again}
                    for result in found.perturbed:
                        if (rule, result.kind, template.time_proof) == ("hop.stop", "time.shift", "program"):
                            # Not tried at other times.
                            continue
                        answer = result.answer[line["row"]]
                        first = OUTCOMES[result.outcome[line["row"]]], VALUES[answer] if answer != NOBODY else None
                        assert again[result.kind, result.variant] == first, (result.kind, line["plan"])
                        counts[template.query, result.kind, result.variant, first[0]] += 1
    return counts


def test_both_paths_perturb_alike_where_a_candidate_is_refused(tmp_path):
    counts = Counter()
    for seed in range(8 if DEEP else 4):
        sequence, make = f"yard-{seed:02d}", sociable_world if seed < 2 else lively_world
        counts += compare_refused(memory_store(tmp_path / sequence, make(random.Random(seed), sequence)), sequence)
    assert {"hop.stop", "hop.skip", "time.shift", "time.drop"} == {kind for _, kind, _, _ in counts}


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
