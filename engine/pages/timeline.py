"""Timelines of the inspect page. They show facts about the people of a question over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import pyarrow.compute as pc

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import frames as frames_in
from jrdb_avr.schema.tables import LABELED

Record = Mapping[str, Any]

_NEAR_MOMENTS: Final = frames_in(5.0)
"""Maximum distance in frames from the named times to an action. The timeline leaves out more distant actions."""

_POSE_READS: Final = ("action", "next_action")
"""Kinds of answers (`plan.answer.read`) that are poses."""


class Stretch(NamedTuple):
    """A bar of a timeline row.

    Attributes:
        first: First frame of the bar.
        last: Last frame of the bar.
        kind: Drawing style of the bar.
        certain: Whether the shown fact is certain.
    """

    first: int
    last: int
    kind: str
    certain: bool = True


class TimelineRow(NamedTuple):
    """One property of a person over time. `in_plan` is true if the plan mentions the property."""

    role: str
    label: str
    spans: tuple[Stretch, ...]
    in_plan: bool = False


class SequenceTables:
    """The tables of one sequence that are needed for timelines of people in this sequence."""

    def __init__(self, store: Store, name: str) -> None:
        self.name = name
        tables = ("sightings", "actions", "interactions", "memberships", "beside", "handles")
        self._tables = {table: (store.facts if table in LABELED else store.interval)(table, name) for table in tables}
        self.frames = sorted(set(self._tables["sightings"]["frame"].to_pylist()))
        self.visibility: str = store.interval("sequence", name)["visibility"][0].as_py()
        self.step = min((b - a for a, b in pairwise(self.frames)), default=1)

    def rows(self, table: str, column: str, value: int) -> list[dict[str, Any]]:
        """Return the rows of a table that have the given value in a column."""
        rows: list[dict[str, Any]] = self._tables[table].filter(pc.field(column) == value).to_pylist()
        return rows


def timeline_rows(
    role: str,
    plan: Plan,
    people: Mapping[str, int],
    moments: Mapping[str, int],
    sightings: Sequence[Record],
    sequence: SequenceTables,
) -> list[TimelineRow]:
    """Return the timeline rows of one person.

    Args:
        role: The person's node in the plan.
        plan: The plan of the question.
        people: Track id of each person of the plan, by node.
        moments: Mapping from the name of a time in the plan to its frame.
        sightings: The person's rows of the table `sightings`.
        sequence: The tables of the sequence.

    Returns:
        A row that shows when the person is in view, one row per action near the named times, and one row per other fact
        that the plan mentions.
    """
    track, tracks = people[role], {track_number: name for name, track_number in people.items()}
    conditions = [condition for node in plan.nodes if node.id == role for condition in node.conditions]
    # A relation that is counted or describes the person may have any target. An edge of the plan has one target.
    counted = {plan.answer.relation} if plan.answer.relation and role == plan.answer.of else set()
    described = {condition.interaction for condition in conditions if condition.interaction} | counted
    edges = {(edge.relation, people[edge.target]) for edge in plan.edges if edge.source == role}
    relations = {edge.relation for edge in plan.edges if role in (edge.source, edge.target)} | counted

    in_view = [(row["frame"], row["clear"]) for row in sightings]
    spans = [Stretch(*span, "box") for span in runs_of([frame for frame, _ in in_view], sequence.step)]
    spans += [Stretch(*span, "clear") for span in runs_of([frame for frame, clear in in_view if clear], sequence.step)]
    rows = [TimelineRow(role, "in view", tuple(spans))]

    first, last = min(moments.values()) - _NEAR_MOMENTS, max(moments.values()) + _NEAR_MOMENTS
    near = [row for row in sequence.rows("actions", "track", track) if row["first"] <= last and row["last"] >= first]
    rows += _labelled(role, "action", ((row["action"], row) for row in near), _plan_actions(role, plan))
    for table in ("interactions", "beside"):
        facts = sequence.rows(table, "source", track)
        named = [row for row in facts if (row["label"], row["target"]) in edges or row["label"] in described]
        targets = [tracks.get(row["target"], str(row["target"])).upper() for row in named]
        labels = [f"\N{RIGHTWARDS ARROW} {target} {row['label']}" for target, row in zip(targets, named, strict=True)]
        rows += _labelled(role, "relation", zip(labels, named, strict=True))
    if SAME_GROUP in relations or any(condition.attribute == "group_size" for condition in conditions):
        groups = sequence.rows("memberships", "track", track)
        rows += _labelled(role, "group", ((f"group {row['cluster']}", row) for row in groups))
    verbs = {condition.verb for condition in conditions if condition.verb}
    handled = [row for row in sequence.rows("handles", "track", track) if row["verb"] in verbs]
    return rows + _labelled(role, "thing", ((f"{row['verb']} a thing", row) for row in handled))


def _plan_actions(role: str, plan: Plan) -> frozenset[str]:
    """Return the actions that the plan mentions for a person.

    If the question asks for a pose of this person, all poses are returned too.
    """
    actions = {c.action for node in plan.nodes if node.id == role for c in node.conditions if c.action}
    actions |= {time.action for time in plan.times.values() if time.of == role and time.action}
    if plan.answer.of == role and plan.answer.read in _POSE_READS:
        actions |= set(POSES)
    return frozenset(actions)


def _labelled(
    role: str, kind: str, intervals: Iterable[tuple[str, Record]], in_plan: frozenset[str] | None = None
) -> list[TimelineRow]:
    """Return one timeline row per label. The rows of labels that the plan mentions come first.

    The argument `in_plan` has the labels that the plan mentions. If it is None, the plan mentions all labels.
    """
    spans: dict[str, list[Stretch]] = {}
    for label, row in intervals:
        spans.setdefault(label, []).append(Stretch(row["first"], row["last"], kind, row["certain"]))
    rows = [
        TimelineRow(role, name, tuple(stretches), in_plan is None or name in in_plan)
        for name, stretches in spans.items()
    ]
    return sorted(rows, key=lambda row: (not row.in_plan, row.label))


def runs_of(frames: Sequence[int], step: int) -> list[tuple[int, int]]:
    """Group frames into stretches without large gaps.

    Args:
        frames: Indexes of frames, ascending.
        step: Maximum distance between neighbouring frames of a stretch.

    Returns:
        First and last frame of each stretch.
    """
    if not frames:
        return []
    gaps = [(a, b) for a, b in pairwise(frames) if b - a > step]
    return list(zip([frames[0], *(b for _, b in gaps)], [*(a for a, _ in gaps), frames[-1]], strict=True))
