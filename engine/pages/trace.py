"""The trace page: how a run came to its answer to one question, step by step, with the true answer beside it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import msgspec

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.page import on_strip, picture_uri, readable, render, unit_of
from jrdb_avr.engine.pages.svg import shortened
from jrdb_avr.engine.report.traces import Look, StoredRow, Trace, Transcript
from jrdb_avr.engine.report.truth import read_answer
from jrdb_avr.schema.answer_modes import frames_of_answer
from jrdb_avr.schema.answers import Answer, Choice
from jrdb_avr.schema.beliefs import ALWAYS
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, center_angle, iou, to_crop
from jrdb_avr.schema.plan import parse_plan

ROLES: Final = 6
"""Number of colours of people in `roles.css`."""

_STRIP: Final = (1128, 144)
_SMALL: Final = (240, 240)
_PICTURES: Final = 200
"""Maximum number of looks with a picture. With more pictures, browsers might fail to open the page."""

_LONGEST: Final = 20_000
"""Maximum number of characters of a text. The middle of a longer text is left out."""

_NAMED: Final = 16
"""Maximum number of entities with names on the map. If there are more entities, the map shows no names."""

_FAR: Final = 450
"""Maximum distance in frames from the map's other frames to the run's answer. The map leaves out a farther answer."""

Names = Mapping[str, tuple[str, int]]
"""Name and colour number of each entity of the world model, by the key of the entity. Keys are in order of creation."""


def trace_page(trace: Trace, observer: Observer) -> str:
    """Render the trace page.

    Args:
        trace: Record of the run's work on the question.
        observer: Source of pictures.

    Returns:
        The HTML.
    """
    sequence = str(trace.question["sequence"])
    strip = functools.cache(lambda frame: picture_uri(observer.panorama(sequence, frame), _STRIP))
    made = [write.fact.entity for write in trace.writes if write.fact.entity is not None]
    names = {entity.id: (entity.name, index % ROLES) for index, entity in enumerate(made)}
    evidence = evidence_box(trace)
    unit = unit_of(parse_plan(trace.answer["plan"]))
    mode, choices = trace.question["answer_mode"], trace.question["choices"]
    answers = [row["answer"] for row in (trace.answer, trace.prediction)]
    true, predicted = (readable(mode, text, choices, trace.fps, unit) for text in answers)
    true_choice, own_choice = (_choice(read_answer(mode, text)) for text in answers)
    return render(
        "trace.html",
        trace=trace,
        question=trace.question,
        prediction=trace.prediction,
        choices=[(text, index == true_choice, index == own_choice) for index, text in enumerate(choices, 1)],
        given=predicted,
        right=true,
        map=_map(trace, evidence),
        marks=_marks(trace, names),
        box=evidence,
        panorama=WIDTH,
        strip_size=_STRIP,
        last_step=max((int(step["step"]) for step in trace.steps), default=0),
        entities=_cards(trace, names),
        web=_web(trace, names),
        steps=_steps(trace, observer, strip),
        final=None if evidence is None else _final(trace, *evidence, observer, strip),
        settings=_plain(msgspec.json.encode(trace.manifest.settings).decode()),
    )


def evidence_box(trace: Transcript) -> tuple[int, Box] | None:
    """Return the frame and the box of a run's evidence.

    Args:
        trace: Record of the run's work on the question.

    Returns:
        The frame and the box in stitched pixels, or None if there is no evidence or the box is not finite.
    """
    frame, sides = trace.prediction["evidence_frame"], [trace.prediction[f"evidence_{key}"] for key in "xywh"]
    if frame is None or any(side is None or not math.isfinite(side) for side in sides):
        return None
    return frame, Box(*sides)


def _choice(answer: Answer | None) -> int | None:
    return answer.choice if isinstance(answer, Choice) else None


# -- the map: panorama columns across and frames downwards -------------------------------------------------------------


def _map(trace: Trace, evidence: tuple[int, Box] | None) -> dict[str, Any]:
    """Return the content of the map, which shows frames and columns of the panoramas.

    `low` and `high` are the first and the last frame of the map. `ticks` are the frames with a label. `answers` has the
    frames that the true answer states and the frames that the run's answer states. `way` is the path of the target.
    """
    mode = trace.question["answer_mode"]
    true, predicted = (_frames(mode, row["answer"]) for row in (trace.answer, trace.prediction))
    frames = [look.frame for look in trace.looks] + ([] if evidence is None else [evidence[0]]) + true
    # A distant answer is left out, because it would compress the rest of the map.
    low, high = min(frames, default=0) - _FAR, max(frames, default=0) + _FAR
    predicted = [frame for frame in predicted if low <= frame <= high]
    first, last = min(frames + predicted, default=0), max(frames + predicted, default=0)
    # The margins show the target's path before the first frame and after the last frame.
    room = max(15, (last - first) // 12)
    return {
        "low": first - room,
        "high": last + room,
        "ticks": sorted({first, (first + last) // 2, last}),
        "answers": [("true", frame) for frame in true] + [("given", frame) for frame in predicted],
        "way": _path(trace, first - room, last + room),
    }


def _frames(mode: str, text: str | None) -> list[int]:
    """Return the frames that an answer states. The list is empty if the answer states no frame or cannot be read."""
    answer = read_answer(mode, text)
    return [] if answer is None else frames_of_answer(answer)


def _path(trace: Trace, low: int, high: int) -> list[list[tuple[float, int]]]:
    """Return the path of the target as segments. A segment is a list of points, and a point is a pair (column, frame).

    A new segment begins after a gap in the frames, and after the target has crossed the seam of the panorama.
    """
    path: list[list[tuple[float, int]]] = []
    for frame, (x, _, w, _) in sorted(trace.target.items()):
        if not low <= frame <= high:
            continue
        column = (x + w / 2) % WIDTH
        if not path or frame - path[-1][-1][1] > 15 or abs(column - path[-1][-1][0]) >= WIDTH / 2:
            path.append([])
        path[-1].append((column, frame))
    return path


def _marks(trace: Trace, names: Names) -> list[dict[str, Any]]:
    """Return the marks on the map. A mark shows a sighting of an entity, or a relation between entities in one frame.

    Each mark has a step, a colour (`role`), a frame, a column and a text. The mark of a sighting also has a name
    (`label`, which may be empty). `label_y` is the distance from the mark down to the name. The mark of a relation also
    has the column of the relation's other end (`end`).
    """
    marks: list[dict[str, Any]] = []
    columns: dict[tuple[str, int], float] = {}
    labelled: set[str] = set()
    levels: dict[int, list[list[tuple[float, float]]]] = {}
    for write in trace.writes:
        if (sighting := write.fact.sighted) is not None and sighting.source in names:
            name, role = names[sighting.source]
            column = columns[sighting.source, sighting.frame] = (sighting.box.x + sighting.box.w / 2) % WIDTH
            mark = {"step": write.step, "role": role, "frame": sighting.frame, "column": column, "end": None}
            # If there are few entities, each name is drawn once, on the first free line below the first sighting.
            label = name[:12] if sighting.source not in labelled and len(names) <= _NAMED else ""
            left = column * _MAP_WIDTH / WIDTH
            beside = levels.setdefault(sighting.frame // 15, [])
            line = _level(beside, (left, left + 12 + _LETTER * len(label))) if label else 0
            marks.append(mark | {"text": f"{name}, frame {sighting.frame}", "label": label, "label_y": 17 + 12 * line})
            labelled.add(sighting.source)
        if (tie := write.fact.related) is not None:
            start, end = (columns.get((key, tie.first)) for key in (tie.source, tie.target))
            if start is not None and end is not None:
                mark = {"step": write.step, "role": names[tie.source][1], "frame": tie.first, "column": start}
                marks.append(mark | {"end": end, "text": tie.name})
    return marks


# -- the world model as it grew ----------------------------------------------------------------------------------------


class Statement(NamedTuple):
    """A statement of the world model: the step that wrote it, the step that replaced it (`until`), and its text.

    `until` is `ALWAYS` if no step replaced the statement.
    """

    step: int
    until: int
    text: str


@dataclass
class Card:
    """An entity of the world model, with the statements about it.

    `always` has the statements that do not belong to a frame. `frames` has the other statements, by frame.
    """

    name: str
    role: int
    step: int
    kind: str
    always: list[Statement] = field(default_factory=list)
    frames: dict[int, list[Statement]] = field(default_factory=dict)


def add_statement(statements: list[Statement], new: Statement) -> None:
    """Add a statement to a list, or extend an old statement that has the same text.

    If an old statement with the same text still holds at the step of the new one, no statement is added. Instead, the
    field `until` of the old statement becomes the later of the two values of `until`.

    Args:
        statements: Statements about one entity. The list is changed in place.
        new: The statement to add.
    """
    for index, old in enumerate(statements):
        if old.text == new.text and new.step <= old.until:
            statements[index] = old._replace(until=max(old.until, new.until))
            return
    statements.append(new)


def _cards(trace: Trace, names: Names) -> list[Card]:
    """Return a card for each entity, with the statements about the entity."""
    cards: dict[str, Card] = {}
    for write in trace.writes:
        step, until, fact = write.step, write.until, write.fact
        for freed in fact.freed:
            if freed in cards:
                cards[freed].always.append(Statement(step, ALWAYS, "is nobody of the plan any more"))
        if (made := fact.entity) is not None:
            card = cards[made.id] = Card(*names[made.id], step, made.kind)
            if made.node:
                card.always.append(Statement(step, ALWAYS, f"is the plan's {made.node}"))
        if (now := fact.changed) is not None and now.id in cards:
            text = f"is the plan's {now.node}" if now.node else f"is a {now.kind}"
            cards[now.id].always.append(Statement(step, ALWAYS, text))
        if (sighting := fact.sighted) is not None and sighting.source in cards:
            position = Statement(step, until, f"at {sighting.angle:.0f}\N{DEGREE SIGN}")
            add_statement(cards[sighting.source].frames.setdefault(sighting.frame, []), position)
        if (has := fact.has) is not None and has.source in cards:
            card, text = cards[has.source], f"{has.name}: {has.value}"
            statements = card.frames.setdefault(has.first, []) if has.first == has.last else card.always
            add_statement(statements, Statement(step, until, text))
    return list(cards.values())


_NODE: Final = (126.0, 40.0)
_STRIDE: Final = 190.0
_ARC: Final = 32.0
_LETTER: Final = 6.4
_MAP_WIDTH: Final = 934.0
"""Width of the map in `trace.html`, in units of its view box."""
_WORDS: Final = 60
_MOST_NODES: Final = 40
"""Maximum number of entities in the drawing of relations. With more entities, the page lists the relations as text."""


def _web(trace: Trace, names: Names) -> dict[str, Any] | None:
    """Return the drawing of the relations between entities.

    `knots` are the entities, which stand in a row. `ties` are the relations, which are arcs above the row. `left` and
    `size` give the view box. The result is None if there are no relations, or if there are too many entities
    for a drawing.
    """
    made = {write.fact.entity.id: write.step for write in trace.writes if write.fact.entity is not None}
    related = [(write, tie) for write in trace.writes if (tie := write.fact.related) is not None]
    joined = dict.fromkeys(key for _, tie in related for key in (tie.source, tie.target) if key in made)
    if not joined or len(joined) > _MOST_NODES:
        return None
    positions = {key: index * _STRIDE + 1 for index, key in enumerate(joined)}
    several = len({tie.first for _, tie in related}) > 1
    levels: list[list[tuple[float, float]]] = []
    ties: list[dict[str, Any]] = []
    for write, tie in related:
        if tie.source not in positions or tie.target not in positions:
            continue
        shift = _NODE[0] * (0.62 if positions[tie.target] > positions[tie.source] else 0.38)
        x1, x2 = positions[tie.source] + shift, positions[tie.target] + _NODE[0] - shift
        title = f"{tie.name}, frame {tie.first}"
        # The text has the frame only if the relations are not all in the same frame.
        text = shortened(title if several else tie.name, _WORDS)
        half = max(abs(x1 - x2), _LETTER * len(text)) / 2 + 6
        rise = _ARC * (1 + _level(levels, ((x1 + x2) / 2 - half, (x1 + x2) / 2 + half)))
        tie_words = {"text": text, "title": title, "step": write.step, "until": write.until}
        ties.append({"x1": x1, "x2": x2, "rise": rise, **tie_words})
    knots = [{"x": x, "name": names[key][0], "role": names[key][1], "step": made[key]} for key, x in positions.items()]
    # The words on arcs may reach beyond the row of entities.
    ends = [end for level in levels for extent in level for end in extent]
    left, right = min(0.0, *ends), max((len(positions) - 1) * _STRIDE + _NODE[0] + 2, *ends)
    height = max((tie["rise"] for tie in ties), default=0.0) + 18 + _NODE[1] + 2
    return {"left": left, "size": (right - left, height), "node": _NODE, "knots": knots, "ties": ties}


def _level(levels: list[list[tuple[float, float]]], extent: tuple[float, float]) -> int:
    """Reserve a horizontal extent on the lowest level that has space for this extent, and return the level's index."""
    for index, taken in enumerate(levels):
        if all(extent[1] < low or high < extent[0] for low, high in taken):
            taken.append(extent)
            return index
    levels.append([extent])
    return len(levels) - 1


