"""Play the stages of all methods, each named by the last line of a request.

ReAct gets the next look, or the answer with the person's box in the newest picture. A plan is the program that the
question's words stand for, as the template table parses them.

The methods with a fixed context get an answer from the pictures sent. Few of the panoramas show a moment that the
question names: the model looks for the person in the one nearest to the description, events lie between two panoramas,
and where nothing decides it guesses, because the contract demands an answer. A box is always that of a person who was
read. Monolithic reads the panoramas once. Chain of thought, and search-recognize, also look for a hidden person in the
other panoramas; the answer of a chain of thought is read from the facts that it wrote down.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.policy.explorer import Explorer, FixedExplorer, Look, NeedObservation, Sighting
from jrdb_avr.agent.policy.finding import among, likely
from jrdb_avr.agent.policy.hops import path
from jrdb_avr.agent.policy.policy import find_answer, find_target
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.agent.simulated import fields
from jrdb_avr.agent.simulated.facts import Facts, known_facts, shown_there, write_facts
from jrdb_avr.agent.simulated.play_agent import agent_turn
from jrdb_avr.agent.simulated.requests import Play, Request, StageReply
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import CROP, Box, from_crop, iou


def _react(request: Request) -> StageReply:
    """A turn of ReAct. Raises DecodeError where the prompt names no legal frame or no count of looks."""
    explorer = Explorer(request.legal(), request.looks, request.left("Looks made: "))
    state = EpisodeState(request.plan, request.choices, explorer, beside=True)
    try:
        person = find_target(state)
        answer = find_answer(state, person)
        evidence = _newest_box(state, person)
    except NeedObservation as need:
        angle = round(need.angles[0], 3)
        return StageReply({"action": "observe", "frame_id": f"{need.frame:06d}", "angle_deg": angle})
    return StageReply({"action": "answer", "answer": answer, "evidence_bboxes": evidence}, state.missing)


def _newest_box(state: EpisodeState, person: Sighting | None) -> list[dict[str, Any]]:
    """The person's box in the newest picture; looks once more where that picture does not show it whole.

    Empty where the person was never found.
    """
    if person is None:
        return []
    explorer, identity = state.explorer, person.identity
    seen = explorer.looks[-1].of(identity)
    if seen is None or not seen.whole:
        best = max(explorer.sightings(identity), key=lambda seen: (seen.whole, seen.frame))
        with state.budget("no look was left to show the person again"):
            seen = explorer.again(best.frame, best.angle).of(identity) or seen
    if seen is None:
        state.note("mark unreadable in the look that should show the person again")
        return []
    return [{"frame_id": f"{seen.frame:06d}", "bbox": write_box(seen.box, (CROP, CROP))}]


def _plan(request: Request) -> StageReply:
    """The question's plan; a refused plan is repeated, as the words have no other reading."""
    return StageReply(msgspec.to_builtins(request.plan))


def _answer_at_once(request: Request) -> StageReply:
    """Answer and box: from facts where the prompt holds some, else from one reading of the panoramas.

    One reading looks for the person in the panorama nearest to the description only, and boxes the person there.
    """
    known = known_facts(request.lines, request.looks)
    if known is not None:
        return _answer_from_facts(request, known)
    state = EpisodeState(request.plan, request.choices, FixedExplorer(request.looks))
    frame = state.explorer.legal(state.t0)
    exact, people = frame == state.t0, state.explorer.at(frame)
    found = among(state.description, people)
    state.note(found.missing)
    person = found.sighting or likely(state.description, people, exact=exact)
    if person is not None and state.plan.edges:
        person = path(state.plan, person, people).get(state.plan.target)
        state.note("" if person else "mark unreadable: a hop leads to nobody, or to several")
    state.note_unseen()
    answer = find_answer(state, person)
    looks = [look for look in request.looks if look.frame == frame]
    return StageReply({"answer": answer, "evidence_bboxes": _best_box(looks, person)}, state.missing)


def _answer_from_facts(request: Request, known: Facts) -> StageReply:
    state = EpisodeState(request.plan, request.choices, FixedExplorer(known.looks))
    for reason in known.missing:
        state.note(reason)
    seen = [one for look in known.looks for one in look.sightings]
    person = min(seen, key=lambda one: (abs(one.frame - state.t0), one.frame), default=None)
    answer = find_answer(state, person) if known.counted is None else {"value": str(known.counted)}
    there = [found for one in seen if (found := shown_there(one, request.looks)) is not None]
    whole = sorted(there, key=lambda found: (not found[1].whole, abs(found[1].frame - state.t0)))
    boxes = [_box(look, one) for look, one in whole[:1]]
    return StageReply({"answer": answer, "evidence_bboxes": boxes}, state.missing)


def _write_facts(request: Request) -> StageReply:
    """What the panoramas show of the question's person."""
    return StageReply({"reasoning": write_facts(*_found(request))})


def _propose(request: Request) -> StageReply:
    """The person's box in one of the panoramas."""
    state, person = _found(request)
    return _box_reply(state.explorer.looks, person, state)


def _refine(request: Request) -> StageReply:
    """The person's box in the crop, which is centred on the proposed box.

    That is the person who fits best there or, where the description decides no more, the one nearest to the middle.
    """
    crop = next((look for look in request.looks if not look.panorama), None)
    if crop is None:
        raise DecodeError("the prompt shows no crop")
    state = EpisodeState(request.plan, request.choices, FixedExplorer((crop,)))
    people = sorted(crop.sightings, key=lambda seen: abs(seen.box.x + seen.box.w / 2 - crop.size[0] / 2))
    person = people[0] if people else None
    if not request.plan.edges:
        person = likely(request.plan.nodes[0].conditions, people, exact=crop.frame == state.t0) or person
    if person is None:
        state.note("mark unreadable: nobody in the crop")
    return _box_reply((crop,), person, state)


