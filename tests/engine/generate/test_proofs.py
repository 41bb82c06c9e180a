"""What a perturbed program proves, and which proofs a question needs, by small cases."""

import numpy as np
import pytest
from loaded_stores import memory_store
from random_worlds import SEQUENCE, build

from jrdb_avr.engine.generate.candidates import PASSED, RULES, Effect, PerturbationResult, first_refusing, proven_rules
from jrdb_avr.engine.generate.conditions import find_conditions
from jrdb_avr.engine.generate.proofs import expected, failing
from jrdb_avr.engine.generate.relations import find_facts
from jrdb_avr.engine.generate.scene import NO_MATCH, NOBODY, SEVERAL, UNDECIDED, load_scene
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, SAME_GROUP
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES, Slots


def result(kind, variant, *outcomes, any_of=False):
    codes = np.array(outcomes, np.int8)
    return PerturbationResult(kind, variant, codes, np.full(len(codes), NOBODY, np.int8), any_of)


def test_only_another_answer_several_people_or_nobody_prove():
    proves = result("hop.stop", "0", *Effect).proves()
    assert dict(zip(Effect, proves.tolist(), strict=True)) == {
        Effect.SAME: False,
        Effect.DIFFERENT: True,
        Effect.AMBIGUOUS: True,
        Effect.EMPTY: True,
        Effect.UNKNOWN: False,
        Effect.OUTSIDE: False,
    }


def test_every_hop_must_prove_and_one_of_two_shifts():
    same, other = Effect.SAME, Effect.DIFFERENT
    found = proven_rules(
        [
            result("hop.skip", "1", other, same, other),
            result("hop.skip", "2", other, other, same),
            result("time.shift", "-3 s", other, same, same, any_of=True),
            result("time.shift", "+3 s", same, same, other, any_of=True),
        ],
        Rules(),
    )
    assert {rule: holds.tolist() for rule, holds in found.items()} == {
        "hop.skip": [True, False, False],
        "time.shift": [True, False, True],
    }


def test_where_both_shifts_must_change_the_answer_neither_leaves_it_the_same():
    same, other, unknown, outside = Effect.SAME, Effect.DIFFERENT, Effect.UNKNOWN, Effect.OUTSIDE
    shifts = [
        result("time.shift", "-3 s", other, other, other, unknown, any_of=True),
        result("time.shift", "+3 s", same, other, outside, outside, any_of=True),
    ]
    assert proven_rules(shifts, Rules())["time.shift"].tolist() == [True, True, True, False]
    assert proven_rules(shifts, Rules(time_shift="both"))["time.shift"].tolist() == [False, True, True, False]


def test_a_shift_out_of_the_sequence_proves_nothing():
    outcome, answer = np.array([Effect.EMPTY] * 2, np.int8), np.array([1, 1], np.int8)
    shifted = PerturbationResult.of_shift(-45, outcome, answer, np.array([False, True]))
    assert shifted.proves().tolist() == [True, False]
    assert (shifted.variant, shifted.answer.tolist()) == ("-3 s", [1, NOBODY])


def test_time_matters_where_two_times_have_two_answers_or_there_is_no_second_time():
    dropped = PerturbationResult.of_drop(np.array([1, 2, 2]), np.array([1, 1, 2]))
    assert dropped.proves().tolist() == [True, False, True]


def test_the_first_rule_that_does_not_hold_refuses():
    holds = {"anchor": [True, True, False], "view.ahead": [True, False, False], "time.drop": [True, False, False]}
    rule = first_refusing({name: np.array(values) for name, values in holds.items()}, 3)
    assert rule.tolist() == [PASSED, RULES.index("view.ahead"), RULES.index("anchor")]


def test_a_condition_fits_one_person_where_it_is_false_of_everybody_else(tmp_path):
    store = memory_store(tmp_path, build(["1 | sssst | column 400", "2 | tw?st | column 900"]))
    scene = load_scene(store, SEQUENCE)
    conditions = find_conditions(scene, find_facts(scene), Rules())
    sitting = conditions.vocabulary.index(Condition(action="sitting", at="t0"))
    keyframes = np.arange(5)
    found = conditions.matches(keyframes, keyframes[:, None] * len(conditions.vocabulary) + sitting)
    # Moments of the first person are numbered as the keyframes are.
    assert found.tolist() == [0, 1, UNDECIDED, SEVERAL, NO_MATCH]


