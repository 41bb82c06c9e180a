"""The public interface of a method: the task it receives and the prediction it returns.

A method answers one question for each `Task` that it receives. A task has the public columns of the question and the
frames that can be observed. It also has four functions: `observe` and `panorama` return images, `record` appends a line
to the transcript, and `record_write` appends a write to the record of a world model. A task gives no other access to
the store.

A method runs in the process of the run, with the rights of the user. So it could open the private files of a store. If
you do not trust a method, run it on a public store. `export --public` writes such a store, which has no answers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, Literal, Protocol

import numpy as np
import numpy.typing as npt

from jrdb_avr.schema.answers import Answer, AnswerMode, Evidence
from jrdb_avr.schema.beliefs import Write

Image = npt.NDArray[np.uint8]

StepKind = Literal["model", "observe", "tool", "solve"]
Status = Literal["answered", "invalid", "error"]
Verdict = Literal["certain", "supported", "guess"]
"""Support of a method's world model for the answer.

certain: the world model proves the answer. supported: the answer was read from the person who fits the question best,
or from the nearest frames that the method observed. guess: every other answer.
"""


DIAGNOSTIC: Final = ("random-looks", "given-looks", "given-target")
"""Diagnostic methods. They measure the cost of searching and seeing, and need answers. They are not ranked."""


@dataclass(frozen=True, slots=True)
class Question:
    """Question as a method sees it.

    Attributes:
        question_id: Id of the question.
        sequence: Name of the sequence. If the run hides names, an opaque text replaces the name.
        question: Text of the question.
        choices: Texts of the four choices, empty if the answer is not a choice. Answers count the choices from 1.
        answer_mode: Name of the answer mode, which decides the form of the answer.
    """

    question_id: str
    sequence: str
    question: str
    choices: tuple[str, ...]
    answer_mode: AnswerMode


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """Sequence that a question is about, with the frames that can be observed.

    Attributes:
        sequence: Name of the sequence. If the run hides names, an opaque text replaces the name.
        fps: Frames per second.
        frame_count: Number of frames of the sequence.
        frames: Indexes of the frames that can be observed, in ascending order.
    """

    sequence: str
    fps: float
    frame_count: int
    frames: tuple[int, ...] = field(repr=False)


@dataclass(frozen=True, slots=True)
class Observation:
    """Crop of a stitched panorama, with its frame and angle.

    Attributes:
        sequence: Name of the sequence.
        frame_index: Index of the frame, from 0.
        timestamp: Time of the frame in seconds after frame 0.
        angle_deg: Panorama angle of the centre of the crop, in degrees.
        fov_deg: Horizontal field of view, in degrees.
        left: Left column of the crop in stitched pixels, [0, 3760). Columns after 3759 continue at column 0.
        image: Pixels as an array of 480 x 480 x 3, uint8, RGB.
    """

    sequence: str
    frame_index: int
    timestamp: float
    angle_deg: float
    fov_deg: float
    left: int
    image: Image = field(repr=False, compare=False)

    def _repr_png_(self) -> bytes:
        """Return the image as a PNG file, which a notebook displays."""
        import cv2

        return bytes(cv2.imencode(".png", self.image[..., ::-1])[1])


@dataclass(frozen=True, slots=True)
class Panorama:
    """Whole stitched panorama of 3760 x 480 pixels.

    Attributes:
        sequence: Name of the sequence.
        frame_index: Index of the frame, from 0.
        timestamp: Time of the frame in seconds after frame 0.
        jpeg: Bytes of the JPEG file.
    """

    sequence: str
    frame_index: int
    timestamp: float
    jpeg: bytes = field(repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Step:
    """Line of a question's transcript.

    Attributes:
        kind: "model" for a model call, "observe" for a look, "tool" for another tool call, or "solve" for a conclusion
            that the code of the method drew.
        request: What was asked for. Images are named by sequence, frame and angle, and their bytes are left out.
        response: What was returned, without the bytes of images.
        seconds: Duration in seconds.
    """

    kind: StepKind
    request: str
    response: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """A method's answer to one question, with its evidence and costs.

    Attributes:
        status: "answered"; "invalid" if the answer or the evidence is missing because the model's output could not be
            read; or "error" if the method raised an exception.
        answer: Answer, or None if there is no answer. The answer and the evidence are scored separately.
        evidence: Box around the person in one frame, in stitched pixels, or None if there is no box.
        raw: Last text that the model wrote.
        reason: Why the model's last output was refused, "" if it was accepted.
        verdict: How well the world model supports the answer, or None if the method has no world model.
        proposed: Stored JSON of the answer that the model proposed last, or None if it proposed none or if the method
            has no world model. The answer differs if the world model does not support the proposed answer.
        n_observations: Number of crops and panoramas that the method looked at.
        n_model_calls: Number of model calls.
        prompt_tokens: Number of tokens sent to the model.
        completion_tokens: Number of tokens that the model wrote.
    """

    status: Status
    answer: Answer | None = None
    evidence: Evidence | None = None
    raw: str = ""
    reason: str = ""
    verdict: Verdict | None = None
    proposed: str | None = None
    n_observations: int = 0
    n_model_calls: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0


class Observe(Protocol):
    """Function of a task that returns one crop of a panorama. Each call counts as a look."""

    def __call__(self, sequence: str, frame_index: int, angle_deg: float) -> Observation:
        """Return a crop of a frame's panorama.

        Args:
            sequence: Name of the sequence of the task.
            frame_index: Index of a frame that can be observed.
            angle_deg: Panorama angle of the centre of the crop, in degrees.

        Returns:
            The crop.

        Raises:
            ObserveError: If the sequence or the frame cannot be observed, or the angle is not a finite number.
        """


class GetPanorama(Protocol):
    """Function of a task that returns a whole panorama. Each call counts as a look."""

    def __call__(self, sequence: str, frame_index: int) -> Panorama:
        """Return the panorama of a frame.

        Args:
            sequence: Name of the sequence of the task.
            frame_index: Index of a frame that can be observed.

        Returns:
            The panorama.

        Raises:
            ObserveError: If the sequence or the frame cannot be observed.
        """


class Record(Protocol):
    """Function of a task that appends a line to the transcript of its question."""

    def __call__(self, step: Step) -> None:
        """Append a line to the transcript.

        Args:
            step: Line to append, such as a model call with its prompt and reply.
        """


class RecordWrite(Protocol):
    """Function of a task that appends a write to the record of the method's world model."""

    def __call__(self, write: Write) -> None:
        """Append a write to the record. Methods without a world model do not call this function.

        Args:
            write: Write that the world model accepted or refused.
        """


