"""The map of a trace: where a run looked and what it saw, panorama columns across and time downwards."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from jrdb_avr.engine.report.traces import Look, Trace
from jrdb_avr.schema.answers import FrameAnswer, FrameViewpoint, Span, decode_answer
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import CROP, WIDTH, Box

MAP_WIDTH: Final = 1000.0
MAP_HEIGHT: Final = 380.0
_TOP: Final = 24.0
_LEFT: Final = 62.0

_NAMED: Final = 16
"""Entities whose names stand on the map."""

_FAR: Final = 450
"""Frames beyond what was looked at that the map still reaches for a given answer."""


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
    """What the map shows. answers: the frames of the true answer and of the one given, as (which, height, words)."""

    marks: tuple[Mark, ...]
    path: str
    ticks: tuple[tuple[float, str], ...]
    answers: tuple[tuple[str, float, str], ...]
    last: int


def trace_map(trace: Trace, names: Mapping[str, tuple[str, int]]) -> Map:
    """Lay the map out; `names`: key of each entity -> its name and colour."""
    frames = [look.frame for look in trace.looks]
    given = given_box(trace)
    if given is not None:
        frames.append(given[0])
    said = {
        "true": _frames(trace.question["answer_mode"], trace.answer["answer"]),
        "given": _frames(trace.question["answer_mode"], trace.prediction["answer"]),
    }
    frames += said["true"]
    # An answer may name any frame; one far outside what was looked at would press the rest together.
    within = min(frames, default=0) - _FAR, max(frames, default=0) + _FAR
    said["given"] = [frame for frame in said["given"] if within[0] <= frame <= within[1]]
    frames += said["given"]
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
    answers = tuple(
        (which, y(frame), f"{which} {frame / trace.fps:.1f} s") for which, own in said.items() for frame in own
    )
    return Map(tuple(marks), _way(trace, low, high, y), ticks, answers, last_step)


def _frames(mode: str, text: str | None) -> list[int]:
    """The frames that an answer names; none where it names none or cannot be read."""
    try:
        answer = decode_answer(mode, text or "")
    except DecodeError:
        return []
    match answer:
        case FrameAnswer() | FrameViewpoint():
            return [answer.frame]
        case Span():
            return [answer.start_frame, answer.end_frame]
        case _:
            return []


def given_box(trace: Trace) -> tuple[int, Box] | None:
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


def _way(trace: Trace, low: int, high: int, y: Callable[[float], float]) -> str:
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
