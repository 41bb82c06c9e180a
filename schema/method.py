"""The public interface of a method: the task it receives and the prediction it returns.

A method answers one `Task` at a time. A task holds the public columns of a question, the frames that can be observed,
the functions `observe` and `panorama` that return images, and the functions `record` and `record_write` that append to
the transcript and to the record of a world model. A task holds nothing else of the store.

A method runs in the process of the run, with the rights of its user: it could open the files of the store.
A public store (`export --public`) has no answers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from jrdb_avr.schema.answers import Answer, AnswerMode, Evidence
from jrdb_avr.schema.beliefs import Write

Image = npt.NDArray[np.uint8]

StepKind = Literal["model", "observe", "tool", "solve"]
Status = Literal["answered", "invalid", "error"]
Verdict = Literal["certain", "supported", "guess"]
"""Support of a world model for an answer. certain: it proves the answer. supported: it gives the answer for the person
who fits best or for the nearest observed frames. guess: neither."""


@dataclass(frozen=True, slots=True)
class Question:
    """A question as a method sees it."""

    question_id: str
    sequence: str
    question: str
    choices: tuple[str, ...]
    answer_mode: AnswerMode


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """A row of `sequences.parquet`.

    Attributes:
        sequence: Name of the sequence, opaque if the run hides names.
        fps: Frames per second.
        frame_count: Number of frames of the sequence.
        frames: Frames that can be observed, ascending.
    """

    sequence: str
    fps: float
    frame_count: int
    frames: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Observation:
    """A crop of the stitched panorama with its frame and angle.

    Attributes:
        sequence: Name of the sequence.
        frame_index: Number of the frame.
        frame_id: Number of the frame as six digits.
        timestamp: Seconds from frame 0.
        angle_deg: Panorama angle of the crop's centre, degrees.
        fov_deg: Horizontal field of view, degrees.
        left: Left column in stitched pixels, [0, 3760). The crop wraps over the seam.
        image: 480 x 480 x 3, uint8, RGB.
    """

    sequence: str
    frame_index: int
    frame_id: str
    timestamp: float
    angle_deg: float
    fov_deg: float
    left: int
    image: Image = field(repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Panorama:
    """A whole stitched panorama, 3760 x 480.

    Attributes:
        sequence: Name of the sequence.
        frame_index: Number of the frame.
        frame_id: Number of the frame as six digits.
        timestamp: Seconds from frame 0.
        jpeg: Stored JPEG bytes.
    """

    sequence: str
    frame_index: int
    frame_id: str
    timestamp: float
    jpeg: bytes = field(repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Step:
    """One line of a transcript. It names images by sequence, frame and angle, without their bytes."""

    kind: StepKind
    request: str
    response: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """A method's answer to one question, with its evidence and costs.

    Attributes:
        status: "invalid" if answer or evidence is missing because the model's output could not be read.
        answer: The answer, or None. It is scored apart from the evidence.
        evidence: The box of the evidence in stitched pixels, or None.
        raw: Last text of the model.
        reason: Last refusal of the model's output, "" if its last proposal was accepted.
        verdict: Support of the world model; None for a method without one.
        n_observations: Number of crops and panoramas.
        n_model_calls: Number of model calls.
        prompt_tokens: Tokens sent to the model.
        completion_tokens: Tokens written by the model.
    """

    status: Status
    answer: Answer | None = None
    evidence: Evidence | None = None
    raw: str = ""
    reason: str = ""
    verdict: Verdict | None = None
    n_observations: int = 0
    n_model_calls: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0


class Observe(Protocol):
    """The function that returns one crop of a panorama."""

    def __call__(self, sequence: str, frame_index: int, angle_deg: float) -> Observation:
        """Return the crop of a frame, centred at a panorama angle in degrees.

        Raises:
            ObserveError: the request is not allowed.
        """


class GetPanorama(Protocol):
    """The function that returns a whole panorama."""

    def __call__(self, sequence: str, frame_index: int) -> Panorama:
        """Return the panorama of a frame.

        Raises:
            ObserveError: the request is not allowed.
        """


class Record(Protocol):
    """The function that writes the transcript."""

    def __call__(self, step: Step) -> None:
        """Append a step to the transcript of the current question."""


class RecordWrite(Protocol):
    """The function that writes the record of a world model."""

    def __call__(self, write: Write) -> None:
        """Append a write, accepted or refused, to the record of the current question."""


@dataclass(frozen=True, slots=True)
class Task:
    """One question with all data and functions that a method may use to answer it.

    Attributes:
        question: The public columns of the question.
        sequence: The sequence and its frames.
        observe: Returns a crop.
        panorama: Returns a whole panorama.
        record: Appends a step to the transcript.
        record_write: Appends a write to the record of the world model.
    """

    question: Question
    sequence: SequenceInfo
    observe: Observe
    panorama: GetPanorama
    record: Record
    record_write: RecordWrite


class Method(Protocol):
    """A method of a run. Several threads call `answer` at the same time."""

    @property
    def name(self) -> str:
        """Name of the method in the run's manifest."""

    def answer(self, task: Task) -> Prediction:
        """Answer one question. An exception becomes an `error` prediction and does not end the run."""


class ConfigurableMethod(Method, Protocol):
    """A method with settings. The run's manifest stores them, and a run resumes only under equal settings."""

    def settings(self) -> dict[str, Any]:
        """Return the settings as JSON values by name."""