# -- which proofs a question needs ------------------------------------------------------------------------------------


def needed(form, relations):
    template = TEMPLATES[form]
    times = {name: 15 * number for number, name in enumerate(template.stated, 1)}
    actions = ("reading", "typing")[: template.actions]
    plan = template.build(Slots((Condition(action="sitting", at="t0"),), times, actions, relations))
    return template.name, {(kind, variant) for kind, variant in expected(template.name, plan, Rules())}


@pytest.mark.parametrize(
    ("form", "relations", "stops", "skips"),
    [
        ("two_hop", (FIRST_LEFT, SAME_GROUP), 2, 1),
        ("three_hop", (FIRST_LEFT, SAME_GROUP, FIRST_RIGHT), 3, 2),
        ("fork_join", (FIRST_LEFT, FIRST_RIGHT, SAME_GROUP, SAME_GROUP), 3, 4),
    ],
)
def test_every_hop_is_left_out_and_every_person_is_the_last_once(form, relations, stops, skips):
    _, proofs = needed(form, relations)
    assert {variant for kind, variant in proofs if kind == "hop.stop"} == {str(place) for place in range(stops)}
    assert {variant for kind, variant in proofs if kind == "hop.skip"} == {str(hop + 1) for hop in range(skips)}
    assert ("anchor", "without action sitting") in proofs and ("rederive", "annotations") in proofs


@pytest.mark.parametrize(
    ("form", "wrong", "reported"),
    [
        ("two_hop", set(), []),
        ("two_hop", {("time.shift", "-3 s")}, []),
        ("two_hop", {("time.shift", "-3 s"), ("time.shift", "+3 s")}, ["time.shift"]),
        ("two_hop", {("hop.stop", "1")}, ["hop.stop 1"]),
        ("two_hop", {("anchor", "match")}, ["anchor match"]),
        ("fork_join", {("hop.stop", "1")}, []),
        ("fork_join", {("hop.stop", "1"), ("hop.stop", "2")}, ["hop.stop"]),
        ("fork_join", {("hop.stop", "0")}, ["hop.stop 0"]),
        ("two_hop", {("view.single", "any angle")}, []),
    ],
)
def test_a_proof_that_does_not_hold_is_reported_unless_another_one_is_enough(form, wrong, reported):
    relations = {"two_hop": (FIRST_LEFT, SAME_GROUP), "fork_join": (FIRST_LEFT, FIRST_RIGHT, SAME_GROUP, SAME_GROUP)}
    name, proofs = needed(form, relations[form])
    assert wrong <= proofs
    stored = [Proof(*proof, proof not in wrong, "same" if proof in wrong else "empty") for proof in sorted(proofs)]
    assert failing(name, stored, Rules()) == reported
    shifts = [f"{kind} {variant}" for kind, variant in sorted(wrong) if kind == "time.shift"]
    assert set(failing(name, stored, Rules(time_shift="both"))) == {*reported, *shifts}


@pytest.mark.parametrize("form", ["start", "span", "action_search", "consequence", "gap"])
def test_a_time_that_is_the_answer_is_not_moved(form):
    relations = (FIRST_LEFT, FIRST_RIGHT) if form == "action_search" else ()
    name, proofs = needed(form if form != "gap" else "gap_absence", relations)
    assert {proof for proof in proofs if proof[0].startswith("time")} == {
        ("time.shift", "by construction"),
        ("time.drop", "by construction"),
    }
    not_run = [Proof(kind, variant, None, "not_run") for kind, variant in proofs if kind.startswith("time")]
    assert failing(name, not_run, Rules()) == []
    assert failing(name, [Proof("anchor", "match", None, "not_run")], Rules()) == ["anchor match"]