# -- steps -------------------------------------------------------------------------------------------------------------


class _Message(msgspec.Struct):
    role: str
    content: str


class _Reply(msgspec.Struct):
    content: str = ""
    reasoning: str = ""
    finish_reason: str = ""


def _steps(trace: Trace, observer: Observer, strip: Callable[[int], str]) -> list[dict[str, Any]]:
    """Return the steps of the run. Each step has its look, if any, and the refused changes of the world model."""
    views = {look.step: _view(trace, look, observer, strip) for look in trace.looks[:_PICTURES]}
    for look in trace.looks[_PICTURES:]:
        views[look.step] = {"look": look, "missing": f"only the first {_PICTURES} looks have pictures"}
    refused: dict[int, list[StoredRow]] = {}
    for write in trace.refused:
        refused.setdefault(write.step, []).append(write.row)
    return [
        _step(step) | {"refused": refused.get(step["step"], []), "view": views.get(step["step"])}
        for step in trace.steps
    ]


def _step(step: StoredRow) -> dict[str, Any]:
    of_model = step["kind"] == "model"
    request = _messages(step["request"]) if of_model else _plain(step["request"])
    response = _reply(step["response"]) if of_model else _plain(step["response"])
    # Show a short call and its result side by side.
    short = not of_model and max(len(request), len(response)) <= 160 and "\n" not in request + response
    return {**step, "request": request, "response": response, "short": short}


