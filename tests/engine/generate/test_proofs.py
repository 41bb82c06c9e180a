"""Which proofs a question needs, by small cases."""

import pytest

from jrdb_avr.engine.generate.proofs import expected, failing
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, SAME_GROUP
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES, Slots


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
