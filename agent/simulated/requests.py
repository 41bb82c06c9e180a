"""Parse a request: its stage, the question, the legal frames, and the marks in its pictures.

The last line of the newest user message names the stage. This module reads what all stages have in common; a stage
reads lines of its own from `Request.lines`.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final, NamedTuple

import msgspec

from jrdb_avr.agent.model.prompts import read_frame_ranges
from jrdb_avr.agent.policy.explorer import Look, Sighting
from jrdb_avr.agent.simulated import fields
from jrdb_avr.agent.simulated.perception import Perception, PictureMarks, Reader, See
from jrdb_avr.agent.simulated.same_person import told_apart
from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.markers import Reading
from jrdb_avr.schema.panorama import CROP, WIDTH, angle_of_column
from jrdb_avr.schema.plan import AnswerSpec, Condition, Plan
from jrdb_avr.schema.wording.text import parse

_ANNOUNCED: Final = re.compile(r"(?:Picture|Panorama|Crop)(?: \d+)?(?:, observation (\w{1,32}))?: (\{.*\})")
_CHOICE: Final = re.compile(r"\d+\. (.+)")
AHEAD: Final = 180.0
"""Panorama angle of a whole panorama's middle column."""

NO_PLAN: Final = Plan("a", "a", {}, (), (), AnswerSpec("multiple_choice", "action", "a", ()))
"""The plan of a request that holds no question."""

FrameId = Annotated[str, msgspec.Meta(pattern="^[0-9]{6}$")]


@dataclass(frozen=True)
class Request:
    """A parsed request.

    `stage` is the last line of the newest user message and `lines` are all of them; `frames` are the legal ones (none
    where the method does not choose); `looks` are the pictures of all user messages, in order. `ids`: whether a person
    has the same identity in all of them; without, `looks` hold whom the model takes for the same.
    """

    stage: str
    lines: tuple[str, ...]
    question: str
    plan: Plan
    choices: tuple[str, ...]
    frames: tuple[int, ...]
    looks: tuple[Look, ...]
    ids: bool = True

    def line(self, start: str) -> str | None:
        """The rest of the first line that begins so, in the newest user message."""
        return _line(self.lines, start)

    def legal(self) -> tuple[int, ...]:
        """The legal frames. Raises DecodeError where the prompt names none."""
        if not self.frames:
            raise DecodeError("the prompt names no legal frame")
        return self.frames

    def left(self, start: str) -> int:
        """How many of a budget are left, by the line that begins so. Raises DecodeError where there is none."""
        found = re.match(r"\d+, left: (\d{1,9})$", self.line(start) or "")
        if not found:
            raise DecodeError(f"the prompt lacks a line {start!r} with a count")
        return int(found[1])


# -- the request ------------------------------------------------------------------------------------------------------


class Url(msgspec.Struct):
    """Where a picture is."""

    url: str


class MessagePart(msgspec.Struct):
    """A part of a message: text, or a picture."""

    text: str = ""
    image_url: Url | None = None


UserMessage = list[MessagePart]
"""The parts of a user message."""


def read_request(turns: Sequence[UserMessage], reader: Reader, stages: Collection[str], see: See) -> Request | None:
    """Parse the user messages of a request; None where their last line names none of the stages.

    The question and its choices may stand in an earlier user message, as in a chat. Raises DecodeError for a
    question or a picture that cannot be read.
    """
    lines = lines_of(turns[-1]) if turns else ()
    stage = lines[-1] if lines else ""
    if stage not in stages:
        return None
    texts = (lines, *map(lines_of, turns))
    heading = next((text for text in texts if _line(text, "Question: ") is not None), ())
    question, plan, statements = _asked(lines, heading, stage)
    legal = _line(heading, "Legal frames: ")
    frames = () if legal is None else tuple(read_frame_ranges(legal))
    perception = see(question, statements)
    looks = tuple(
        look
        for turn, parts in enumerate(turns, 1)
        for look in _looks(parts, reader, perception, turns_ago=len(turns) - turn)
    )
    if all(part.image_url is None for parts in turns for part in parts):
        looks = ()
    ids = perception.knobs.ids
    return Request(stage, lines, question, plan, _choices(heading), frames, looks if ids else told_apart(looks), ids)