def _view(trace: Trace, look: Look, observer: Observer, strip: Callable[[int], str]) -> dict[str, Any]:
    """Return a look with two pictures: its panorama and its crop.

    If a picture is missing, the value of `missing` is the reason. Otherwise the value is an empty text.
    """
    view: dict[str, Any] = {"look": look, "missing": "", "crop": ""}
    try:
        if look.angle is not None:
            crop = observer(str(trace.question["sequence"]), look.frame, look.angle).image
            view["crop"] = picture_uri(crop, _SMALL)
        return view | {"strip": strip(look.frame)}
    except ObserveError as error:
        return view | {"missing": str(error)}


def _final(trace: Trace, frame: int, box: Box, observer: Observer, strip: Callable[[int], str]) -> dict[str, Any]:
    """Return the evidence box, the target's box in the same frame (if there is one), and two pictures.

    The pictures are the panorama of the frame, and a crop around the evidence box.
    """
    target = Box(*trace.target[frame]) if frame in trace.target else None
    angle = float(center_angle(box.x, box.w))
    view: dict[str, Any] = {
        "frame": frame,
        "angle": angle,
        "iou": None if target is None else iou(box, target),
        "target_angle": None if target is None else float(center_angle(target.x, target.w)),
    }
    boxes = {"given": box} if target is None else {"target": target, "given": box}
    try:
        observation = observer(str(trace.question["sequence"]), frame, angle)
        return view | {
            "uri": picture_uri(observation.image, (CROP, CROP)),
            "boxes": [(name, to_crop(corners, observation.left)) for name, corners in boxes.items()],
            "strip": strip(frame),
            "on_strip": [(name, part) for name, corners in boxes.items() for part in on_strip(corners, _STRIP[0])],
        }
    except ObserveError as error:
        return view | {"missing": str(error)}


