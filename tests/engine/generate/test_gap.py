"""All questions about gaps of busy small worlds: what the search finds is what the second path finds by trying all."""

import itertools
import json
import random
import tempfile
from collections import Counter

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
from environment import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from keyframe_layers import search, searched, visible_share
from loaded_stores import memory_store, quick_store
from worlds import member, person, person_3d

from jrdb_avr.engine.generate.candidates import PASSED, to_table
from jrdb_avr.engine.generate.candidates import RULES as RULES_OF_CANDIDATES
from jrdb_avr.engine.generate.confirm import CONFIRMED, ConfirmJob, find_faults
from jrdb_avr.engine.generate.records import choice_sets, make_record
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.engine.rederive import UNKNOWN, Annotations, rederive
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import encode_answer
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import canonical, parse_plan
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES, Slots
from jrdb_avr.schema.wording.text import render

NAME = "yard-2020-01-01_0"
FORMS = [template for template in TEMPLATES.values() if template.name == "gap"]
RULES = Rules(gap_min_s=2.0, count_min=2, long_wait_s=4.0, min_wait_s=1.0)
"""Easier than the real ones, so that small worlds hold many questions."""


def busy_world(rng):
    """People who come and go, begin and end things, change groups and talk; once a second, or at every frame."""
    step, length = rng.choice(((15, 24), (15, 24), (1, 14)))
    silent = 0.004 if step == 15 else rng.choice((0.0, 0.001))
    # Between keyframes a hard label of somebody whose own list is missing would be one or the other.
    hard = 0.0 if step == 1 and silent else 0.02
    people = {
        track: {"x": rng.uniform(0, 3760), "pose": "standing", "extra": None, "here": True, "group": 1, "talks": set()}
        for track in range(1, rng.randrange(4, 8))
    }
    layers = {"2d": {}, "social": {}}
    for second in range(length):
        for track, life in people.items():
            life["here"] = life["here"] if rng.random() < 0.9 else not life["here"]
            if rng.random() < 0.12:
                life["pose"] = rng.choice(("walking", "standing", "sitting"))
            if rng.random() < 0.15:
                life["extra"] = rng.choice((None, "reading", "eating sth"))
            if rng.random() < 0.04:
                life["group"] = rng.choice((1, 1, 2))
            if rng.random() < 0.3:
                life["talks"] = {rng.choice(sorted(people)) for _ in range(rng.randrange(3))} - {track}
            life["x"] += rng.uniform(-30, 30)
        for frame in range(15 * second, 15 * second + 15, step):
            if rng.random() < (0.02 if step == 15 else 0.004):
                continue
            rows, lists = layers["2d"].setdefault(frame, []), layers["social"].setdefault(frame, [])
            for track, life in people.items():
                if not life["here"] or (step == 1 and rng.random() < 0.01):
                    continue
                actions = {life["pose"]: 3 if rng.random() < 0.01 else 1} | (
                    {life["extra"]: 1} if life["extra"] else {}
                )
                box = (round(life["x"] % 3760, 1), 100, 50, 37 if rng.random() < 0.01 else 150)
                group = None if rng.random() < silent else (life["group"], 3 if rng.random() < 0.004 else 1)
                rows.append(person(track, box, actions, group))
                labels = [(other, {"conversation": 3 if rng.random() < hard else 1}) for other in sorted(life["talks"])]
                lists.append(member(track, box, interactions=None if rng.random() < silent else labels))
    if rng.random() < 0.2:
        frames = sorted(layers["2d"])
        layers["images"] = sorted(rng.sample(frames, max(1, len(frames) - 2 * 15 // step)))
    return {NAME: layers}


def proven(store):
    """(the world prepared for search, the names that are anchors, {form: {(plan, answer, needed boxes, people and
    times)}} of the proven candidates)."""
    found = {}
    with searched(store, NAME, RULES) as context:
        names = context.query("search", "anchors")
        for form in FORMS:
            rows = find_candidates(context, form)
            proven = np.flatnonzero(rows.rule == PASSED)
            found[form.form] = set()
            for line in to_table(context, rows, proven).to_pylist():
                confirmed = Proof("rederive", "annotations", True, "same")
                record = make_record(
                    context, rows, line, parse_plan(line["plan"]), confirmed, *choice_sets(context, rows, line)
                )
                needed = frozenset((box.node, box.track, box.frame, box.decisive) for box in record.needed)
                found[form.form].add((line["plan"], line["answer"], needed, tuple(sorted(record.bindings.items()))))
    return context, names.filter(names["anchor"])["name"].to_pylist(), found


def settled(annotations, outcome, plan):
    """Whether it is known at every keyframe, and not only over all of them, who is counted.

    Between two keyframes nothing may be known of somebody; who may be counted for what is said, on both sides of a
    closed gap too, does not matter.
    """
    first, last = (plan.times[name].frame for name in ("t1", "t2"))
    for frame in range(first, last + 1):
        people = annotations.people(frame)
        if outcome.target not in people:
            continue
        for other in set(people) - {outcome.target}:
            if frame in annotations.keyframes:
                if annotations.related(plan.answer.relation, outcome.target, other, frame) == UNKNOWN:
                    return False
            elif (
                annotations.related(plan.answer.relation, outcome.target, other, frame) == UNKNOWN
                and any(unheard(annotations, plan.answer.relation, one, frame) for one in (outcome.target, other))
                and not spoken_of(annotations, plan.answer.relation, outcome.target, other, frame)
            ):
                return False
    return True


def unheard(annotations, relation, track, frame):
    """Whether nothing is known of a person's relations of this kind."""
    if relation == SAME_GROUP:
        return not annotations._memberships(track, frame)
    return not annotations.tells(track, frame, "interactions")


def spoken_of(annotations, relation, track, other, frame):
    """Whether an interaction of two people is labelled at the frame, or on both sides of a closed gap round it."""
    said = annotations._together.get((min(track, other), max(track, other), relation), {})
    return annotations._when(said, frame, "interactions") is not None


def tried(store, context, anchors):
    """The same by asking the second path about every plan there could be."""
    annotations = Annotations.read(store, NAME, RULES)
    scene, names = context.scene, context.descriptions
    actions = sorted(set(scene.actions["action"].to_pylist()))
    frames = scene.keyframes.tolist()
    found = {form.form: set() for form in FORMS}
    for name in [name for name in anchors if names.general[name]]:
        t0 = int(scene.frames(names.moment[[name]])[0])
        conditions = names.of(name)
        plans = [("gap_absence", Slots(conditions, {"t0": t0}))]
        plans += [("gap_starts", Slots(conditions, {"t0": t0}, pair)) for pair in itertools.permutations(actions, 2)]
        shifted = tuple(c if c.at is None else msgspec.structs.replace(c, at="t1") for c in conditions)
        for t2, relation in itertools.product(frames, ("conversation", SAME_GROUP)):
            if t2 > t0:
                plans.append(("gap_count", Slots(shifted, {"t1": t0, "t2": t2}, relations=(relation,))))
        for form, slots in plans:
            row = TEMPLATES[form]
            plan = row.build(slots)
            outcome = rederive(annotations, plan, "gap", RULES)
            if outcome.outcome != "defined" or outcome.faults:
                continue
            if all(
                visible_share(Box(box.x, box.y, box.w, box.h), 180.0) >= 0.5 for box in outcome.needed if box.decisive
            ):
                continue
            if form == "gap_count" and not settled(annotations, outcome, plan):
                continue
            needed = frozenset((box.node, box.track, box.frame, box.decisive) for box in outcome.needed)
            bound = tuple(sorted((*outcome.people, *outcome.times)))
            found[form].add((canonical(plan), outcome.answer, needed, bound))
    return found


def compare(seed):
    """Check one world; returns how many questions of each form it has."""
    with tempfile.TemporaryDirectory() as folder:
        store = memory_store(folder, busy_world(random.Random(seed)))
        context, anchors, found = proven(store)
        expected = tried(store, context, anchors)
        for form in expected:
            assert sorted(found[form] - expected[form], key=str)[:2] == []
            assert sorted(expected[form] - found[form], key=str)[:2] == []
        return Counter({form: len(rows) for form, rows in expected.items()})


@pytest.mark.slow
def test_every_form_is_found():
    counts = sum((compare(seed) for seed in (0, 2, 11)), Counter())
    assert {form.form for form in FORMS} == set(counts)


def test_forms_are_judged_together(tmp_path, monkeypatch):
    monkeypatch.setattr("jrdb_avr.engine.generate.sequence.FORMS", {"gap": tuple(FORMS)})
    store = quick_store(tmp_path, busy_world(random.Random(9)))
    file = tmp_path / "candidates.parquet"
    rules = msgspec.structs.replace(RULES, max_per_person=2)
    found = search(store, NAME, rules, file)
    assert found.lacking == {} and not find_faults(ConfirmJob(store.path, NAME, rules, found.pool.select(CONFIRMED)))
    counts = {what: count for (template, what), count in found.counts.items() if template == "gap"}
    assert len(counts) == len(found.counts)
    assert counts["candidates"] == counts["proven"] + sum(counts.get(rule, 0) for rule in RULES_OF_CANDIDATES)
    kept = found.pool.to_pylist()
    assert counts["proven"] == len(kept) + counts["near_duplicate"] + counts["max_per_person"]
    written = pq.read_table(file).to_pylist()
    assert len(written) == counts["proven"] and {row["template"] for row in written} == {"gap"}
    assert {parse_plan(row["plan"]).times["t1"].event for row in written} == {"start", "leaves", None}
    # The caps of a person over all answers are for the selection across sequences.
    alike = [(row["target_track"], row["answer"]) for row in kept]
    assert max(Counter(alike).values()) == 2
    for (one, first), (other, second) in itertools.combinations(zip(alike, kept, strict=True), 2):
        if one == other:
            times = [json.loads(row["bindings"]) for row in (first, second)]
            apart = [abs(times[0][name] - times[1][name]) for name in ("t1", "t2")]
            assert max(apart) > 30
    for row in kept:
        answer = decode_answer("number", row["answer"])
        assert encode_answer(answer) == row["answer"]
        assert render("gap", parse_plan(row["plan"]), row["key"], True)


def test_without_actions_absences_and_counts_are_asked_about(tmp_path, monkeypatch):
    monkeypatch.setattr("jrdb_avr.engine.generate.sequence.FORMS", {"gap": tuple(FORMS)})
    world = busy_world(random.Random(9))
    for rows in world[NAME]["2d"].values():
        for row in rows:
            del row["action_label"]
    found = search(quick_store(tmp_path, world), NAME, RULES)
    assert found.lacking == {} and found.counts["gap", "candidates"] > 0


def test_without_boxes_there_is_nothing_to_ask(tmp_path, monkeypatch):
    monkeypatch.setattr("jrdb_avr.engine.generate.sequence.FORMS", {"gap": tuple(FORMS)})
    store = quick_store(tmp_path, {NAME: {"3d": {0: [person_3d(1, 3.0, 0.0)], 15: []}}})
    found = search(store, NAME, RULES)
    assert found.lacking == {"gap": ("2d",)} and found.counts == {} and len(found.pool) == 0


@pytest.mark.slow
@settings(max_examples=examples(2), deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32 - 1))
def test_search_agrees_with_trying_all(seed):
    compare(seed)
