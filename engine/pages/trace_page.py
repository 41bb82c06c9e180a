"""A run's way through one question as a page: what was asked, seen, written and answered, beside the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.engine.observe import Observer
from jrdb_avr.engine.tracing import Look, Row, Trace
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, center_angle, iou, to_crop
from jrdb_avr.schema.world import ALWAYS

from .answers import readable
from .page import jpeg_bytes, jpeg_uri, render

ROLES: Final = 6
"""Colours of people in `roles.css`."""

_NAMED: Final = 16
"""Entities whose names stand on the map."""

MAP_WIDTH: Final = 1000.0
MAP_HEIGHT: Final = 380.0
_TOP: Final = 24.0
_LEFT: Final = 62.0

_STRIP: Final = (1128, 144)
_SMALL: Final = (240, 240)
_PICTURES: Final = 200
"""Looks with a picture; of the rest the page says where they were, so that it stays a file that can be opened."""

_LONGEST: Final = 20_000
"""Characters of a text that is shown; what is longer is cut in the middle, and says so."""


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
    name: str = ""
    low: bool = False


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
        given=_said(trace, trace.prediction["answer"]),
        right=_said(trace, trace.answer["answer"]),
        map=_map(trace, names),
        width=MAP_WIDTH,
        height=MAP_HEIGHT,
        entities=_cards(trace, names),
        relations=_relations(trace),
        refused=[write.row for write in trace.writes if not write.row["accepted"]],
        steps=_steps(trace, observer),
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
    try:
        value = msgspec.json.decode(text or "{}")
    except (msgspec.DecodeError, UnicodeEncodeError):
        return None
    return value.get("choice") if isinstance(value, dict) else None


def _said(trace: Trace, text: str | None) -> str:
    return readable(trace.question["answer_mode"], text, trace.question["choices"], trace.fps)


def _plain(text: str | None) -> str:
    """JSON in a form that is good to read."""
    if not text:
        return ""
    try:
        return _cut(msgspec.json.format(text.encode(), indent=1).decode() if len(text) > 100 else text)
    except (msgspec.DecodeError, UnicodeEncodeError):
        return _cut(text)


def _cut(text: str) -> str:
    half, more = _LONGEST // 2, len(text) - _LONGEST
    return text if more <= 0 else f"{text[:half]}\n[{more} characters left out]\n{text[-half:]}"


# -- the map ----------------------------------------------------------------------------------------------------------


def _entities(trace: Trace) -> dict[str, tuple[str, int]]:
    """Key of each entity -> its name and colour, in the order in which they were made."""
    made = [write.fact.entity for write in trace.writes if write.fact.entity is not None]
    return {entity.id: (entity.name, number % ROLES) for number, entity in enumerate(made)}


def _map(trace: Trace, names: Mapping[str, tuple[str, int]]) -> Map:
    frames = [look.frame for look in trace.looks]
    given = _given(trace)
    if given is not None:
        frames.append(given[0])
    last_step = max((int(step["step"]) for step in trace.steps), default=0)
    named: set[str] = set()
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
            # Its name stands at its first sighting, while there are few.
            title = name[:12] if seen.source not in named and len(names) <= _NAMED else ""
            # One above, one below: people of a plan often stand side by side.
            below = len(named) % 2 == 1
            named.add(seen.source)
            text = f"{name}, frame {seen.frame}"
            marks.append(Mark("seen", _x(column), y(seen.frame), 0, step, role, text, name=title, low=below))
        if (tie := write.fact.related) is not None:
            ends = [places.get((key, tie.first)) for key in (tie.source, tie.target)]
            if ends[0] is not None and ends[1] is not None:
                role = names.get(tie.source, ("", 0))[1]
                marks.append(Mark("tie", _x(ends[0]), y(tie.first), 0, step, role, tie.name, _x(ends[1])))
    if given is not None:
        frame, box = given
        text = f"the box given as evidence, frame {frame}"
        marks.append(Mark("given", _x((box.x + box.w / 2) % WIDTH), y(frame), 0, last_step, 0, text))
    ticks = tuple((y(frame), f"{frame / trace.fps:.1f} s") for frame in sorted({first, (first + last) // 2, last}))
    return Map(tuple(marks), _way(trace, low, high, y), ticks, last_step)


def _given(trace: Trace) -> tuple[int, Box] | None:
    """The frame and box given as evidence; None where there is none that can be drawn."""
    frame, sides = trace.prediction["evidence_frame"], [trace.prediction[f"evidence_{key}"] for key in "xywh"]
    if frame is None or any(side is None or not math.isfinite(side) for side in sides):
        return None
    return frame, Box(*sides)


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
    """Each entity with what was written of it: lines as the step of each, the step that replaced it, and its text."""
    cards: dict[str, dict[str, Any]] = {}
    ends = _replaced(trace)
    for write in trace.writes:
        step, fact = int(write.row["step"]), write.fact
        until = ends.get(int(write.row["number"]), ALWAYS)
        for freed in fact.freed:
            if freed in cards:
                cards[freed]["lines"].append((step, ALWAYS, "is nobody of the plan any more"))
        if fact.entity is not None:
            name, role = names[fact.entity.id]
            cards[fact.entity.id] = {"name": name, "role": role, "step": step, "kind": fact.entity.kind, "lines": []}
            if fact.entity.node:
                cards[fact.entity.id]["lines"].append((step, ALWAYS, f"is the plan's {fact.entity.node}"))
        if fact.changed is not None and fact.changed.id in cards:
            node = fact.changed.node
            text = f"is the plan's {node}" if node else f"is a {fact.changed.kind}"
            cards[fact.changed.id]["lines"].append((step, ALWAYS, text))
        if fact.sighted is not None and fact.sighted.source in cards:
            where = f"seen at frame {fact.sighted.frame}, angle {fact.sighted.angle:.0f}"
            cards[fact.sighted.source]["lines"].append((step, until, where))
        if fact.has is not None and fact.has.source in cards:
            when = f" at frame {fact.has.first}" if fact.has.first == fact.has.last else ""
            cards[fact.has.source]["lines"].append((step, until, f"{fact.has.name}: {fact.has.value}{when}"))
    return list(cards.values())


def _replaced(trace: Trace) -> dict[int, int]:
    """The number of each write whose fact a later one replaced -> the step of that one."""
    return {number: int(write.row["step"]) for write in trace.writes for number in write.fact.replaced}


def _relations(trace: Trace) -> list[tuple[int, int, str]]:
    ends = _replaced(trace)
    return [
        (
            int(write.row["step"]),
            ends.get(int(write.row["number"]), ALWAYS),
            f"{_name(tie.source)}: {tie.name} \N{RIGHTWARDS ARROW} {_name(tie.target)}, frame {tie.first}",
        )
        for write in trace.writes
        if (tie := write.fact.related) is not None
    ]


def _name(key: str) -> str:
    return key.rpartition("/")[2]


# -- steps ------------------------------------------------------------------------------------------------------------


def _steps(trace: Trace, observer: Observer) -> list[dict[str, Any]]:
    looks = {look.step: (number, look) for number, look in enumerate(trace.looks)}
    refused: dict[int, list[Row]] = {}
    for write in trace.writes:
        if not write.row["accepted"]:
            refused.setdefault(int(write.row["step"]), []).append(write.row)
    strips: dict[int, str] = {}
    return [
        _step(trace, step, looks.get(step["step"]), refused.get(step["step"], []), observer, strips)
        for step in trace.steps
    ]


def _step(
    trace: Trace,
    step: Row,
    look: tuple[int, Look] | None,
    refused: list[Row],
    observer: Observer,
    strips: dict[int, str],
) -> dict[str, Any]:
    of_model = step["kind"] == "model"
    request = _messages(step["request"]) if of_model else _plain(step["request"])
    response = _reply(step["response"]) if of_model else _plain(step["response"])
    view = None
    if look is not None and look[0] < _PICTURES:
        view = _view(trace, look[1], observer, strips)
    elif look is not None:
        said = f"only the first {_PICTURES} looks are shown"
        view = {"missing": said, "frame": look[1].frame, "angle": look[1].angle}
    return {
        "number": step["step"],
        "kind": step["kind"],
        "seconds": step["seconds"],
        "request": request,
        "response": response,
        # A call and what it came to, side by side.
        "short": not of_model and max(len(request), len(response)) <= 160 and "\n" not in request + response,
        "refused": refused,
        "view": view,
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
    except (msgspec.DecodeError, UnicodeEncodeError):
        return _cut(text)
    return _cut("\n\n".join(f"[{message.role}]\n{message.content}" for message in messages))


def _reply(text: str) -> str:
    try:
        reply = msgspec.json.decode(text, type=_Reply)
    except (msgspec.DecodeError, UnicodeEncodeError):
        return _cut(text)
    thought = f"[reasoning]\n{_cut(reply.reasoning)}\n\n" if reply.reasoning else ""
    ended = "" if reply.finish_reason in ("", "stop") else f"\n[finish_reason {reply.finish_reason}]"
    return f"{thought}{_plain(reply.content)}{ended}"


def _view(trace: Trace, look: Look, observer: Observer, strips: dict[int, str]) -> dict[str, Any]:
    """The view on the panorama strip, and the crop in small; `strips` holds those of frames seen before."""
    sequence = str(trace.question["sequence"])
    scale = _STRIP[0] / WIDTH
    spans = [(0.0, float(_STRIP[0]))]
    if look.angle is not None:
        ends = [(look.left, min(look.left + CROP, WIDTH)), (0, max(0, look.left + CROP - WIDTH))]
        spans = [(a * scale, (b - a) * scale) for a, b in ends if b > a]
    try:
        if look.frame not in strips:
            strips[look.frame] = jpeg_uri(jpeg_bytes(observer.panorama(sequence, look.frame), _STRIP))
        crop = None if look.angle is None else observer(sequence, look.frame, look.angle).image
    except ObserveError as error:
        return {"missing": str(error), "frame": look.frame, "angle": look.angle}
    return {
        "missing": "",
        "frame": look.frame,
        "angle": look.angle,
        "strip": strips[look.frame],
        "size": _STRIP,
        "spans": spans,
        "crop": "" if crop is None else jpeg_uri(jpeg_bytes(crop, _SMALL)),
    }


def _final(trace: Trace, observer: Observer) -> dict[str, Any] | None:
    """The box given as evidence and the target's in that frame, in the crop round them; None without a box."""
    found = _given(trace)
    if found is None:
        return None
    frame, given = found
    target = trace.target.get(frame)
    overlap = None if target is None else iou(given, Box(*target))
    angle = float(center_angle(given.x, given.w))
    try:
        seen = observer(str(trace.question["sequence"]), frame, angle)
    except ObserveError as error:
        return {"missing": str(error), "iou": overlap}
    return {
        "missing": "",
        "frame": frame,
        "angle": angle,
        "uri": jpeg_uri(jpeg_bytes(seen.image, (CROP, CROP))),
        "size": (CROP, HEIGHT),
        "given": to_crop(given, seen.left),
        "target": None if target is None else to_crop(Box(*target), seen.left),
        "iou": overlap,
    }
