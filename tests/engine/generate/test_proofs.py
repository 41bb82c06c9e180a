"""Which hops of a path are left out, and which proofs must hold, by small cases."""

import pytest

from jrdb_avr.engine.generate.programs import hops, make_program
from jrdb_avr.engine.generate.proofs import failing
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, SAME_GROUP
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES, Slots

RELATIONS = {
    "two_hop": (FIRST_LEFT, SAME_GROUP),
    "three_hop": (FIRST_LEFT, SAME_GROUP, FIRST_RIGHT),
    "fork_join": (FIRST_LEFT, FIRST_RIGHT, SAME_GROUP, SAME_GROUP),
}


def hops_of(form):
    """Kind and variant of each proof about hops."""
    template = TEMPLATES[form]
    plan = template.build(Slots((Condition(action="sitting", at="t0"),), {"t0": 15}, (), RELATIONS[form]))
    return {(kind, variant) for kind, variant, _ in hops(make_program("s", plan, template))}


@pytest.mark.parametrize(("form", "stops", "skips"), [("two_hop", 2, 1), ("three_hop", 3, 2), ("fork_join", 3, 4)])
def test_every_hop_is_left_out_and_every_person_is_the_last_once(form, stops, skips):
    expected = {("hop.stop", str(place)) for place in range(stops)}
    assert hops_of(form) == expected | {("hop.skip", str(hop + 1)) for hop in range(skips)}


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
    proofs = {("anchor", "match"), ("view.single", "any angle"), ("time.shift", "-3 s"), ("time.shift", "+3 s")}
    proofs |= hops_of(form)
    assert wrong <= proofs
    stored = [Proof(*proof, proof not in wrong, "same" if proof in wrong else "empty") for proof in sorted(proofs)]
    assert failing(form, stored, Rules()) == reported
    shifts = [f"{kind} {variant}" for kind, variant in sorted(wrong) if kind == "time.shift"]
    assert set(failing(form, stored, Rules(time_shift="both"))) == {*reported, *shifts}


def test_a_time_that_is_the_answer_is_not_moved():
    not_run = [Proof(kind, "by construction", None, "not_run") for kind in ("time.shift", "time.drop")]
    assert failing("start", not_run, Rules()) == []
    assert failing("start", [Proof("anchor", "match", None, "not_run")], Rules()) == ["anchor match"]
