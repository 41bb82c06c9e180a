"""Play the stages of all methods without a world model, each named by the last line of a request.

All stages share one engine. The model reads every picture of the conversation, ranks the people that the question may
mean, and then asks for the look that tells most, or answers. So the baselines choose their looks as well as the agent.
The plan of a question is the program that the question's words mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final

import msgspec

from jrdb_avr.agent.look.answer import Conclusion, conclude
from jrdb_avr.agent.look.attention import NextLook, next_looks
from jrdb_avr.agent.look.ranking import RankedHypothesis, rank
from jrdb_avr.agent.model.conventions import CONTRACT
from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.perceive.fields import Field, fields_of, perceivable, read_person
from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.perceive.readings import PersonReading
from jrdb_avr.agent.perceive.votes import Tracks
from jrdb_avr.agent.simulated.fields import describe
from jrdb_avr.agent.simulated.noise import PictureView, ReadPerson
from jrdb_avr.agent.simulated.play_tools import tools_turn
from jrdb_avr.agent.simulated.requests import Look, Play, PlayedReply, Request
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import CROP, Box, angle_error, center_angle, iou
from jrdb_avr.schema.plan import Plan

_SHOWN_DEG: Final = 12.0
"""Maximum angle between a look and a person in it."""
_TURN_DEG: Final = 1.5
"""Minimum angle between two looks at a frame, because equal looks are refused."""
_Corners = tuple[float, float, float, float]
_Readings = tuple[tuple[str, PersonReading], ...]


@dataclass(frozen=True)
class Thought:
    """What the model knows after the pictures of a request."""

    request: Request

    @cached_property
    def plan(self) -> Plan:
        """Plan of the question, as pictures can be read for it."""
        return perceivable(self.request.plan)

    @cached_property
    def tracks(self) -> Tracks:
        """People of all pictures, under the identities by which the model knows them."""
        tracks = Tracks({}, {})
        fields = fields_of(self.plan, self.request.choices)
        for index, look in enumerate(self.request.looks, 1):
            readings = _read(look.people, look.view, look.name or f"o{index}", fields)
            tracks = tracks.with_people(SeenColumns(look.view.left, look.view.width), look.frame, readings)
        return tracks

    @cached_property
    def hypotheses(self) -> tuple[RankedHypothesis, ...]:
        """People who may be the plan's nodes, the best first."""
        return rank(self.plan, self.tracks)

    @property
    def frames(self) -> Sequence[int]:
        """Legal frames, or the frames of the pictures if the method does not choose frames."""
        return self.request.frames or sorted({look.frame for look in self.request.looks})

    def next_look(self, left: int) -> NextLook | None:
        """Return the look with the most expected bits, or None if no look is worth making."""
        return next(iter(next_looks(self.plan, self.tracks, self.hypotheses, left, self.frames, 1)), None)

    def conclude(self, target: str | None = None) -> Conclusion | None:
        """Return the answer about the likeliest target, or about a given one if a hypothesis has it."""
        chosen = [one for one in self.hypotheses if one.nodes.get(self.plan.target) == target] or self.hypotheses
        return conclude(self.plan, self.tracks, chosen, self.request.choices, self.frames)

    def answer(self, conclusion: Conclusion | None) -> Any:
        """Return the answer in the form of a reply, or a guess without a conclusion."""
        return self.request.guess() if conclusion is None else MODES[self.plan.answer.mode].written(conclusion.answer)

    def evidence(self, conclusion: Conclusion | None, looks: Iterable[Look]) -> list[tuple[Look, Box]]:
        """Return the pictures that show the conclusion's person, with the box in each, whole ones first."""
        if conclusion is None:
            return []
        views = [(look, look.view.place(conclusion.box)) for look in looks if look.frame == conclusion.frame]
        shown = [(look, box) for look, box in views if box is not None]
        return sorted(shown, key=lambda pair: not _is_whole(*pair))


@lru_cache(4096)
def _read(people: tuple[ReadPerson, ...], view: PictureView, name: str, fields: tuple[Field, ...]) -> _Readings:
    """Return the people of a picture under the model's identities, as readings of the fields."""
    said = describe(people, [field.key for field in fields], view.size)
    numbers = {entity: number for number, entity in enumerate(said, 1)}
    picture = name, view.frame, view.left, view.size
    return tuple(
        (entity, read_person(value, numbers[entity], numbers, fields, *picture, CONTRACT))
        for entity, value in said.items()
    )


def _is_whole(look: Look, box: Box) -> bool:
    return box.x >= 0 and box.x + box.w <= look.view.width


def _bbox(look: Look, box: Box) -> dict[str, Any]:
    return {"frame_id": f"{look.frame:06d}", "bbox": write_box(box, look.view.size)}


# -- methods that look ------------------------------------------------------------------------------------------------


def _react(request: Request) -> PlayedReply:
    """Play a turn of ReAct: the next look, or the answer with the person's box in the newest picture."""
    thought, left = Thought(request), request.left("Looks made: ")
    request.legal()
    # The last look is for the box, which must be in the newest picture.
    look = thought.next_look(left - 1)
    if look is not None:
        return {"action": "observe", **_placed(look.frame, look.angle)}
    conclusion = thought.conclude()
    again = _second_look(thought, conclusion) if left else None
    if again is not None:
        return {"action": "observe", **_placed(*again)}
    boxes = [_bbox(*shown) for shown in thought.evidence(conclusion, request.looks[-1:])]
    return {"action": "answer", "answer": thought.answer(conclusion), "evidence_bboxes": boxes}


