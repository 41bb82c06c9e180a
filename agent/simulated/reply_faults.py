"""Faults of replies: wrong boxes, looks that go elsewhere, wrong relations of a plan, and replies that are no answer.

A draw is about the whole request, which the draws of `knobs` are handed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.conventions import SCALE
from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.policy.explorer import Look
from jrdb_avr.agent.simulated.knobs import Draws, Knobs
from jrdb_avr.schema.relations import QUESTION_RELATIONS, RELATIONS

_SORRY: Final = "I am sorry, but I cannot help with questions about people in pictures."


@dataclass(frozen=True)
class Wording:
    """A reply as it is sent; `refusal` stands in place of the content."""

    content: str
    finish_reason: str = "stop"
    refusal: str | None = None


def with_wrong_boxes(reply: Mapping[str, Any], looks: Sequence[Look], knobs: Knobs, draws: Draws) -> Mapping[str, Any]:
    """The reply with some of its boxes wrong."""

    def entry(number: int, place: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        look = _look_of(place, looks)
        # A person who was never found has an empty box, which stays.
        if look is None or not place.get(key) or not draws.happens(knobs.wrong_box, "box", number):
            return place
        return {**place, key: _wrong_box(place[key], look, draws, number)}

    lists = (
        (name, key)
        for name, key in (("evidence_bboxes", "bbox"), ("calls", "box"), ("people", "box"))
        if reply.get(name)
    )
    return {**reply, **{name: [entry(n, place, key) for n, place in enumerate(reply[name])] for name, key in lists}}


def _look_of(place: Mapping[str, Any], looks: Sequence[Look]) -> Look | None:
    """The newest picture that a box lies in; a box that names none lies in the newest one."""
    name, frame = place.get("observation"), place.get("frame_id")
    if name is None and frame is None and "tool" not in place:
        return looks[-1] if looks else None
    fitting = (look for look in looks if (f"{look.frame:06d}" == frame if name is None else look.name == name))
    return next(reversed([*fitting]), None)


def _wrong_box(box: list[int], look: Look, draws: Draws, number: int) -> list[int]:
    """Another person's box in the picture, or the box beside itself by more than half its width."""
    others = [write_box(seen.box, look.size) for seen in look.sightings]
    others = [other for other in others if other != box and other[0] < other[2] and other[1] < other[3]]
    if others and draws.happens(0.5, "whose", number):
        return draws.pick(others, "which", number)
    left, top, right, bottom = box
    shift = max(round((right - left) * (0.6 + 0.6 * draws.share("shift", number))), 1)
    for by in (shift, -shift) if draws.happens(0.5, "side", number) else (-shift, shift):
        if left + by >= 0 and right + by <= SCALE:
            return [left + by, top, right + by, bottom]
    # No room beside it, so it is wide: its left third, as if the rest of the person were covered.
    return [left, top, left + (right - left) // 3, bottom]


def with_wrong_policy(reply: Mapping[str, Any], knobs: Knobs, draws: Draws) -> Mapping[str, Any]:
    """The reply with some of its looks turned elsewhere, or some relations of its plan replaced."""

    def turned(number: int, look: Mapping[str, Any]) -> Mapping[str, Any]:
        if "angle_deg" not in look or "frame_id" not in look or not draws.happens(knobs.policy, "look", number):
            return look
        angle = look["angle_deg"] + 60 + 240 * draws.share("angle", number)
        return {**look, "angle_deg": round(angle % 360, 3)}

    def replaced(number: int, edge: Mapping[str, Any]) -> Mapping[str, Any]:
        if not draws.happens(knobs.policy, "edge", number):
            return edge
        kind = RELATIONS[edge["relation"]].kind
        alike = [label for label in QUESTION_RELATIONS if RELATIONS[label].kind == kind or kind == "group"]
        return {**edge, "relation": draws.pick([label for label in alike if label != edge["relation"]], number)}

    if reply.get("action") == "observe":
        return turned(0, reply)
    if reply.get("look") == 1 and draws.happens(knobs.policy, "pick"):
        return {**reply, "look": 2}
    lists = ((name, change) for name, change in (("calls", turned), ("edges", replaced)) if reply.get(name))
    return {**reply, **{name: [change(n, part) for n, part in enumerate(reply[name])] for name, change in lists}}


def word(content: str, knobs: Knobs, draws: Draws) -> tuple[Wording, str]:
    """The reply as it is sent, and the name of the knob that spoiled it, if any."""
    if draws.happens(knobs.refusal, "refusal"):
        return Wording("", refusal=_SORRY), "refusal"
    thought = think(knobs, draws)
    if draws.happens(knobs.truncated, "truncated"):
        end = 1 + int(draws.share("end") * (len(content) - 1))
        return Wording(thought + content[:end], "length"), "truncated"
    sound = (1 - knobs.malformed) * (1 - knobs.malformed_per_kb) ** (len(content) / 1000)
    if draws.happens(1 - sound if knobs.malformed_per_kb else knobs.malformed, "malformed"):
        return Wording(thought + _malformed(content, draws)), "malformed"
    return Wording(thought + content), ""


def think(knobs: Knobs, draws: Draws) -> str:
    """Thinking to stand before a reply, if any."""
    if not draws.happens(knobs.thinking, "thinking"):
        return ""
    return "<think>\nI go through the pictures one by one and compare what I read with the question.\n</think>\n"


def _malformed(content: str, draws: Draws) -> str:
    """A JSON object as models spoil it: it lacks its end, prose stands round it, or it has Python's quotes."""
    spoiled = (content[:-1], f"Here is my reply: {content} I hope that this helps.", repr(msgspec.json.decode(content)))
    return draws.pick(spoiled, "how")
