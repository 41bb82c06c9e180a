"""A run's way through one question as a page: what was asked, seen, written and answered, beside the truth."""

from __future__ import annotations

from typing import Any, Final

import msgspec

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.answers import readable, unit_of
from jrdb_avr.engine.pages.page import jpeg_bytes, jpeg_uri, render
from jrdb_avr.engine.pages.trace_map import MAP_HEIGHT, MAP_WIDTH, given_box, trace_map
from jrdb_avr.engine.pages.trace_world import cards, entities, relations, web
from jrdb_avr.engine.report.traces import Look, Row, Trace
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, center_angle, iou, to_crop
from jrdb_avr.schema.plan import parse_plan

_STRIP: Final = (1128, 144)
_SMALL: Final = (240, 240)
_PICTURES: Final = 200
"""Looks with a picture; of the rest the page says where they were, so that it stays a file that can be opened."""

_LONGEST: Final = 20_000
"""Characters of a text that is shown; what is longer is cut in the middle, and says so."""


def trace_page(trace: Trace, observer: Observer) -> str:
    """The page's HTML."""
    names = entities(trace)
    return render(
        "trace.html",
        trace=trace,
        question=trace.question,
        prediction=trace.prediction,
        choices=_choices(trace),
        given=_said(trace, trace.prediction["answer"]),
        right=_said(trace, trace.answer["answer"]),
        map=trace_map(trace, names),
        width=MAP_WIDTH,
        height=MAP_HEIGHT,
        entities=cards(trace, names),
        relations=relations(trace),
        web=web(trace, names),
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
    unit = unit_of(parse_plan(trace.answer["plan"]))
    return readable(trace.question["answer_mode"], text, trace.question["choices"], trace.fps, unit)


def _plain(text: str | None) -> str:
    """JSON in a form that is good to read; JSON in a text of it too."""
    if not text or len(text) <= 100:
        return text or ""
    try:
        value = msgspec.json.decode(text)
        if isinstance(value, dict):
            value = {name: _inner(own) for name, own in value.items()}
        return _cut(msgspec.json.format(msgspec.json.encode(value), indent=1).decode())
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return _cut(text)


def _inner(value: Any) -> Any:
    """What a text that is a JSON object says; any other value as it is."""
    if not isinstance(value, str) or not value.startswith("{"):
        return value
    try:
        return msgspec.json.decode(value)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return value


def _cut(text: str) -> str:
    half, more = _LONGEST // 2, len(text) - _LONGEST
    return text if more <= 0 else f"{text[:half]}\n[{more} characters left out]\n{text[-half:]}"


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
    """The box given as evidence and the target's in that frame, on the strip and in the crop round the one given; None
    without a box."""
    found = given_box(trace)
    if found is None:
        return None
    frame, given = found
    sides = trace.target.get(frame)
    target = None if sides is None else Box(*sides)
    angle = float(center_angle(given.x, given.w))
    said: dict[str, Any] = {
        "frame": frame,
        "angle": angle,
        "iou": None if target is None else iou(given, target),
        "target_angle": None if target is None else float(center_angle(target.x, target.w)),
        "missing": "",
    }
    sequence = str(trace.question["sequence"])
    try:
        seen, whole = observer(sequence, frame, angle), observer.panorama(sequence, frame)
    except ObserveError as error:
        return said | {"missing": str(error)}
    boxes = {"target": target, "given": given}
    return said | {
        "uri": jpeg_uri(jpeg_bytes(seen.image, (CROP, CROP))),
        "boxes": [(name, to_crop(box, seen.left)) for name, box in boxes.items() if box is not None],
        "strip": jpeg_uri(jpeg_bytes(whole, _STRIP)),
        "size": _STRIP,
        "on_strip": [(name, box) for name, own in boxes.items() if own is not None for box in _on_strip(own)],
    }


def _on_strip(box: Box) -> list[Box]:
    """A box in the pixels of a strip; one over the seam at both ends."""
    scale = _STRIP[0] / WIDTH
    shifts = [shift for shift in (-WIDTH, 0, WIDTH) if box.x + shift < WIDTH and box.x + shift + box.w > 0]
    return [Box((box.x + shift) * scale, box.y * scale, box.w * scale, box.h * scale) for shift in shifts]
