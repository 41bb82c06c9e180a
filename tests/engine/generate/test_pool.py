"""The pool of a template holds what single proofs allow: in the order of keys, without near-duplicates, up to a cap."""

import random
from collections import Counter

import msgspec
import pytest
from environment import DEEP
from keyframe_layers import forms_in, make_prover, proposals, searched
from loaded_stores import memory_store
from random_worlds import lively_world, random_world, sociable_world

from jrdb_avr.engine.generate.diagnostics import RULES as REASONS
from jrdb_avr.engine.generate.held_out import Extent
from jrdb_avr.engine.generate.near_duplicates import near_frames
from jrdb_avr.engine.generate.pool import _is_near, fill_pool
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FORMS

RULES = Rules(max_per_person=2)
SEQUENCE = "yard-2020-01-01_0"


@pytest.fixture(scope="module", params=range(9 if DEEP else 3))
def search(request, tmp_path_factory):
    make = (sociable_world, lively_world, random_world)[request.param % 3]
    store = memory_store(tmp_path_factory.mktemp("pool"), make(random.Random(7 + request.param), SEQUENCE))
    with searched(store, SEQUENCE, RULES) as search:
        yield search, forms_in(store, SEQUENCE)


def pools(search, allowed, held_out=()):
    """{template: (prover, pool)}."""
    for name, forms in FORMS.items():
        if some := [form for form in forms if form in allowed]:
            prover = make_prover(search, held_out)
            yield name, some, prover, fill_pool(search, some, prover)


def are_near(name, one, other):
    near = near_frames(name, RULES)
    return (one.target, one.answer) == (other.target, other.answer) and all(
        abs(a - b) <= near for a, b in zip(one.read, other.read, strict=True)
    )


def choose_slowly(name, proven):
    """The proven proposals that stay, one after the other by their keys."""
    kept, counts = [], Counter()
    for one in sorted(proven, key=lambda one: one.key):
        group = one.target, one.answer
        if counts[group] < RULES.max_per_person and not any(are_near(name, one, other) for other in kept):
            kept.append(one)
            counts[group] += 1
    return {one.key for one in kept}


def test_the_pool_is_the_greedy_choice_among_the_proven(search):
    search, allowed = search
    total = 0
    for name, forms, prover, pool in pools(search, allowed):
        every = [one for form in forms for one in proposals(search, form)]
        proven = [one for one in every if make_prover(search).prove(one) is not None]
        keys = {one.key for one, _ in pool}
        assert keys <= {one.key for one in proven}
        if name == "presence":
            # One description of many is enough, so other ones may stay.
            places = [(one.target, one.read) for one, _ in pool]
            assert len(set(places)) == len(places) and bool(pool) == bool(proven)
            assert not any(are_near(name, one, other) for one, _ in pool for other, _ in pool if one is not other)
        else:
            assert keys == choose_slowly(name, proven)
            tried = Counter(refused.rule for refused in prover.refused)
            assert len(every) == len(pool) + tried.total() + prover.untried.total()
            assert tried.keys() | prover.untried.keys() <= REASONS.keys()
        total += len(pool)
    assert total


def needed_of(one):
    """Tracks and frames of a proposal: those of its plan, its answer and its boxes."""
    names = (*one.template.stated, *one.template.read, *one.template.decisive)
    frames = {one.frames[name] for name in names} | {frame for _, frame in one.counted}
    return {*one.people.values(), *(who for who, _ in one.counted)}, min(frames), max(frames)


def test_no_question_touches_a_held_out_one(search):
    search, allowed = search
    tracks = sorted({who for people in search.layer.facts.people.values() for who in people})
    held_out = (Extent(tuple(tracks[::3]), 60, 90), Extent(tuple(tracks[1::3]), 120, 135))
    for name, _, prover, pool in pools(search, allowed, held_out):
        for one, _ in pool:
            people, first, last = needed_of(one)
            assert not any(people & set(e.tracks) and first <= e.last and last >= e.first for e in held_out), name
        for one, rule, _ in prover.refused:
            people, first, last = needed_of(one)
            touches = any(people & set(e.tracks) and first <= e.last and last >= e.first for e in held_out)
            assert touches == (rule == "held_out")


def test_both_shifts_in_time_may_be_required(search):
    """Then a question whose answer stays the same at one of the two shifted times is refused."""
    search, allowed = search
    strict = msgspec.structs.replace(search.rules, time_shift="both")
    for _, forms, _, pool in pools(search, [form for form in allowed if form.time_proof != "construction"]):
        prover = make_prover(search.__class__(search.graph, search.sequence, search.layer, strict))
        for one, proofs in pool:
            same = any(proof.kind == "time.shift" and proof.outcome == "same" for proof in proofs)
            assert (prover.prove(one) is None) == same, forms


def test_of_presence_five_seconds_at_both_times_are_near():
    near = near_frames("presence", Rules())
    assert _is_near((75, 25), (0, 100), near) and not _is_near((0, 176), (0, 100), near)
    assert near_frames("change", Rules()) < near
