"""The inspect page: questions with their plan, people over time, proofs and views, for a person to accept or reject."""

from __future__ import annotations

import contextlib
import functools
import random
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.page import on_strip, picture_uri, readable, render, unit_of
from jrdb_avr.engine.pages.svg import PlanGraph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import InputError, ObserveError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.method import Image
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, to_crop
from jrdb_avr.schema.plan import Plan, parse_plan
from jrdb_avr.schema.questions import QuestionRecord
from jrdb_avr.schema.relations import SAME_GROUP
from jrdb_avr.schema.rules import frames as frames_in
from jrdb_avr.schema.tables import LABELED

Record = Mapping[str, Any]

_NEAR_MOMENTS: Final = frames_in(5.0)
"""The timeline has the actions at most this many frames away from the named times."""

_POSE_READS: Final = ("action", "next_action")
"""Reads whose answer is a pose."""

_STRIP: Final = (2820, 360)
_AROUND: Final = (1880, 240)
"""Size in pixels of a panorama in the page, and of those one second before and after it: three quarters and half, so
that a page of twenty questions stays small enough to send and people can still be seen when it is zoomed."""

CLOSE_UP: Final = 220
"""Pixels of a close-up's side."""

_LEAST_CLOSE_UP: Final = 110.0
"""Panorama pixels of a close-up's side at least, so that a small person has some surroundings."""


# -- questions --------------------------------------------------------------------------------------------------------


class Stretch(NamedTuple):
    """Frames of a timeline row, inclusive; `kind` decides how it is drawn; `certain` is false for unknown frames."""

    first: int
    last: int
    kind: str
    certain: bool = True


class TimelineRow(NamedTuple):
    """One thing a person does over time; `in_plan`: the plan speaks of it."""

    role: str
    label: str
    spans: tuple[Stretch, ...]
    in_plan: bool = False


def choose_questions(store: Store, ids: Sequence[str], sample: int | None, seed: int) -> list[str]:
    """These ids, or a seeded sample of all. Raises InputError for an unknown id."""
    known = store.questions("questions")["question_id"].to_pylist()
    unknown = [name for name in ids if name not in set(known)]
    if unknown:
        raise InputError(f"no question {unknown[0][:40]!r} in {store.path}", field="question_id")
    if sample is None:
        return list(dict.fromkeys(ids))
    return sorted(random.Random(seed).sample(sorted(known), min(sample, len(known))))  # noqa: S311 - no secret


def inspect_questions(store: Store, ids: Sequence[str]) -> list[Inspected]:
    """Collect what the page displays of each question. Raises StoreError where a table is missing."""
    *tables, infos = store.question_tables("questions", "answers", "sequences")
    questions, answers = (_by_id(table, ids) for table in tables)
    sequences = {row["sequence"]: row for row in infos.to_pylist()}
    # One sequence at a time: consecutive questions mostly share one, and its tables may be large.
    read: _Sequence | None = None
    found = []
    for name in ids:
        record = QuestionRecord.read(questions[name], answers[name])
        if read is None or read.name != record.sequence:
            read = _Sequence(store, record.sequence)
        found.append(Inspected(record, sequences[record.sequence], read))
    return found


def _by_id(table: pa.Table, ids: Sequence[str]) -> dict[str, dict[str, Any]]:
    chosen = table.filter(pc.is_in(table["question_id"], value_set=pa.array(list(ids), pa.string())))
    return {row["question_id"]: row for row in chosen.to_pylist()}


class _Sequence:
    """The interval tables of a sequence that a timeline is made of."""

    def __init__(self, store: Store, name: str) -> None:
        self.name = name
        tables = ("sightings", "actions", "interactions", "memberships", "beside", "handles")
        self._tables = {table: (store.facts if table in LABELED else store.interval)(table, name) for table in tables}
        self.frames = sorted(set(self._tables["sightings"]["frame"].to_pylist()))
        self.occlusion = bool(store.interval("sequence", name)["has_attributes"][0].as_py())
        self.step = min((b - a for a, b in pairwise(self.frames)), default=1)

    def rows(self, table: str, column: str, value: int) -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = self._tables[table].filter(pc.field(column) == value).to_pylist()
        return rows