def _asked(lines: Sequence[str], heading: Sequence[str], stage: str) -> tuple[str, Plan, Sequence[Condition]]:
    """The question with its plan, and what the prompt states about people. Raises DecodeError.

    Perception is asked fields in place of a question: draws are about them, as they stay the same for all its pictures.
    """
    if stage == fields.STAGE:
        asked = _line(lines, fields.START) or ""
        stated = map(fields.statement, fields.read_fields(asked))
        return asked, NO_PLAN, [one for one in stated if one is not None]
    if stage == fields.SAME_STAGE:
        return "", NO_PLAN, ()
    question = _line(heading, "Question: ")
    if question is None:
        raise DecodeError("the prompt has no line 'Question: ...'")
    try:
        _, plan = parse(question)
    except PlanError as error:
        raise DecodeError(f"the simulated model does not know this question: {error}") from None
    return question, plan, [condition for node in plan.nodes for condition in node.conditions]


def lines_of(parts: UserMessage) -> tuple[str, ...]:
    """The lines of a message's text that are not blank."""
    return tuple(line for part in parts for line in part.text.split("\n") if line.strip())


def _line(lines: Sequence[str], start: str) -> str | None:
    return next((line.removeprefix(start) for line in lines if line.startswith(start)), None)


def _choices(lines: Sequence[str]) -> tuple[str, ...]:
    """The numbered lines that follow the line `Choices:`."""
    after = lines[lines.index("Choices:") + 1 :] if "Choices:" in lines else ()
    numbered = itertools.takewhile(bool, map(_CHOICE.fullmatch, after))
    return tuple(found[1] for found in numbered if found)


# -- its pictures -----------------------------------------------------------------------------------------------------


class _Metadata(msgspec.Struct):
    """The JSON object before a picture; without an angle the picture is a whole panorama."""

    frame_id: FrameId
    angle_deg: float | None = None
    left: int = 0


_NO_LONGER_SENT: Final = PictureMarks(b"", (CROP, CROP), ())

# Made at import: threads that meet a type first at the same time crash the decoder.
_METADATA: Final = msgspec.json.Decoder(_Metadata)


def _looks(parts: UserMessage, reader: Reader, perception: Perception, turns_ago: int) -> list[Look]:
    pictures = [*_pictures(parts, reader)]
    # Of several turns in one message, which names the newest picture, each made one.
    turns = len(pictures) if _line(lines_of(parts), "Newest picture: ") else 0
    return [
        _look(
            place,
            name,
            picture,
            perception.readings(picture, turns_ago + max(turns - number, 0)) if picture is not _NO_LONGER_SENT else (),
        )
        for number, (place, name, picture) in enumerate(pictures, 1)
    ]


def _pictures(parts: UserMessage, reader: Reader) -> Iterator[tuple[_Metadata, str, PictureMarks]]:
    """The pictures of a message that a line places, with their names; one that is sent no more shows nobody."""
    place: _Metadata | None = None
    name = ""
    for part in parts:
        # A message without pictures is one text.
        for announced in filter(None, map(_ANNOUNCED.fullmatch, part.text.split("\n"))):
            if place is not None:
                yield place, name, _NO_LONGER_SENT
            try:
                place = _METADATA.decode(announced[2])
            except msgspec.DecodeError as error:
                raise DecodeError(f"a picture's line cannot be read: {error}") from None
            name = announced[1] or ""
        if part.image_url is not None and place is not None:
            yield place, name, reader.picture(part.image_url.url, wrap=place.angle_deg is None)
            place = None
    if place is not None:
        yield place, name, _NO_LONGER_SENT


def _look(place: _Metadata, name: str, picture: PictureMarks, readings: Sequence[Reading]) -> Look:
    frame, panorama = int(place.frame_id), place.angle_deg is None
    # A panorama may be sent smaller than it is, a crop is as large as it was cut.
    scale = WIDTH / picture.size[0] if panorama else 1.0
    sightings = tuple(
        Sighting(frame, mark, box, complete, angle_of_column(place.left + (box.x + box.w / 2) * scale), picture.size[0])
        for mark, box, complete in readings
    )
    angle = AHEAD if place.angle_deg is None else place.angle_deg
    return Look(frame, angle, sightings, panorama, name, place.left, picture.size)


class StageReply(NamedTuple):
    """The reply to one stage; `missing` lists what was missing where it ends the question, else it is None."""

    reply: Mapping[str, Any]
    missing: list[str] | None = None


Play = Callable[[Request], StageReply]
"""Plays one stage: a pure function of the request. Raises DecodeError for a request that lacks a line."""