@dataclass(frozen=True, slots=True)
class Task:
    """Question with all data and functions that a method may use to answer the question.

    Attributes:
        question: Public columns of the question.
        sequence: Sequence of the question, with the frames that can be observed.
        observe: Function that returns a crop of a panorama.
        panorama: Function that returns a whole panorama.
        record: Function that appends a line to the transcript.
        record_write: Function that appends a write to the record of a world model.
    """

    question: Question
    sequence: SequenceInfo
    observe: Observe
    panorama: GetPanorama
    record: Record
    record_write: RecordWrite


class Method(Protocol):
    """Method that answers the questions of a run. Several threads call `answer` at the same time."""

    @property
    def name(self) -> str:
        """Name of the method in the run's manifest and in reports."""

    def answer(self, task: Task) -> Prediction:
        """Answer one question.

        If this function raises an exception, the run records a prediction with the status "error" and continues.

        Args:
            task: Question with the functions to observe its sequence.

        Returns:
            The prediction.
        """


class ConfigurableMethod(Method, Protocol):
    """Method with settings, such as a budget of looks. A run can be resumed only if its settings are unchanged."""

    def settings(self) -> dict[str, Any]:
        """Return the settings that may change the method's answers.

        This function is called when a run starts. The run's manifest stores the settings. A resumed run is refused if
        its settings differ from the stored settings.

        Returns:
            Values by the name of the setting. Every value can be written as JSON.
        """