class Inspected:
    """A question with its plan, people and views.

    people: the plan's nodes as (role, track); counted: further people whom the answer counts, as (role, track);
    moments: named times as frames; annotated: the annotated frame of each named time; boxes: per frame to display, the
    boxes of all these people by role; around: for each of these the frames a second before and after it, with their
    boxes, as (-1 or 1, frame, boxes); decisive: the needed box that answers the question; occlusion: whether boxes of
    the sequence have occlusion attributes.
    """

    def __init__(self, record: QuestionRecord, info: Record, sequence: _Sequence) -> None:
        self.record, self.plan = record, parse_plan(record.plan)
        self.fps, self.frame_count, self.occlusion = info["fps"], info["frame_count"], sequence.occlusion
        self.people = {node.id: record.bindings[node.id] for node in self.plan.nodes}
        self.moments = {name: frame for name, frame in record.bindings.items() if name not in self.people}
        at = {name: nearest_annotated(frame, sequence.frames, sequence.step) for name, frame in self.moments.items()}
        self.annotated = at
        # A count has no decisive box: its first needed one is the target at the first of its two times.
        self.decisive = next((box for box in record.needed if box.decisive), record.needed[0])
        counted = [box for box in record.needed if box.node not in self.people]
        self.counted = {box.node: box.track for box in counted}
        tracks = self.people | self.counted
        sightings = {role: sequence.rows("sightings", "track", track) for role, track in tracks.items()}

        def boxes(roles: Iterable[str], frame: int) -> list[tuple[str, Box]]:
            return [(role, _box(row)) for role in roles for row in sightings[role] if row["frame"] == frame]

        displayed = sorted({*at.values(), self.decisive.frame, *(box.frame for box in counted)})
        self.boxes = {frame: boxes(self.people, frame) for frame in displayed}
        for box in counted:
            self.boxes[box.frame].append((box.node, Box(box.x, box.y, box.w, box.h)))
        self.around = {
            frame: [
                (sign, frame + sign * round(self.fps), boxes(dict(own) | self.people, frame + sign * round(self.fps)))
                for sign in (-1, 1)
            ]
            for frame, own in self.boxes.items()
        }
        self.timeline = [row for role in self.people for row in _timeline(role, self, sightings[role], sequence)]


def _box(row: Record) -> Box:
    return Box(row["x"], row["y"], row["w"], row["h"])


def nearest_annotated(frame: int, frames: Sequence[int], step: int) -> int:
    """The annotated frame that stands for a frame: at 1 Hz an event lies half a step from its keyframe."""
    near = min(frames, key=lambda known: abs(known - frame), default=frame)
    return near if abs(near - frame) <= step // 2 else frame


# -- the timeline -----------------------------------------------------------------------------------------------------


def _timeline(role: str, one: Inspected, sightings: Sequence[Record], sequence: _Sequence) -> list[TimelineRow]:
    """The rows of one person: in view, actions near the named times, and whatever else the plan speaks of."""
    plan, people, moments = one.plan, one.people, one.moments
    track, tracks = people[role], {number: name for name, number in people.items()}
    conditions = [condition for node in plan.nodes if node.id == role for condition in node.conditions]
    # The relation that an answer counts may hold of anybody, as may one that describes; an edge names its target.
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
        own = sequence.rows(table, "source", track)
        named = [row for row in own if (row["label"], row["target"]) in edges or row["label"] in described]
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
    """The actions of a person that the plan speaks of: every pose where the plan reads one."""
    actions = {c.action for node in plan.nodes if node.id == role for c in node.conditions if c.action}
    actions |= {time.action for time in plan.times.values() if time.of == role and time.action}
    if plan.answer.of == role and plan.answer.read in _POSE_READS:
        actions |= set(POSES)
    return frozenset(actions)


