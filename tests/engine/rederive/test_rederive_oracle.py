"""The second path against the brute-force oracle: the choices of actions, and whole questions, in random worlds."""

import random
import re
from collections import Counter

import pytest
from environment import DEEP
from loaded_stores import memory_store
from msgspec.structs import replace
from oracle_candidates import RELATIONS, WINDOWS, World
from oracle_choices import MAYBE, NO, YES, doing, false_choices, same, true_choices
from oracle_files import ACTIONS
from random_worlds import in_crowds, in_other_words, lively_world, random_world, sociable_world, with_chorus

from jrdb_avr.engine.rederive import FALSE, TRUE, UNKNOWN, Annotations, prove_again, rederive
from jrdb_avr.engine.rederive.choices import is_false_around, is_supported
from jrdb_avr.schema.choice_labels import CHOICE_LABELS
from jrdb_avr.schema.labels import choice_text
from jrdb_avr.schema.plan import Time, canonical, parse_plan
from jrdb_avr.schema.rules import LoadRules, Rules
from jrdb_avr.schema.templates import TEMPLATES
from jrdb_avr.schema.wording.text import form_of

VISIBILITIES = pytest.mark.parametrize("visibility", ["any", "clear"])
FACTS = {YES: TRUE, NO: FALSE, MAYBE: UNKNOWN}


def oracles(folder, makers, visibility):
    """The second path, the brute-force oracle and the rules of each of some worlds, from makers and seeds."""
    rules = Rules(load=LoadRules(visibility=visibility))
    for number, (make, seed) in enumerate(makers):
        store = memory_store(folder / str(number), make(random.Random(seed), "yard"), visibility=visibility)
        for sequence in store.sequences:
            world = World(folder / str(number) / "root", sequence, visibility == "clear")
            yield Annotations.read(store, sequence, rules), world, rules


@VISIBILITIES
def test_the_second_path_judges_choices_as_the_oracle_does(tmp_path, visibility):
    makers = [(random_world, seed) for seed in range(0, 10, 2)]
    makers += [(in_crowds(in_other_words(random_world)), seed) for seed in range(1, 10, 2)]
    seen = Counter()
    for annotations, world, _ in oracles(tmp_path, makers, visibility):
        assert annotations.shown_actions & ACTIONS == world.shown_actions
        for frame in world.keyframes:
            for track in world.in_frame(frame):
                facts = {action: annotations.performs(track, action, frame) for action in CHOICE_LABELS}
                assert facts == {one: FACTS[doing(world, frame, track, one)] for one in CHOICE_LABELS}
                true = {a for a in facts if facts[a] == TRUE and is_supported(annotations, track, a, frame)}
                false = {a for a in facts if is_false_around(annotations, track, a, frame)}
                assert true == true_choices(world, frame, track), (track, frame)
                assert false == false_choices(world, frame, track), (track, frame)
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


def choices_of(world, template, plan, target, answer):
    """Every three wrong choices beside the answer; one empty set where choices are fixed."""
    return world.wrong_sets(template.name, canonical(plan), target, answer) if template.asks_action else [()]


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


def compare(annotations, world, rules, most):
    """Ask the second path for what the oracle proves, and for plans and choices that differ a little."""
    counts, rng, by_form = Counter(), random.Random(0), {}
    proven = world.proven()
    for name, target, text, answer in sorted(proven):
        by_form.setdefault(form_of(name, parse_plan(text))[0].query, []).append((target, text, answer))
    for query, rows in by_form.items():
        template = TEMPLATES[query]
        for target, text, answer in rng.sample(rows, min(most, len(rows))):
            plan = parse_plan(text)
            sets = choices_of(world, template, plan, target, answer)
            wrong = rng.choice(sets)
            found = accepted(annotations, template, plan, (answer, *wrong), rules)
            told = found and (found[0], rounded(found[1]))
            assert told == (target, rounded(answer)), (query, text, wrong)
            counts[query, "proven"] += 1
            if not template.asks_action:
                continue
            other = [*wrong[:2], rng.choice(CHOICE_LABELS)]
            found = accepted(annotations, template, plan, (answer, *other), rules)
            assert (found is not None) == (tuple(sorted(other)) in sets), (query, text, other)
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
        assert accepts == ((target, answer) in found), (text, answer, wrong)
    return template.query, "nearby", bool(found)


def rounded(answer):
    """An answer without the last bits of its floats."""
    return re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.6f}", answer)


@VISIBILITIES
def test_the_second_path_accepts_exactly_what_the_oracle_proves(tmp_path, visibility):
    makers = [(lively_world, 0), (lively_world, 5), (sociable_world, 7), (sociable_world, 12)]
    makers += [
        (in_crowds(in_other_words(make)), seed) for make in (lively_world, sociable_world) for seed in range(9 * DEEP)
    ]
    counts, chorus = Counter(), [(with_chorus(make), seed) for make, seed in makers]
    for annotations, world, rules in oracles(tmp_path, chorus, visibility):
        counts += compare(annotations, world, rules, 30 if DEEP else 4)
    assert {query for query, kind, *_ in counts if kind == "proven"} == {row.query for row in TEMPLATES.values()}
