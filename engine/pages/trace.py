"""The trace page: how a run came to its answer to one question, step by step, with the true answer beside it."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import msgspec

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.pages.inspect import View
from jrdb_avr.engine.pages.page import on_strip, picture_uri, readable, render, unit_of
from jrdb_avr.engine.pages.svg import PlanGraph
from jrdb_avr.engine.pages.turns import ROLES, decision_of, entity_roles, look_words, plain_text, plan_of, turns_of
from jrdb_avr.engine.report.traces import Look, Trace, Transcript
from jrdb_avr.engine.report.truth import read_answer
from jrdb_avr.schema.answer_modes import frames_of_answer
from jrdb_avr.schema.beliefs import name_of
from jrdb_avr.schema.errors import ObserveError
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, center_angle, iou, to_crop

_STRIP: Final = (1128, 144)
_SMALL: Final = (240, 240)
_PICTURES: Final = 200
"""Maximum number of looks with a picture. With more pictures, browsers might fail to open the page."""

_NAMED: Final = 16
"""Maximum number of entities with names on the map. If there are more entities, the map shows no names."""

_FAR: Final = 450
"""Maximum distance in frames from the map's other frames to the run's answer. The map leaves out a farther answer."""


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
    roles, plan, decision = entity_roles(trace), plan_of(trace), decision_of(trace)
    bound = decision.bindings[0].nodes if decision is not None and decision.bindings else {}
    nodes = [] if plan is None else [node.id for node in plan.nodes]
    evidence = evidence_box(trace)
    unit = unit_of(trace.answer["plan"])
    mode, choices = trace.question["answer_mode"], trace.question["choices"]
    answers = trace.answer["answer"], trace.prediction["answer"], trace.prediction["proposed"]
    true, predicted, proposed = (readable(mode, text, choices, trace.fps, unit) for text in answers)
    true_choice, own_choice, _ = (getattr(read_answer(mode, text), "choice", None) for text in answers)
    return render(
        "trace.html",
        trace=trace,
        question=trace.question,
        prediction=trace.prediction,
        choices=[(text, index == true_choice, index == own_choice) for index, text in enumerate(choices, 1)],
        given=predicted,
        proposed=proposed,
        right=true,
        map=_map(trace, evidence),
        marks=_marks(trace, roles),
        box=evidence,
        panorama=WIDTH,
        strip_size=_STRIP,
        last_step=max((int(step["step"]) for step in trace.steps), default=0),
        roles=roles,
        plan=plan,
        graph=None if plan is None else PlanGraph(plan),
        node_roles={node: roles.get(bound.get(node, ""), index % ROLES) for index, node in enumerate(nodes)},
        decision=decision,
        slots={row.number: row for write in trace.writes for row in write.fact.slots},
        bound=bound,
        turns=_turns(trace, observer, strip, roles),
        final=None if evidence is None else _final(trace, *evidence, observer, strip),
        settings=plain_text(msgspec.json.encode(trace.manifest.settings).decode()),
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


def _marks(trace: Trace, roles: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return the marks on the map. A mark shows a sighting of an entity.

    Each mark has a step, a colour (`role`), a frame, a column, the name of the entity, and a label. The label is the
    name for the first sighting of each entity, if there are few entities, else empty. `label_y` is the distance from
    the mark down to the label.
    """
    marks: list[dict[str, Any]] = []
    lines = {name: 17 + 12 * (index % 3) for index, name in enumerate(roles)} if len(roles) <= _NAMED else {}
    for sighting in (sighting for write in trace.writes for sighting in write.fact.sighted):
        name, column = name_of(sighting.source), (sighting.box.x + sighting.box.w / 2) % WIDTH
        mark = {"step": sighting.step, "role": roles.get(name, 0), "frame": sighting.frame, "column": column}
        label = {"label": name[:12] if name in lines else "", "label_y": lines.pop(name, 0)}
        marks.append(mark | label | {"text": name})
    return marks


# -- turns -------------------------------------------------------------------------------------------------------------


def _turns(trace: Trace, observer: Observer, strip: Callable[[int], str], roles: Mapping[str, int]) -> list[Any]:
    """Return pairs of a turn and the pictures of its looks."""
    views = {look.step: _view(trace, look, observer, strip, roles) for look in trace.looks[:_PICTURES]}
    missing = {"crop": None, "missing": f"only the first {_PICTURES} looks have pictures"}
    views |= {look.step: missing | {"words": look_words(look)} for look in trace.looks[_PICTURES:]}
    return [(turn, [views[look.step] for look in turn.looks]) for turn in turns_of(trace)]


def _view(
    trace: Trace, look: Look, observer: Observer, strip: Callable[[int], str], roles: Mapping[str, int]
) -> dict[str, Any]:
    """Return a look with two pictures, its panorama and its crop, and the boxes that the run wrote for it.

    If a picture is missing, the value of `missing` is the reason. Otherwise the value is an empty text.
    """
    keys = {row.id for write in trace.writes for row in write.fact.looks if row.step == look.step}
    seen = (sighting for write in trace.writes for sighting in write.fact.sighted if sighting.target in keys)
    boxes = [(name_of(sighting.source), sighting.box) for sighting in seen]
    on_panorama = [(roles.get(name, 0), part) for name, box in boxes for part in on_strip(box, _STRIP[0])]
    view: dict[str, Any] = {"look": look, "words": look_words(look), "missing": "", "crop": None, "boxes": on_panorama}
    try:
        if look.angle is not None:
            crop = observer(str(trace.question["sequence"]), look.frame, look.angle)
            framed = [(name, to_crop(box, crop.left)) for name, box in boxes]
            view["crop"] = View(view["words"], picture_uri(crop.image, _SMALL), CROP, CROP, framed, plate=34.0)
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