def _choose(request: Request) -> StageReply:
    """The answer, read of the person in the refined box."""
    state = EpisodeState(request.plan, request.choices, FixedExplorer(request.looks))
    box = _refined(request)
    overlaps = [
        (iou(box, seen.box if look.panorama else from_crop(seen.box, look.left)), look.panorama, seen)
        for look in request.looks
        for seen in look.sightings
    ]
    overlap, _, person = max(overlaps, key=lambda found: found[:2], default=(0.0, False, None))
    if overlap <= 0:
        person = None
        state.note("mark unreadable: nobody in the refined box")
    state.note_unseen()
    return StageReply({"answer": find_answer(state, person)}, state.missing)


def _list_people(request: Request) -> StageReply:
    """The people of the newest picture, the nearest first, with the fields of the prompt."""
    if not request.looks:
        raise DecodeError("the prompt shows no picture")
    look = request.looks[-1]
    people = sorted(look.sightings, key=lambda seen: -seen.box.h)[: fields.NEAREST]
    names = fields.read_fields(request.question)
    boxes = [write_box(look.box_inside(seen), look.size) for seen in people]
    listed = [
        {"box": box, **{name: fields.said(name, seen, people) for name in names}}
        for box, seen in zip(boxes, people, strict=True)
    ]
    return StageReply({"people": listed})


def _recognize(request: Request) -> StageReply:
    """Who of the numbered people of the second picture is the person of the first one."""
    if len(request.looks) != _TWO:
        raise DecodeError("the prompt shows no two pictures")
    try:
        box = msgspec.json.decode(request.line("Person in picture 1: ") or "", type=fields.Corners)
        boxes = msgspec.json.decode(request.line("People in picture 2: ") or "", type=dict[int, fields.Corners])
    except msgspec.DecodeError:
        raise DecodeError("the prompt lacks the boxes of two pictures") from None
    first, second = request.looks
    known = _in_box(first, box)
    people = {number: _in_box(second, one) for number, one in boxes.items()}
    if known is None:
        return StageReply({"person": None})
    same = (number for number, one in people.items() if one is not None and one.identity == known.identity)
    return StageReply({"person": next(same, 0)})


def _pick_look(request: Request) -> StageReply:
    """The first of the proposed looks."""
    return StageReply({"look": 1})


STAGES: Final[dict[str, Play]] = {
    "Your answer, as one JSON object:": _answer_at_once,
    "Your facts, as one JSON object:": _write_facts,
    "Where the person is, as one JSON object:": _propose,
    "The person's box in the crop, as one JSON object:": _refine,
    "Your choice of answer, as one JSON object:": _choose,
    "Your next turn, as one JSON object:": _react,
    "Your plan, as one JSON object:": _plan,
    fields.STAGE: _list_people,
    fields.SAME_STAGE: _recognize,
    "Your choice of look, as one JSON object:": _pick_look,
    "Your next calls, as one JSON object:": agent_turn,
}
"""Every stage by the last line of its prompt."""


# -- parts ------------------------------------------------------------------------------------------------------------


_TWO: Final = 2


def _in_box(look: Look, corners: fields.Corners) -> Sighting | None:
    """Whoever a box in thousandths of a picture is drawn round."""
    overlaps = [(iou(_rectangle(corners), _rectangle(write_box(seen.box, look.size))), seen) for seen in look.sightings]
    overlap, seen = max(overlaps, key=lambda found: found[0], default=(0.0, None))
    return seen if overlap > 0 else None


def _rectangle(corners: Sequence[int]) -> Box:
    left, top, right, bottom = corners
    return Box(left, top, right - left, bottom - top)


def _found(request: Request) -> tuple[EpisodeState, Sighting | None]:
    state = EpisodeState(request.plan, request.choices, FixedExplorer(request.looks))
    person = find_target(state)
    state.note_unseen()
    return state, person


def _box_reply(looks: Sequence[Look], person: Sighting | None, state: EpisodeState) -> StageReply:
    boxes = _best_box(looks, person)
    return StageReply({"evidence_bboxes": boxes}, None if boxes else state.missing)


def _best_box(looks: Sequence[Look], person: Sighting | None) -> list[dict[str, Any]]:
    """The person's box where recognized or, where a picture's edge cuts it there, in a picture nearby."""
    if person is None:
        return []
    found = [(look, seen) for look in looks if (seen := look.of(person.identity)) is not None]
    return [_box(*min(found, key=lambda one: (not one[1].whole, abs(one[1].frame - person.frame))))]


def _box(look: Look, seen: Sighting) -> dict[str, Any]:
    return {"frame_id": f"{seen.frame:06d}", "bbox": write_box(look.box_inside(seen), look.size)}


def _refined(request: Request) -> Box:
    """The box of the line `Refined box, ...`, in stitched pixels. Raises DecodeError where there is none."""
    text = request.line("Refined box, stitched pixels: ") or ""
    try:
        return Box(*msgspec.json.decode(text, type=tuple[float, float, float, float]))
    except msgspec.DecodeError:
        raise DecodeError("the prompt has no refined box of four numbers") from None
