"""The pool of a template holds what single proofs allow: in the order of keys, without near-duplicates, up to a cap."""

import copy
import random
from collections import Counter
from itertools import combinations, islice
from types import SimpleNamespace

import msgspec
import pytest
from environment import DEEP
from keyframe_layers import forms_in, make_prover, proposals, searched
from loaded_stores import memory_store
from random_worlds import lively_world, sociable_world

from jrdb_avr.engine.generate import pool as pool_module
from jrdb_avr.engine.generate.choices import wrong_sets
from jrdb_avr.engine.generate.diagnostics import RULES as REASONS
from jrdb_avr.engine.generate.held_out import Extent
from jrdb_avr.engine.generate.near_duplicates import are_near, near_frames
from jrdb_avr.engine.generate.pool import fill_pool, make_candidate
from jrdb_avr.engine.generate.propose import Proposal
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FORMS, TEMPLATES

RULES = Rules(max_per_person=2)
SEQUENCE = "yard-2020-01-01_0"


@pytest.fixture(scope="module", params=range(6 if DEEP else 2))
def search(request, tmp_path_factory):
    make = (sociable_world, lively_world)[request.param % 2]
    store = memory_store(tmp_path_factory.mktemp("pool"), make(random.Random(7 + request.param), SEQUENCE))
    with searched(store, SEQUENCE, RULES) as search:
        yield search, forms_in(store, SEQUENCE)


def pools(search, allowed, held_out=()):
    """(name, forms, prover, candidates, their proposals) of each template."""
    for name, forms in FORMS.items():
        if some := [form for form in forms if form in allowed]:
            prover = make_prover(search, held_out)
            pool = fill_pool(search, some, prover)
            made = [Proposal(search, TEMPLATES[one.form], msgspec.msgpack.decode(one.row)) for one in pool]
            yield name, some, prover, pool, made


def read_alike(name, one, other):
    near = near_frames(name, RULES)
    return (one.target, one.answer) == (other.target, other.answer) and all(
        abs(a - b) <= near for a, b in zip(one.read, other.read, strict=True)
    )


def choose_slowly(name, proven):
    """The proven proposals that stay, one after the other by their keys."""
    kept, counts = [], Counter()
    for one in sorted(proven, key=lambda one: one.key):
        group = one.target, one.answer
        if counts[group] < RULES.max_per_person and not any(read_alike(name, one, other) for other in kept):
            kept.append(one)
            counts[group] += 1
    return {one.key for one in kept}


def test_the_pool_holds_what_a_selection_can_use(search, monkeypatch):
    search, allowed = search
    monkeypatch.setattr(pool_module, "_TRIES", 10_000)
    total = 0
    for name, forms, prover, pool, made in pools(search, allowed):
        every = [one for form in forms for one in proposals(search, form)]
        every = [one for one in every if not one.template.asks_action or wrong_sets(make_candidate(one).wrong)]
        proven = [one for one in every if make_prover(search).prove(one) is not None]
        assert len({one.key for one in pool}) == len(pool)
        assert {(one.key, one.answer) for one in made} <= {(one.key, one.answer) for one in proven}
        assert prover.counts.keys() <= REASONS.keys()
        if name == "presence":
            assert bool(pool) == bool(proven)
            groups = Counter((one.track, one.described, one.truth) for one in pool)
            assert not groups or max(groups.values()) <= pool_module._PAIRS
            assert not any(
                (one.described, one.asked) != (other.described, other.asked)
                and one.described == other.described
                and read_alike(name, a, b)
                for (one, a), (other, b) in combinations(zip(pool, made, strict=True), 2)
            )
        elif forms[0].asks_action:
            # One candidate of each moment and true answer at least.
            moments = {make_candidate(one)[3:8:2] for one in proven}
            assert {one[3:8:2] for one in pool} == moments
        else:
            assert {one.key for one in made} == choose_slowly(name, proven)
            assert len(every) == len(pool) + prover.counts.total()
        total += len(pool)
    assert total


def needed_of(one):
    """Tracks and frames of a proposal: those of its plan, its answer and its boxes."""
    names = (*one.template.stated, *one.template.read, *one.template.decisive)
    frames = {one.frames[name] for name in names} | {frame for _, frame in one.counted}
    return {*one.people.values(), *(who for who, _ in one.counted)}, min(frames), max(frames)


def test_no_question_touches_a_held_out_one(search):
    search, allowed = search
    tracks = sorted({who for people in search.facts.people.values() for who in people})
    held_out = (Extent(tuple(tracks[::3]), 60, 90), Extent(tuple(tracks[1::3]), 120, 135))
    for name, forms, prover, _, made in pools(search, allowed, held_out):
        for one in made:
            people, first, last = needed_of(one)
            assert not any(people & set(e.tracks) and first <= e.last and last >= e.first for e in held_out), name
        for one in islice((one for form in forms for one in proposals(search, form)), 300):
            people, first, last = needed_of(one)
            touches = any(people & set(e.tracks) and first <= e.last and last >= e.first for e in held_out)
            before = prover.counts["held_out"]
            prover.prove(one)
            assert prover.counts["held_out"] - before == touches


def test_both_shifts_in_time_may_be_required(search):
    """Then a question whose answer stays the same at one of the two shifted times is refused."""
    search, allowed = search
    strict = msgspec.structs.replace(search.rules, time_shift="both")
    for _, forms, lenient, _, made in pools(search, [form for form in allowed if form.time_proof != "construction"]):
        strictly = copy.copy(search)
        strictly.rules = strict
        prover = make_prover(strictly)
        for one in made:
            proofs = lenient.prove(one)
            same = any(proof.kind == "time.shift" and proof.outcome == "same" for proof in proofs)
            assert (prover.prove(one) is None) == same, forms


def test_of_presence_five_seconds_at_both_times_are_near():
    near = near_frames("presence", Rules())
    assert are_near((75, 25), (0, 100), near) and not are_near((0, 176), (0, 100), near)
    assert near_frames("change", Rules()) < near


def test_a_limit_leaves_out_candidates_but_no_person_first(search):
    search, allowed = search
    limited = 0
    for name, forms, _, every, _ in pools(search, allowed):
        people = {one.track for one in every}
        some = fill_pool(search, forms, make_prover(search), len(people))
        assert len(some) >= min(len(every), len(people)), name
        assert 4 * len({one.track for one in some}) >= len(people), name
        limited += len(some) < len(every)
    assert limited


def test_the_rank_of_a_row_does_not_depend_on_the_sequences_before_it():
    """Ids of names and segments begin at `low` in each sequence. Another sequence before it moves both."""
    alone, behind = (SimpleNamespace(sequence="yard-2020-01-01_0", low=low) for low in (0, 5000))
    row = {"name": 7, "segment": 40, "t0": 30, "answer": "sitting"}
    moved = row | {"name": 5007, "segment": 5040}
    assert pool_module._rank(alone, row) == pool_module._rank(behind, moved)
    assert pool_module._rank(alone, row) != pool_module._rank(alone, row | {"segment": 41})