def _labelled(
    role: str, kind: str, intervals: Iterable[tuple[str, Record]], in_plan: frozenset[str] | None = None
) -> list[TimelineRow]:
    """A timeline row per label, those in the plan first; `in_plan` None: all of them are."""
    spans: dict[str, list[Stretch]] = {}
    for label, row in intervals:
        spans.setdefault(label, []).append(Stretch(row["first"], row["last"], kind, row["certain"]))
    rows = [TimelineRow(role, name, tuple(own), in_plan is None or name in in_plan) for name, own in spans.items()]
    return sorted(rows, key=lambda row: (not row.in_plan, row.label))


def runs_of(frames: Sequence[int], step: int) -> list[tuple[int, int]]:
    """The runs of frames in ascending order, without a gap of more than `step`."""
    if not frames:
        return []
    gaps = [(a, b) for a, b in pairwise(frames) if b - a > step]
    return list(zip([frames[0], *(b for _, b in gaps)], [*(a for a, _ in gaps), frames[-1]], strict=True))


# -- the page ---------------------------------------------------------------------------------------------------------


class FramedBox(NamedTuple):
    """A person's box in the pixels of a picture of the page."""

    role: str
    x: float
    y: float
    w: float
    h: float


class View(NamedTuple):
    """A picture with boxes; `missing`: why there is none; `near`: close-ups of its people.

    `around`: the same a second earlier and later, as (-1 or 1, picture).
    """

    title: str
    uri: str = ""
    width: int = 0
    height: int = 0
    boxes: Sequence[FramedBox] = ()
    missing: str = ""
    plate: float = 28.0
    near: tuple[View, ...] = ()
    around: Sequence[tuple[int, View]] = ()


def inspect_page(
    questions: Sequence[Inspected], observer: Observer, questions_sha256: str, advance: Callable[[int], None]
) -> str:
    """The page's HTML; calls `advance` after each question."""
    found = []
    for one in questions:
        found.append(_question(one, observer))
        advance(1)
    options = {
        name: sorted({str(getattr(one.record, name)) for one in questions})
        for name in ("family", "template", "sequence")
    }
    return render("inspect.html", questions=found, options=options, sha256=questions_sha256)


def _question(one: Inspected, observer: Observer) -> dict[str, Any]:
    record, answer = one.record, decode_answer(one.record.answer_mode, one.record.answer)
    words = functools.partial(readable, record.answer_mode, choices=(), fps=one.fps, unit=unit_of(one.plan))
    # A proof's answer is a choice's text, or stored JSON.
    proofs = [(proof, proof.answer if record.choices else words(proof.answer)) for proof in record.proofs]
    perturbations = record.distractors or (None,) * len(record.choices)
    return {
        "one": one,
        "choices": [
            {"text": text, "right": answer == Choice(place), "from": _perturbation(one, perturbation)}
            for place, (text, perturbation) in enumerate(zip(record.choices, perturbations, strict=True), 1)
        ],
        "answer": "" if record.choices else words(record.answer),
        "graph": PlanGraph(one.plan),
        "times": _times(one.plan),
        "reads": _reads(one.plan),
        "roles": {role: place for place, role in enumerate(one.people)} | dict.fromkeys(one.counted, len(one.people)),
        "views": [_strip(one, frame, observer) for frame in one.boxes],
        "crop": _crop(one, observer),
        "proofs": proofs,
    }


def _times(plan: Plan) -> list[str]:
    """The named times of a plan in words."""
    words = []
    for name, time in plan.times.items():
        if time.frame is not None:
            words.append(f"{name}: frame {time.frame}")
        else:
            what = f" {time.action}" if time.action else ""
            words.append(f"{name}: {time.of} {time.event}s{what} after {time.after}".replace("ss ", "s "))
    return words


