"""Parse a request: its stage, the question, the legal frames, and the people in its pictures.

The last line of the newest user message names the stage. A picture says by its reference which frame and angle it
shows. Requests of other programs have no references. For them, the text before a picture names its frame and angle, and
the question's text names the sequence.
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

import msgspec

from jrdb_avr.agent.model.prompts import read_frame_ranges
from jrdb_avr.agent.simulated.noise import PictureView, ReadPerson
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, crop_left
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.wording.text import parse

_ANNOUNCED: Final = re.compile(r"(?:Picture|Panorama|Crop)(?: \d+)?(?:, observation (\w{1,32}))?: (\{.*\})")
_CHOICE: Final = re.compile(r"\d+\. (.+)")


@dataclass(frozen=True)
class Look:
    """A picture of a request.

    Attributes:
        name: Name of the observation, "" if the prompt gives none.
        view: Frame and columns that the picture shows.
        people: People who were read, from left to right.
    """

    name: str
    view: PictureView
    people: tuple[ReadPerson, ...]

    @property
    def frame(self) -> int:
        """Index of the frame."""
        return self.view.frame

    @property
    def panorama(self) -> bool:
        """Whether the picture is a whole panorama."""
        return self.view.width == WIDTH


@dataclass(frozen=True)
class Request:
    """A parsed request.

    Attributes:
        stage: Last line of the newest user message.
        lines: All lines of the newest user message.
        plan: Plan that the question's words mean.
        choices: Texts of the choices, empty for other answer modes.
        frames: Legal frames, empty if the method does not choose frames.
        looks: Pictures of all user messages, in order.
    """

    stage: str
    lines: tuple[str, ...]
    plan: Plan
    choices: tuple[str, ...]
    frames: tuple[int, ...]
    looks: tuple[Look, ...]

    def line(self, start: str) -> str | None:
        """Return the rest of the first line that begins with a text, in the newest user message."""
        return find_line(self.lines, start)

    def legal(self) -> tuple[int, ...]:
        """Return the legal frames. Raise DecodeError if the prompt names none."""
        if not self.frames:
            raise DecodeError("the prompt names no legal frame")
        return self.frames

    def guess(self) -> Any:
        """Return an answer without evidence: the choice by a hash of the choices, or the first legal frames."""
        mode, frames = MODES[self.plan.answer.mode], self.frames or [look.frame for look in self.looks] or [0]
        if mode.is_choice:
            return 1 + hashlib.sha256("\n".join(self.choices).encode()).digest()[0] % max(len(self.choices), 1)
        return mode.written(mode.make((frames[0], frames[-1]), 180.0))

    def left(self, start: str) -> int:
        """Return the rest of a budget, by the line that begins with a text. Raise DecodeError if it is missing."""
        match = re.match(r"\d+, left: (\d{1,9})$", self.line(start) or "")
        if not match:
            raise DecodeError(f"the prompt lacks a line {start!r} with a count")
        return int(match[1])


PlayedReply = Mapping[str, Any]
"""Reply to a stage."""

Play = Callable[[Request], PlayedReply]
"""Player of one stage: a pure function of the request. It raises DecodeError if the request lacks a line."""


# -- the request ------------------------------------------------------------------------------------------------------


class Url(msgspec.Struct):
    """Address of a picture. Pictures are not decoded."""

    url: str


class Reference(msgspec.Struct):
    """What a picture of a simulated run shows: a crop, a panorama (without an angle), or a drawn rectangle."""

    sequence: str = ""
    frame: int = 0
    angle: float | None = None
    size: tuple[int, int] = (CROP, HEIGHT)
    rectangle: tuple[float, float, float, float] | None = None


class MessagePart(msgspec.Struct):
    """Part of a message: a text, or a picture with its reference."""

    text: str = ""
    image_url: Url | None = None
    jrdb_avr: Reference | None = None


UserMessage = list[MessagePart]
"""Parts of a user message."""

See = Callable[[PictureView], tuple[ReadPerson, ...]]
"""Reader of a picture: returns the people who are read."""


def read_request(
    turns: Sequence[UserMessage], stages: Collection[str], see: See, sequences: Mapping[str, str]
) -> Request | None:
    """Parse the user messages of a request.

    Args:
        turns: User messages, oldest first. Only the last one names the stage. Any of them may hold the question.
        stages: Last lines of the stages that the model plays.
        see: Function that returns the people in a picture.
        sequences: Names of sequences by the text of the question. If the text is missing, pictures need references.

    Returns:
        The request, or None if the last line of the last message is not in `stages`.

    Raises:
        DecodeError: If the question or a picture cannot be read.
    """
    lines = lines_of(turns[-1]) if turns else ()
    if not lines or lines[-1] not in stages:
        return None
    texts = (lines, *map(lines_of, turns))
    heading = next((text for text in texts if find_line(text, "Question: ") is not None), ())
    question = find_line(heading, "Question: ")
    if question is None:
        raise DecodeError("the prompt has no line 'Question: ...'")
    try:
        _, plan = parse(question)
    except PlanError as error:
        raise DecodeError(f"the simulated model does not know this question: {error}") from None
    legal = find_line(heading, "Legal frames: ")
    frames = () if legal is None else tuple(read_frame_ranges(legal))
    looks = tuple(look for parts in turns for look in _looks(parts, see, sequences.get(question)))
    return Request(lines[-1], lines, plan, _choices(heading), frames, looks)


def lines_of(parts: UserMessage) -> tuple[str, ...]:
    """Return the lines of a message's text that are not blank."""
    return tuple(line for part in parts for line in part.text.split("\n") if line.strip())


