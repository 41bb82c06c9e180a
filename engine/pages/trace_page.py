"""A run's way through one question as a page: what was asked, seen, written and answered, beside the truth."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.engine.observe import Observer
from jrdb_avr.engine.tracing import Look, Trace
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, iou, to_crop

from .page import jpeg_bytes, jpeg_uri, render

ROLES: Final = 6
"""Colours of people in `roles.css`."""

MAP_WIDTH: Final = 1000.0
MAP_HEIGHT: Final = 380.0
_TOP: Final = 24.0
_LEFT: Final = 62.0

_STRIP: Final = (1128, 144)
_SMALL: Final = (240, 240)
_TAIL: Final = 1500
"""Characters of a request shown at once: its end, which is what is new."""

_PICTURE = re.compile(r"\[image [^\]]{1,200}\]")


@dataclass(frozen=True)
class Mark:
    """Something on the map from column `x` on (`w` wide, 0 for a point) at the height of its frame, from a step on."""

    kind: str
    x: float
    y: float
    w: float
    step: int
    role: int
    text: str
    x2: float = 0.0


@dataclass(frozen=True)
class Map:
    """Where a run looked and what it saw: panorama columns across, time downwards."""

    marks: tuple[Mark, ...]
    path: str
    ticks: tuple[tuple[float, str], ...]
    last: int


def trace_page(trace: Trace, observer: Observer) -> str:
    """The page's HTML."""
    names = _entities(trace)
    return render(
        "trace",
        trace=trace,
        question=trace.question,
        prediction=trace.prediction,
        choices=_choices(trace),
        right=_plain(trace.answer["answer"]),
        map=_map(trace, names),
        width=MAP_WIDTH,
        height=MAP_HEIGHT,
        entities=_cards(trace, names),
        relations=_relations(trace),
        refused=[write.row for write in trace.writes if not write.row["accepted"]],
        steps=[_step(trace, number, observer) for number in range(len(trace.steps))],
        final=_final(trace, observer),
        calls=_plain(msgspec.json.encode(trace.manifest.settings).decode()),
    )


def _choices(trace: Trace) -> list[dict[str, Any]]:
    right, given = (_choice(row["answer"]) for row in (trace.answer, trace.prediction))
    return [
        {"text": text, "right": place == right, "given": place == given}
        for place, text in enumerate(trace.question["choices"], 1)
    ]


def _choice(text: str | None) -> int | None:
    value = msgspec.json.decode(text or "{}")
    return value.get("choice") if isinstance(value, dict) else None


def _plain(text: str | None) -> str:
    """JSON in a form that is good to read."""
    if not text:
        return ""
    try:
        return msgspec.json.format(text.encode(), indent=1).decode() if len(text) > 100 else text
    except (msgspec.DecodeError, UnicodeEncodeError):
        return text


# -- the map ----------------------------------------------------------------------------------------------------------


def _entities(trace: Trace) -> dict[str, tuple[str, int]]:
    """Key of each entity -> its name and colour, in the order in which they were made."""
    made = [write.fact.entity for write in trace.writes if write.fact.entity is not None]
    return {entity.id: (entity.name, number % ROLES) for number, entity in enumerate(made)}