# -- texts of models, which may contain anything -----------------------------------------------------------------------


def _messages(text: str) -> str:
    """Return the messages to a model as text. Images are represented by their names."""
    messages = _decoded(text, list[_Message])
    return _cut(
        text if messages is text else "\n\n".join(f"[{message.role}]\n{message.content}" for message in messages)
    )


def _reply(text: str) -> str:
    reply = _decoded(text, _Reply)
    if reply is text:
        return _cut(text)
    thought = f"[reasoning]\n{_cut(reply.reasoning)}\n\n" if reply.reasoning else ""
    ended = "" if reply.finish_reason in ("", "stop") else f"\n[finish_reason {reply.finish_reason}]"
    return f"{thought}{_plain(reply.content)}{ended}"


def _plain(text: str | None) -> str:
    """Indent a long JSON text, including JSON objects inside its strings.

    Other texts are returned without indents. The middle of a very long text is left out.
    """
    if not text or len(text) <= 100:
        return text or ""
    value = _decoded(text)
    if isinstance(value, dict):
        inner = {name: isinstance(item, str) and item.startswith("{") for name, item in value.items()}
        value = {name: _decoded(item) if inner[name] else item for name, item in value.items()}
    try:
        return _cut(text if value is text else msgspec.json.format(msgspec.json.encode(value), indent=1).decode())
    except (UnicodeError, RecursionError):
        return _cut(text)


def _decoded(text: str, kind: Any = Any) -> Any:
    """Return the value of a JSON text. If the text is not JSON of the type `kind`, return the text itself."""
    try:
        return msgspec.json.decode(text, type=kind)
    except (msgspec.DecodeError, UnicodeError, RecursionError):
        return text


def _cut(text: str) -> str:
    half, more = _LONGEST // 2, len(text) - _LONGEST
    return text if more <= 0 else f"{text[:half]}\n[{more} characters left out]\n{text[-half:]}"