def find_line(lines: Sequence[str], start: str) -> str | None:
    """Return the rest of the first line that begins with a text, or None."""
    return next((line.removeprefix(start) for line in lines if line.startswith(start)), None)


def _choices(lines: Sequence[str]) -> tuple[str, ...]:
    """Return the numbered lines after the line `Choices:`."""
    after = lines[lines.index("Choices:") + 1 :] if "Choices:" in lines else ()
    numbered = itertools.takewhile(bool, map(_CHOICE.fullmatch, after))
    return tuple(match[1] for match in numbered if match)


# -- its pictures -----------------------------------------------------------------------------------------------------


class _Metadata(msgspec.Struct):
    """JSON object before a picture. Without an angle, the picture is a whole panorama."""

    frame_id: Annotated[str, msgspec.Meta(pattern="^[0-9]{6}$")]
    angle_deg: float | None = None


_METADATA: Final = msgspec.json.Decoder(_Metadata)


def _looks(parts: UserMessage, see: See, sequence: str | None) -> Iterator[Look]:
    """Yield the pictures of a message. A picture that is announced, but not sent any more, shows no person."""
    announced: list[tuple[str, _Metadata | None, MessagePart | None]] = []
    for part in parts:
        for line in filter(None, map(_ANNOUNCED.fullmatch, part.text.split("\n"))):
            try:
                announced.append((line[1] or "", _METADATA.decode(line[2]), None))
            except msgspec.DecodeError as error:
                raise DecodeError(f"a picture's line cannot be read: {error}") from None
        if part.image_url is not None:
            name, metadata, _ = announced.pop() if announced and announced[-1][2] is None else ("", None, None)
            announced.append((name, metadata, part))
    for name, metadata, picture in announced:
        if picture is not None and picture.jrdb_avr is not None:
            view = picture_view(picture.jrdb_avr)
        elif metadata is None or (picture is not None and sequence is None):
            raise DecodeError("a picture has no reference: declare the run simulated (--simulated)")
        else:
            view = picture_view(Reference(sequence or "", int(metadata.frame_id), metadata.angle_deg))
        yield Look(name, view, () if picture is None else see(view))


def picture_view(reference: Reference) -> PictureView:
    """Return the part of a panorama that a picture shows."""
    whole = reference.angle is None
    left, width = (0.0, WIDTH) if whole else (crop_left(reference.angle or 0.0), CROP)
    return PictureView(reference.sequence, reference.frame, left, width)
