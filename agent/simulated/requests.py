"""Parse a request: its stage, the question, the legal frames, and the people in its pictures.

The last line of the newest user message names the stage. A picture says by its reference which frame and angle it
shows. Requests of other programs have no references. For them, the text before a picture names its frame and angle, and
the question's text names the sequence.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Final

import msgspec

from jrdb_avr.agent.model.decode import write_box
from jrdb_avr.agent.model.prompts import read_frame_ranges
from jrdb_avr.agent.perceive.geometry import SeenColumns
from jrdb_avr.agent.simulated.noise import ReadPerson, View
from jrdb_avr.schema.errors import DecodeError, PlanError
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box, crop_left
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.wording.text import parse

_ANNOUNCED: Final = re.compile(r"(?:Picture|Panorama|Crop)(?: \d+)?(?:, observation (\w{1,32}))?: (\{.*\})")
_CHOICE: Final = re.compile(r"\d+\. (.+)")

FrameId = Annotated[str, msgspec.Meta(pattern="^[0-9]{6}$")]


@dataclass(frozen=True)
class Look:
    """A picture of a request.

    Attributes:
        name: Name of the observation, "" if the prompt gives none.
        view: Frame and columns that the picture shows.
        people: People who were read, from left to right.
    """

    name: str
    view: View
    people: tuple[ReadPerson, ...]

    @property
    def frame(self) -> int:
        """Index of the frame."""
        return self.view.frame

    @property
    def panorama(self) -> bool:
        """Whether the picture is a whole panorama."""
        return self.view.width == WIDTH

    @property
    def columns(self) -> SeenColumns:
        """Columns that the picture shows."""
        return SeenColumns(self.view.left, self.view.width)


def box_in(look: Look, person: ReadPerson) -> list[int]:
    """Return a person's box as a reply writes it: left, top, right, bottom in thousandths of the picture."""
    return write_box(person.box, look.view.size)


@dataclass(frozen=True)
class Request:
    """A parsed request.

    Attributes:
        stage: Last line of the newest user message.
        lines: All lines of the newest user message.
        question: Text of the question.
        plan: Plan that the question's words mean.
        choices: Texts of the choices, empty for other answer modes.
        frames: Legal frames, empty if the method does not choose frames.
        looks: Pictures of all user messages, in order.
    """

    stage: str
    lines: tuple[str, ...]
    question: str
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

    def left(self, start: str) -> int:
        """Return the rest of a budget, by the line that begins with a text. Raise DecodeError if it is missing."""
        found = re.match(r"\d+, left: (\d{1,9})$", self.line(start) or "")
        if not found:
            raise DecodeError(f"the prompt lacks a line {start!r} with a count")
        return int(found[1])


Reply = Mapping[str, Any]
"""Reply to a stage."""

Play = Callable[[Request], Reply]
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

See = Callable[[View], tuple[ReadPerson, ...]]
"""Reader of a picture: returns the people who are read."""


def read_request(
    turns: Sequence[UserMessage], stages: Collection[str], see: See, sequences: Mapping[str, str]
) -> Request | None:
    """Parse the user messages of a request.

    Args:
        turns: User messages. The question and its choices may be in an earlier one than the last.
        stages: Last lines of the stages that the model plays.
        see: Reader of a picture.
        sequences: Sequence of each question by its text, for pictures without references. Empty if each needs one.

    Returns:
        The request, or None if the last line names none of the stages.

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
    return Request(lines[-1], lines, question, plan, _choices(heading), frames, looks)


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
    return tuple(found[1] for found in numbered if found)


# -- its pictures -----------------------------------------------------------------------------------------------------


class _Metadata(msgspec.Struct):
    """JSON object before a picture. Without an angle, the picture is a whole panorama."""

    frame_id: FrameId
    angle_deg: float | None = None


_METADATA: Final = msgspec.json.Decoder(_Metadata)


def _looks(parts: UserMessage, see: See, sequence: str | None) -> Iterator[Look]:
    """Yield the pictures of a message. A picture that is no longer sent shows nobody."""
    announced: tuple[str, _Metadata] | None = None
    for part in parts:
        for line in filter(None, map(_ANNOUNCED.fullmatch, part.text.split("\n"))):
            if announced is not None:
                yield Look(announced[0], _view("", int(announced[1].frame_id), announced[1].angle_deg), ())
            try:
                announced = line[1] or "", _METADATA.decode(line[2])
            except msgspec.DecodeError as error:
                raise DecodeError(f"a picture's line cannot be read: {error}") from None
        if part.image_url is not None:
            view = _shown(part.jrdb_avr, announced, sequence)
            yield Look("" if announced is None else announced[0], view, see(view))
            announced = None
    if announced is not None:
        yield Look(announced[0], _view("", int(announced[1].frame_id), announced[1].angle_deg), ())


def _shown(reference: Reference | None, announced: tuple[str, _Metadata] | None, sequence: str | None) -> View:
    if reference is not None:
        return view_of(reference)
    if announced is None or sequence is None:
        raise DecodeError("a picture has no reference: declare the run simulated (--simulated)")
    return _view(sequence, int(announced[1].frame_id), announced[1].angle_deg)


def view_of(reference: Reference) -> View:
    """Return the part of a panorama that a picture shows."""
    return _view(reference.sequence, reference.frame, reference.angle)


def _view(sequence: str, frame: int, angle: float | None) -> View:
    return View(sequence, frame, 0.0, WIDTH) if angle is None else View(sequence, frame, crop_left(angle), CROP)


def stitched_box(view: View, box: Box) -> Box:
    """Return a box of a picture in stitched pixels."""
    return box._replace(x=box.x + view.left)