def _reads(plan: Plan) -> str:
    """A line of text that says what a plan reads of its target person, and at which times."""
    counted = f" of '{plan.answer.relation}'" if plan.answer.relation else ""
    return f"{plan.answer.read.replace('_', ' ')}{counted} of {plan.answer.of} at {', '.join(plan.answer.times)}"


def _perturbation(one: Inspected, name: str | None) -> str:
    """The perturbation that a wrong choice is true of; one that stops at a person begins with that person's role."""
    stop = re.fullmatch(r"hop\.stop\((\d)\)", name or "")
    roles = list(one.people)
    if stop is not None and int(stop[1]) < len(roles):
        return f"{roles[int(stop[1])].upper()} ({name})"
    return name or ""


def _strip(one: Inspected, frame: int, observer: Observer) -> View:
    title = f"frame {frame}, {frame / one.fps:.1f} s"
    if names := [_moment(one, name) for name, at in one.annotated.items() if at == frame]:
        title = f"{', '.join(names)}: {title}"
    if absent := one.people.keys() - {role for role, _ in one.boxes[frame]}:
        title += f"; no box of {', '.join(sorted(absent)).upper()}"
    try:
        image = observer.panorama(one.record.sequence, frame)
    except ObserveError as error:
        return View(title, missing=str(error))
    near = tuple(close_up(role, box, image, frame) for role, box in one.boxes[frame] if role in one.people)
    around = []
    for sign, other, boxes in one.around[frame]:
        # A second away the store may have no picture, or one that cannot be read: it is only left out.
        with contextlib.suppress(ObserveError):
            there = observer.panorama(one.record.sequence, other)
            around.append((sign, _panorama(f"{sign:+d} s, frame {other}", there, _AROUND, boxes)))
    return _panorama(title, image, _STRIP, one.boxes[frame])._replace(near=near, around=around)


def _panorama(title: str, image: Image, size: tuple[int, int], boxes: Iterable[tuple[str, Box]]) -> View:
    """A whole panorama, its boxes in stitched pixels whatever its size."""
    framed = [FramedBox(role, *part) for role, box in boxes for part in on_strip(box, WIDTH)]
    return View(title, picture_uri(image, size), WIDTH, HEIGHT, framed)


def _moment(one: Inspected, name: str) -> str:
    """A named time, with its frame where that is not annotated."""
    frame = one.moments[name]
    return name if frame == one.annotated[name] else f"{name} (frame {frame}, between two annotated)"


def close_up(role: str, box: Box, image: Image, frame: int) -> View:
    """A person with some surroundings, square; across the seam if necessary."""
    side = int(min(max(1.5 * max(box.w, box.h), _LEAST_CLOSE_UP), HEIGHT))
    left = int(box.x + box.w / 2 - side / 2)
    top = int(min(max(box.y + box.h / 2 - side / 2, 0), HEIGHT - side))
    cut = np.take(image, np.arange(left, left + side), axis=1, mode="wrap")[top : top + side]
    scale, size = CLOSE_UP / side, (CLOSE_UP, CLOSE_UP)
    framed = FramedBox(role, (box.x - left) * scale, (box.y - top) * scale, box.w * scale, box.h * scale)
    return View(f"{role.upper()} in frame {frame}", picture_uri(cut, size), *size, (framed,), plate=24.0)


def _crop(one: Inspected, observer: Observer) -> View:
    needed = one.decisive
    frame, angle = needed.frame, float(center_angle(needed.x, needed.w))
    title = f"what answers it: {needed.node.upper()} in frame {frame}, angle {angle:.1f}\N{DEGREE SIGN}"
    try:
        seen = observer(one.record.sequence, frame, angle)
    except ObserveError as error:
        return View(title, missing=str(error))
    box = FramedBox(needed.node, *to_crop(Box(needed.x, needed.y, needed.w, needed.h), seen.left))
    return View(title, picture_uri(seen.image, (CROP, CROP)), CROP, CROP, (box,))
