"""Everything a person needs to see to judge a question: its people over time, and the views that its answer needs."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.pages.svg import Line, Span, runs_of
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Plan, parse_plan
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import frames as frames_in

_ROUND: Final = frames_in(5.0)
"""Actions are shown that somebody does this near to the named times."""

_READ_POSES: Final = ("action", "next_action")
"""Reads whose answer is a pose."""


@dataclass(frozen=True)
class Inspected:
    """A question with its answer, plan and proofs.

    people: the plan's nodes as (role, track); counted: further people that the answer counts, as (role, track);
    moments: named times as frames; shown: the frames whose boxes say what was at these times; boxes: per frame, all
    these people as rows `role`, `x`, `y`, `w`, `h`; decisive: (frame, box) of the box that answers it.
    """

    question: Mapping[str, Any]
    answer: Mapping[str, Any]
    plan: Plan
    proofs: Sequence[Mapping[str, Any]]
    distractors: Sequence[str | None]
    people: Mapping[str, int]
    counted: Mapping[str, int]
    moments: Mapping[str, int]
    shown: Mapping[str, int]
    lines: tuple[Line, ...]
    boxes: Mapping[int, Sequence[Mapping[str, Any]]]
    decisive: tuple[int, Mapping[str, Any]]
    fps: float
    frame_count: int

    @property
    def frames(self) -> list[int]:
        """The frames to be shown: those of the named times, the decisive one, and where people are counted."""
        return sorted(self.boxes)


def choose_questions(store: Store, ids: Sequence[str], sample: int | None, seed: int) -> list[str]:
    """The ids given, or a seeded sample of all. Raises InputError for an id that is not there."""
    known = store.questions("questions")["question_id"].to_pylist()
    unknown = [name for name in ids if name not in set(known)]
    if unknown:
        raise InputError(f"no question {unknown[0][:40]!r} in {store.path}", field="question_id")
    if sample is None:
        return list(dict.fromkeys(ids))
    return sorted(random.Random(seed).sample(sorted(known), min(sample, len(known))))  # noqa: S311 - no secret


def inspect_questions(store: Store, ids: Sequence[str]) -> list[Inspected]:
    """Gather the questions, in the order given. Raises StoreError where a table is missing."""
    questions = _by_id(store.questions("questions"), ids)
    answers = _by_id(store.questions("answers"), ids)
    sequences = {row["sequence"]: row for row in store.questions("sequences").to_pylist()}
    read: dict[str, _Sequence] = {}
    found = []
    for name in ids:
        sequence = questions[name]["sequence"]
        if sequence not in read:
            # One at a time: questions of a sequence mostly follow each other, and its tables may be large.
            read = {sequence: _Sequence(store, sequence)}
        found.append(_inspected(questions[name], answers[name], sequences[sequence], read[sequence]))
    return found


def _by_id(table: pa.Table, ids: Sequence[str]) -> dict[str, dict[str, Any]]:
    chosen = table.filter(pc.is_in(table["question_id"], value_set=pa.array(list(ids), pa.string())))
    return {row["question_id"]: row for row in chosen.to_pylist()}


class _Sequence:
    """The interval tables of a sequence that a timeline is made of."""

    def __init__(self, store: Store, sequence: str) -> None:
        names = ("sightings", "actions", "interactions", "memberships", "beside", "handles")
        self.tables = {name: store.interval(name, sequence) for name in names}
        self.frames = sorted(set(self.tables["sightings"]["frame"].to_pylist()))
        self.step = min((b - a for a, b in pairwise(self.frames)), default=1)

    def rows(self, name: str, **equal: int | str) -> list[dict[str, Any]]:
        table = self.tables[name]
        for column, value in equal.items():
            table = table.filter(pc.equal(table[column], value))
        rows: list[dict[str, Any]] = table.to_pylist()
        return rows


def _inspected(
    question: Mapping[str, Any], answer: Mapping[str, Any], info: Mapping[str, Any], sequence: _Sequence
) -> Inspected:
    plan = parse_plan(answer["plan"])
    bindings = msgspec.json.decode(answer["bindings"], type=dict[str, int])
    people = {node.id: bindings[node.id] for node in plan.nodes}
    moments = {name: frame for name, frame in bindings.items() if name not in people}
    needed = msgspec.json.decode(answer["needed"], type=list[dict[str, Any]])
    # A count has none: its target at the first of the two times is what is looked for.
    decisive = next((row for row in needed if row["decisive"]), needed[0])
    shown = {name: annotated(frame, sequence.frames, sequence.step) for name, frame in moments.items()}
    counted = [row for row in needed if row["node"] not in people]
    sightings = {role: sequence.rows("sightings", track=track) for role, track in people.items()}
    boxes: dict[int, list[Mapping[str, Any]]] = {
        frame: [{"role": role, **row} for role, rows in sightings.items() for row in rows if row["frame"] == frame]
        for frame in {*shown.values(), decisive["frame"], *(row["frame"] for row in counted)}
    }
    for row in counted:
        boxes[row["frame"]].append({"role": row["node"], **row})
    lines = [line for role in people for line in _lines(role, plan, people, moments, sightings[role], sequence)]
    return Inspected(
        question,
        answer,
        plan,
        msgspec.json.decode(answer["proofs"], type=list[dict[str, Any]]),
        msgspec.json.decode(answer["distractors"], type=list[str | None]),
        people,
        {row["node"]: row["track"] for row in counted},
        moments,
        shown,
        tuple(lines),
        boxes,
        (decisive["frame"], decisive),
        info["fps"],
        info["frame_count"],
    )


def annotated(frame: int, frames: Sequence[int], step: int) -> int:
    """The frame of the annotated ones that a frame goes by: at 1 Hz an event lies half a step from its keyframe."""
    near = min(frames, key=lambda known: abs(known - frame), default=frame)
    return near if abs(near - frame) <= step // 2 else frame


def _lines(
    role: str,
    plan: Plan,
    people: Mapping[str, int],
    moments: Mapping[str, int],
    sightings: Sequence[Mapping[str, Any]],
    sequence: _Sequence,
) -> list[Line]:
    """The rows of one person: in view, what it does round the named times, and what of the rest the plan speaks of."""
    frames = [row["frame"] for row in sightings]
    clear = [row["frame"] for row in sightings if row["clear"]]
    spans = [Span(first, last, "box") for first, last in runs_of(frames, sequence.step)]
    spans += [Span(first, last, "clear") for first, last in runs_of(clear, sequence.step)]
    track = people[role]
    first, last = min(moments.values()) - _ROUND, max(moments.values()) + _ROUND
    actions = [row for row in sequence.rows("actions", track=track) if row["first"] <= last and row["last"] >= first]
    lines = [Line(role, "in view", tuple(spans))]
    lines += _grouped(role, actions, lambda row: row["action"], "action", _asked(role, plan))
    others = {number: name for name, number in people.items()}
    # The edges that go out from this person; and of what is counted or describes, everybody it may hold of.
    said = {(edge.relation, people[edge.target]) for edge in plan.edges if edge.source == role}
    conditions = [condition for node in plan.nodes if node.id == role for condition in node.conditions]
    spoken = {condition.interaction for condition in conditions if condition.interaction}
    spoken |= {plan.answer.relation} if plan.answer.relation and role == plan.answer.of else set()
    for name in ("interactions", "beside"):
        own = [
            row
            for row in sequence.rows(name, source=track)
            if (row["label"], row["target"]) in said or row["label"] in spoken
        ]
        lines += _grouped(
            role,
            own,
            lambda row: f"\N{RIGHTWARDS ARROW} {others.get(row['target'], str(row['target'])).upper()} {row['label']}",
            "relation",
        )
    if SAME_GROUP in _relations(role, plan) or any(condition.attribute == "group_size" for condition in conditions):
        lines += _grouped(role, sequence.rows("memberships", track=track), lambda r: f"group {r['cluster']}", "group")
    verbs = {condition.verb for condition in conditions if condition.verb}
    own = [row for row in sequence.rows("handles", track=track) if row["verb"] in verbs]
    return lines + _grouped(role, own, lambda row: f"{row['verb']} a thing", "thing")


def _relations(role: str, plan: Plan) -> set[str]:
    """The relations that the plan names of a person."""
    said = {edge.relation for edge in plan.edges if role in (edge.source, edge.target)}
    return said | ({plan.answer.relation} if plan.answer.relation and role == plan.answer.of else set())


def _asked(role: str, plan: Plan) -> frozenset[str]:
    """The actions of a person that the plan speaks of: every pose where one is what is read."""
    actions = {c.action for node in plan.nodes if node.id == role for c in node.conditions if c.action}
    actions |= {time.action for time in plan.times.values() if time.of == role and time.action}
    if plan.answer.of == role and plan.answer.read in _READ_POSES:
        actions |= set(POSES)
    return frozenset(actions)


def _grouped(
    role: str,
    rows: Sequence[Mapping[str, Any]],
    label: Callable[[Mapping[str, Any]], str],
    kind: str,
    asked: frozenset[str] | None = None,
) -> list[Line]:
    """A row per label, those that the plan speaks of first; `asked` None: all of them."""
    by_label: dict[str, list[Span]] = {}
    for row in rows:
        by_label.setdefault(label(row), []).append(Span(row["first"], row["last"], kind, row["certain"]))
    lines = [Line(role, name, tuple(spans), asked is None or name in asked) for name, spans in by_label.items()]
    return sorted(lines, key=lambda line: (not line.asked, line.label))