def _map(trace: Trace, names: Mapping[str, tuple[str, int]]) -> Map:
    frames = [look.frame for look in trace.looks]
    if trace.prediction["evidence_frame"] is not None:
        frames.append(trace.prediction["evidence_frame"])
    first, last = (min(frames), max(frames)) if frames else (0, 0)
    # The target's way through the same time, and a little before and after.
    room = max(15, (last - first) // 12)
    low, high = first - room, last + room

    def y(frame: float) -> float:
        return round(_TOP + (MAP_HEIGHT - 2 * _TOP) * (frame - low) / (high - low), 2)

    marks = [mark for look in trace.looks for mark in _look_marks(look, y(look.frame))]
    places: dict[tuple[str, int], float] = {}
    for write in trace.writes:
        step = int(write.row["step"])
        if (seen := write.fact.sighted) is not None and seen.source in names:
            name, role = names[seen.source]
            column = (seen.box.x + seen.box.w / 2) % WIDTH
            places[seen.source, seen.frame] = column
            marks.append(Mark("seen", _x(column), y(seen.frame), 0, step, role, f"{name}, frame {seen.frame}"))
        if (tie := write.fact.related) is not None:
            ends = [places.get((key, tie.first)) for key in (tie.source, tie.target)]
            if ends[0] is not None and ends[1] is not None:
                role = names.get(tie.source, ("", 0))[1]
                marks.append(Mark("tie", _x(ends[0]), y(tie.first), 0, step, role, tie.name, _x(ends[1])))
    if trace.prediction["evidence_frame"] is not None and trace.prediction["evidence_x"] is not None:
        middle = (trace.prediction["evidence_x"] + trace.prediction["evidence_w"] / 2) % WIDTH
        text = f"the box given as evidence, frame {trace.prediction['evidence_frame']}"
        marks.append(Mark("given", _x(middle), y(trace.prediction["evidence_frame"]), 0, len(trace.steps), 0, text))
    ticks = tuple((y(frame), f"{frame / trace.fps:.1f} s") for frame in sorted({first, (first + last) // 2, last}))
    return Map(tuple(marks), _way(trace, low, high, y), ticks, len(trace.steps))


def _look_marks(look: Look, y: float) -> list[Mark]:
    """The columns of a look; a crop over the seam in two parts."""
    text = f"step {look.step}: frame {look.frame}" + ("" if look.angle is None else f", angle {look.angle:g}")
    if look.angle is None:
        return [Mark("look", _x(0), y, _x(WIDTH) - _x(0), look.step, 0, text)]
    parts = [(look.left, min(look.left + CROP, WIDTH)), (0, max(0, look.left + CROP - WIDTH))]
    return [Mark("look", _x(a), y, _x(b) - _x(a), look.step, 0, text) for a, b in parts if b > a]


def _way(trace: Trace, low: int, high: int, y: Any) -> str:
    """The target's way, as an SVG path: broken where it is not in view and where it crosses the seam."""
    path, before = [], None
    for frame in sorted(frame for frame in trace.target if low <= frame <= high):
        x, _, w, _ = trace.target[frame]
        column = (x + w / 2) % WIDTH
        joined = before is not None and frame - before[0] <= 15 and abs(column - before[1]) < WIDTH / 2
        path.append(f"{'L' if joined else 'M'}{_x(column)} {y(frame)}")
        before = frame, column
    return "".join(path)


def _x(column: float) -> float:
    return round(_LEFT + (MAP_WIDTH - _LEFT - 4) * column / WIDTH, 2)


# -- the world model --------------------------------------------------------------------------------------------------


def _cards(trace: Trace, names: Mapping[str, tuple[str, int]]) -> list[dict[str, Any]]:
    """Each entity with what was written of it, line by line with the step of each."""
    cards: dict[str, dict[str, Any]] = {}
    for write in trace.writes:
        step, fact = int(write.row["step"]), write.fact
        if fact.entity is not None:
            name, role = names[fact.entity.id]
            cards[fact.entity.id] = {"name": name, "role": role, "step": step, "kind": fact.entity.kind, "lines": []}
            if fact.entity.node:
                cards[fact.entity.id]["lines"].append((step, f"is the plan's {fact.entity.node}"))
        if fact.changed is not None and fact.changed.id in cards:
            cards[fact.changed.id]["lines"].append((step, f"is the plan's {fact.changed.node or '(nobody)'}"))
        if fact.sighted is not None and fact.sighted.source in cards:
            where = f"seen at frame {fact.sighted.frame}, angle {fact.sighted.angle:.0f}"
            cards[fact.sighted.source]["lines"].append((step, where))
        if fact.has is not None and fact.has.source in cards:
            when = f" at frame {fact.has.first}" if fact.has.first == fact.has.last else ""
            cards[fact.has.source]["lines"].append((step, f"{fact.has.name}: {fact.has.value}{when}"))
    return list(cards.values())


def _relations(trace: Trace) -> list[tuple[int, str]]:
    ties = [(int(write.row["step"]), write.fact.related) for write in trace.writes]
    return [
        (step, f"{_name(tie.source)}: {tie.name} {_name(tie.target)}, frame {tie.first}")
        for step, tie in ties
        if tie is not None
    ]


def _name(key: str) -> str:
    return key.rpartition("/")[2]


# -- steps ------------------------------------------------------------------------------------------------------------


def _step(trace: Trace, number: int, observer: Observer) -> dict[str, Any]:
    step = trace.steps[number]
    look = next((look for look in trace.looks if look.step == step["step"]), None)
    writes = [write.row for write in trace.writes if write.row["step"] == step["step"]]
    request = _plain(step["request"]) if step["kind"] != "model" else _messages(step["request"])
    return {
        "number": step["step"],
        "kind": step["kind"],
        "seconds": step["seconds"],
        "request": request[-_TAIL:],
        "whole": request if len(request) > _TAIL else "",
        "response": _plain(step["response"]) if step["kind"] != "model" else _reply(step["response"]),
        "refused": [row for row in writes if not row["accepted"]],
        "view": _view(trace, look, observer) if look is not None else None,
    }


class _Message(msgspec.Struct):
    role: str
    content: str


class _Reply(msgspec.Struct):
    content: str = ""
    reasoning: str = ""
    finish_reason: str = ""


def _messages(text: str) -> str:
    """What a model was sent, as text; pictures by name."""
    try:
        messages = msgspec.json.decode(text, type=list[_Message])
    except msgspec.DecodeError:
        return text
    return "\n\n".join(f"[{message.role}]\n{message.content}" for message in messages)


def _reply(text: str) -> str:
    try:
        reply = msgspec.json.decode(text, type=_Reply)
    except msgspec.DecodeError:
        return text
    thought = f"[reasoning]\n{reply.reasoning}\n\n" if reply.reasoning else ""
    ended = "" if reply.finish_reason in ("", "stop") else f"\n[finish_reason {reply.finish_reason}]"
    return f"{thought}{_plain(reply.content)}{ended}"


def _view(trace: Trace, look: Look, observer: Observer) -> dict[str, Any]:
    """The view on the panorama strip, and the crop in small."""
    sequence = str(trace.question["sequence"])
    scale = _STRIP[0] / WIDTH
    spans = [(0.0, float(_STRIP[0]))]
    if look.angle is not None:
        ends = [(look.left, min(look.left + CROP, WIDTH)), (0, max(0, look.left + CROP - WIDTH))]
        spans = [(a * scale, (b - a) * scale) for a, b in ends if b > a]
    try:
        strip = jpeg_uri(jpeg_bytes(observer.panorama(sequence, look.frame), _STRIP))
        crop = None if look.angle is None else observer(sequence, look.frame, look.angle).image
    except ObserveError as error:
        return {"missing": str(error), "frame": look.frame, "angle": look.angle}
    return {
        "missing": "",
        "frame": look.frame,
        "angle": look.angle,
        "strip": strip,
        "size": _STRIP,
        "spans": spans,
        "crop": "" if crop is None else jpeg_uri(jpeg_bytes(crop, _SMALL)),
    }


def _final(trace: Trace, observer: Observer) -> dict[str, Any] | None:
    """The box given as evidence and the target's in that frame, in the crop round them; None without a box."""
    row = trace.prediction
    if row["evidence_frame"] is None or row["evidence_x"] is None:
        return None
    given = Box(*(row[f"evidence_{key}"] for key in "xywh"))
    target = trace.target.get(row["evidence_frame"])
    overlap = None if target is None else iou(given, Box(*target))
    angle = float(center_angle(given.x, given.w))
    try:
        seen = observer(str(trace.question["sequence"]), row["evidence_frame"], angle)
    except ObserveError as error:
        return {"missing": str(error), "iou": overlap}
    return {
        "missing": "",
        "frame": row["evidence_frame"],
        "angle": angle,
        "uri": jpeg_uri(jpeg_bytes(seen.image, (CROP, CROP))),
        "size": (CROP, HEIGHT),
        "given": to_crop(given, seen.left),
        "target": None if target is None else to_crop(Box(*target), seen.left),
        "iou": overlap,
    }