def _second_look(thought: Thought, conclusion: Conclusion | None) -> tuple[int, float] | None:
    """Return frame and angle of a look that shows the person whole, or None if the newest picture does."""
    if conclusion is None:
        return None
    looks, angle = thought.request.looks, center_angle(conclusion.box.x, conclusion.box.w)
    made = [_angle(look) for look in looks if look.frame == conclusion.frame]
    if looks[-1].frame == conclusion.frame and angle_error(made[-1], angle) <= _SHOWN_DEG:
        return None
    turns = (turn * sign for turn in range(CROP) for sign in (_TURN_DEG, -_TURN_DEG))
    turn = next(turn for turn in turns if all(angle_error(angle + turn, other) >= _TURN_DEG for other in made))
    return conclusion.frame, angle + turn


def _angle(look: Look) -> float:
    return center_angle(look.view.left, look.view.width)


def _placed(frame: int, angle: float) -> dict[str, Any]:
    return {"frame_id": f"{frame:06d}", "angle_deg": round(angle % 360.0, 3) % 360.0}


def _chat(request: Request) -> PlayedReply:
    """Play a turn of an agent without a world model: the next look, or the final answer."""
    thought, looks = Thought(request), request.looks
    if not any(look.panorama for look in looks):
        look = thought.next_look(request.left("Looks made: "))
        if look is not None:
            return {"calls": [{"tool": "observe", **_placed(look.frame, look.angle)}]}
    conclusion = thought.conclude()
    # Without a person, the call has no box. It is refused, and the question ends with an answer alone.
    evidence: dict[str, Any] = {"observation": looks[-1].name if looks else "o1", "box": []}
    for shown, box in thought.evidence(conclusion, looks)[:1]:
        evidence = {"observation": shown.name, "box": write_box(box, shown.view.size)}
    call = {"tool": "final_answer", "answer": thought.answer(conclusion), **evidence}
    return {"calls": [call]}


def _agent(request: Request) -> PlayedReply:
    """Play a turn of an agent, with or without a world model."""
    return tools_turn(request) if request.line("World: ") is not None else _chat(request)


def _plan(request: Request) -> PlayedReply:
    """Reply the question's plan. Repeat a refused plan, because the words have no other reading."""
    return dict(msgspec.to_builtins(request.plan))


# -- methods with fixed pictures --------------------------------------------------------------------------------------


def _answer_at_once(request: Request) -> PlayedReply:
    """Answer and box from all panoramas."""
    thought = Thought(request)
    conclusion = thought.conclude()
    boxes = [_bbox(*shown) for shown in thought.evidence(conclusion, request.looks)[:1]]
    return {"answer": thought.answer(conclusion), "evidence_bboxes": boxes}


def _write_facts(request: Request) -> PlayedReply:
    """Write one sentence: the panorama and the angle that show the person."""
    conclusion = Thought(request).conclude()
    if conclusion is None:
        return {"reasoning": ["No person in the pictures fits the description."]}
    angle = center_angle(conclusion.box.x, conclusion.box.w)
    return {"reasoning": [f"Frame {conclusion.frame:06d} shows the person at panorama angle {angle:.0f}."]}


def _propose(request: Request) -> PlayedReply:
    """Box the person in one of the panoramas."""
    return {"evidence_bboxes": _answer_at_once(request)["evidence_bboxes"]}


def _refine(request: Request) -> PlayedReply:
    """Box the person in the middle of the crop, which is centred on the proposed box."""
    crop = next((look for look in request.looks if not look.panorama), None)
    if crop is None:
        raise DecodeError("the prompt shows no crop")
    middle = crop.view.width / 2
    people = sorted(crop.people, key=lambda person: abs(person.box.x + person.box.w / 2 - middle))
    boxes = [_bbox(crop, person.box) for person in people[:1]]
    return {"evidence_bboxes": boxes}


def _choose(request: Request) -> PlayedReply:
    """Answer about the person in the refined box."""
    thought = Thought(request)
    try:
        refined = Box(*msgspec.json.decode(request.line("Refined box, stitched pixels: ") or "", type=_Corners))
    except msgspec.DecodeError:
        raise DecodeError("the prompt has no refined box of four numbers") from None
    overlaps = {
        f"p{person.identity}": iou(refined, person.box._replace(x=person.box.x + look.view.left))
        for look in request.looks
        for person in look.people
    }
    conclusion = thought.conclude(max(overlaps, key=lambda entity: overlaps[entity], default=None))
    return {"answer": thought.answer(conclusion)}


STAGES: Final[dict[str, Play]] = {
    "Your answer, as one JSON object:": _answer_at_once,
    "Your facts, as one JSON object:": _write_facts,
    "Where the person is, as one JSON object:": _propose,
    "The person's box in the crop, as one JSON object:": _refine,
    "Your choice of answer, as one JSON object:": _choose,
    "Your next turn, as one JSON object:": _react,
    "Your plan, as one JSON object:": _plan,
    "Your next calls, as one JSON object:": _agent,
}
"""Player of each stage by the last line of its prompt."""
