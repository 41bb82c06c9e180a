"""The second path against the first: the same facts, relations, conditions and people in random worlds."""

import random
import re
from collections import Counter
from itertools import product

import loaded_stores
import pytest
from environment import DEEP
from msgspec.structs import replace
from oracle_candidates import EMPTY, MAYBE, RELATIONS, SEVERAL, WINDOWS, World
from oracle_choices import NO, YES, doing, false_choices, same, true_choices, wrong_sets
from oracle_files import ACTIONS
from random_worlds import in_other_words, lively_world, random_world, sociable_world, with_chorus

from jrdb_avr.engine.rederive import FALSE, TRUE, UNKNOWN, Annotations, prove_again, rederive
from jrdb_avr.engine.rederive.choices import is_false_around, is_supported
from jrdb_avr.schema.choice_labels import CHOICE_LABELS
from jrdb_avr.schema.labels import DISTANCE_WORDS, POSES, ROBOT_SECTORS, choice_text
from jrdb_avr.schema.plan import Condition, Time, canonical, parse_plan
from jrdb_avr.schema.rules import LoadRules, Rules
from jrdb_avr.schema.templates import TEMPLATES
from jrdb_avr.schema.wording.text import form_of

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


FACTS = {YES: TRUE, NO: FALSE, MAYBE: UNKNOWN}
OUTCOMES = {EMPTY: ("empty", None), SEVERAL: ("ambiguous", None), MAYBE: ("unknown", None)}


def oracles(store, rules):
    """The second path and the brute-force oracle of each sequence."""
    for sequence in store.sequences:
        world = World(store.path.parent / "root", sequence, rules.load.visibility == "clear")
        yield Annotations.read(store, sequence, rules), world


def test_the_second_path_sees_the_relations_and_conditions_of_the_oracle(store_and_rules):
    steps, seen = Counter(), Counter()
    for annotations, world in oracles(*store_and_rules):
        for frame in world.keyframes:
            people = world.counting(frame)
            for track, relation in product(people, (*RELATIONS, *WINDOWS)):
                reached = world.step(frame, track, relation)
                found = annotations.step_to(relation, track, frame)
                assert found == OUTCOMES.get(reached, ("defined", reached)), (world.sequence, relation, track, frame)
                steps[found[0]] += 1
            every = {condition for track in people for condition in world.conditions(frame, track)}
            for track, condition in product(people, every):
                [plain] = world.plain([condition])
                state = annotations.holds(Condition(**plain), track, frame)
                assert state == FACTS[world.value(condition, frame, track)], (world.sequence, condition, track, frame)
                seen[condition[0], state] += 1
    assert min(steps[outcome] for outcome in ("defined", "empty", "ambiguous", "unknown")) > 10
    assert {kind for kind, state in seen if state == UNKNOWN} == {*Rules().condition_order}


def test_the_second_path_judges_choices_as_the_oracle_does(store_and_rules):
    seen = Counter()
    for annotations, world in oracles(*store_and_rules):
        assert annotations.shown_actions & ACTIONS == world.shown_actions
        for frame in world.keyframes:
            for track in world.in_frame(frame):
                facts = {action: annotations.performs(track, action, frame) for action in CHOICE_LABELS}
                assert facts == {one: FACTS[doing(world, frame, track, one)] for one in CHOICE_LABELS}
                true = {a for a in facts if facts[a] == TRUE and is_supported(annotations, track, a, frame)}
                false = {a for a in facts if is_false_around(annotations, track, a, frame)}
                assert true == true_choices(world, frame, track), (world.sequence, track, frame)
                assert false == false_choices(world, frame, track), (world.sequence, track, frame)
                seen.update(facts.values())
                seen.update(true=len(true), false=len(false))
    assert min(seen.values()) > 100 and set(seen) == {TRUE, FALSE, UNKNOWN, "true", "false"}


# -- whole questions ------------------------------------------------------------------------------------------------


def holding(template, proofs):
    """Whether the proofs of a question hold that must: one shift, and of a fork one of b and c."""
    groups = {}
    for proof in proofs:
        either = proof.kind == "time.shift" or (template.joins and proof.kind == "hop.stop" and proof.variant != "0")
        if proof.holds is not None and (proof.kind != "view.single" or not template.single_view):
            groups.setdefault(proof.kind if either else (proof.kind, proof.variant), []).append(proof.holds)
    return all(map(any, groups.values()))


def accepted(annotations, template, plan, choices, rules):
    """(target, answer) if the second path finds no fault in a question, else None."""
    outcome = rederive(annotations, plan, template.name, rules, [choice_text(choice) for choice in choices])
    if outcome.outcome != "defined" or outcome.faults:
        return None
    if not holding(template, prove_again(annotations, plan, template.name, rules, outcome)):
        return None
    return outcome.target, outcome.answer


def words_of(plan):
    conditions = [condition for node in plan.nodes for condition in node.conditions]
    return {one.action or one.interaction or one.verb for one in conditions} | {edge.relation for edge in plan.edges}


def choices_of(world, template, plan, target, answer):
    """Every three wrong choices beside the answer; one empty set where choices are fixed or there are none."""
    if not template.pose_answer:
        return [()]
    frames = [plan.times[name].frame for name in plan.answer.times]
    if frames == [None]:
        [frames] = [[world.next_pose(plan.times["t0"].frame, target)]]
    among = POSES if template.name == "consequence" else ACTIONS
    return wrong_sets(world, frames[0], target, answer, words_of(plan), among)


def mutated(rng, template, plan, keyframes):
    """The same description with a later time or a relation changed."""
    later = [name for name in template.stated if name != template.described]
    if template.edges and (not later or rng.random() < 0.5):
        index = rng.randrange(len(plan.edges))
        join = template.uses[index] == "join"
        relation = rng.choice([r for r in (*RELATIONS, *WINDOWS) if join or r not in WINDOWS])
        edges = [replace(edge, relation=relation) if n == index else edge for n, edge in enumerate(plan.edges)]
        return replace(plan, edges=tuple(edges))
    if not later:
        return plan
    return replace(plan, times=plan.times | {rng.choice(later): Time(frame=rng.choice(keyframes))})


def compare(store, rules, most):
    """Ask the second path for what the oracle proves, and for plans and choices that differ a little."""
    counts = Counter()
    for annotations, world in oracles(store, rules):
        proven = {found for t0 in world.keyframes for track in world.in_frame(t0) for found in world.of(track, t0)}
        rng, by_form = random.Random(world.sequence), {}
        for name, target, text, answer in sorted(proven):
            by_form.setdefault(form_of(name, parse_plan(text))[0].query, []).append((name, target, text, answer))
        for query, rows in by_form.items():
            template = TEMPLATES[query]
            for _, target, text, answer in rng.sample(rows, min(most, len(rows))):
                plan = parse_plan(text)
                sets = choices_of(world, template, plan, target, answer)
                wrong = rng.choice(sets)
                found = accepted(annotations, template, plan, (answer, *wrong), rules)
                told = found and (found[0], rounded(found[1]))
                assert told == (target, rounded(answer)), (world.sequence, query, text, wrong)
                counts[query, "proven"] += 1
                if not template.pose_answer:
                    continue
                other = [*wrong[:2], rng.choice(CHOICE_LABELS)]
                found = accepted(annotations, template, plan, (answer, *other), rules)
                assert (found is not None) == (tuple(sorted(other)) in sets), (world.sequence, query, text, other)
                counts[query, "choices", found is not None] += 1
                if template.name != "consequence":
                    counts[refused(rng, annotations, world, template, plan, proven, rules)] += 1
    return counts


def refused(rng, annotations, world, template, plan, proven, rules):
    """Compare a plan nearby: whether it is proven for some action."""
    plan = mutated(rng, template, plan, world.keyframes)
    text = canonical(plan)
    found = {(target, answer) for name, target, stored, answer in proven if (name, stored) == (template.name, text)}
    targets = {target for target, _ in found}
    for answer in CHOICE_LABELS:
        outcome = rederive(annotations, plan, template.name, rules, [choice_text(answer)])
        target = outcome.target if outcome.target is not None else min(targets, default=None)
        sets = choices_of(world, template, plan, target, answer) if target is not None else []
        wrong = rng.choice(sets) if sets else [one for one in CHOICE_LABELS if not same(one, answer)][:3]
        second = accepted(annotations, template, plan, (answer, *wrong), rules)
        accepts = second == (target, answer)
        assert accepts == ((target, answer) in found), (world.sequence, text, answer, wrong)
    return template.query, "nearby", bool(found)


def rounded(answer):
    """An answer without the last bits of its floats."""
    return re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.6f}", answer)


@pytest.mark.parametrize("visibility", ["any", "clear"])
def test_the_second_path_accepts_exactly_what_the_oracle_proves(tmp_path, visibility):
    rules, counts = Rules(load=LoadRules(visibility=visibility)), Counter()
    worlds = [(lively_world, 0), (lively_world, 5), (sociable_world, 7), (sociable_world, 12)]
    for make, seed in worlds + [(in_other_words(lively_world), 3)] * DEEP:
        world = with_chorus(make)(random.Random(seed), f"yard-{seed:02d}")
        counts += compare(memory_store(tmp_path / f"{seed}", world, rules), rules, 30 if DEEP else 8)
    assert {query for query, kind, *_ in counts if kind == "proven"} == {row.query for row in TEMPLATES.values()}
