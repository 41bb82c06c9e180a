"""The public interface of a method: the task it receives and the prediction it returns.

A method answers one `Task` at a time. A task holds the public columns of a question, the frames that can be observed,
the functions `observe` and `panorama` that return images, and the functions `record` and `record_write` that append to
the transcript and to the record of a world model. A task holds nothing else of the store.

A method is code in the process of the run, with the rights of its user: it could open the files of the store by itself.
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
"""How far a world model bears an answer out: it proves it; it gives it for the person who fits best, at the nearest
frames that were seen; or it does not give it."""


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
    """A row of `sequences.parquet`; `frames` are the frames that can be observed, ascending."""

    sequence: str
    fps: float
    frame_count: int
    frames: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Observation:
    """A 480 x 480 x 3 uint8 RGB crop of the stitched panorama, with its frame and angle.

    `left` is the crop's left column in stitched pixels, [0, 3760); the crop wraps over the seam. `timestamp` is in
    seconds from frame 0.
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
    """A whole stitched panorama as its stored JPEG bytes, 3760 x 480; `timestamp` is in seconds from frame 0."""

    sequence: str
    frame_index: int
    frame_id: str
    timestamp: float
    jpeg: bytes = field(repr=False, compare=False)


@dataclass(frozen=True, slots=True)
class Step:
    """One line of a transcript; it names images by sequence, frame and angle and leaves out their bytes."""

    kind: StepKind
    request: str
    response: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """A method's answer to one question, with its evidence and costs.

    `n_observations` counts crops and panoramas. `answer` and `evidence` are scored separately and either may be
    missing. `status` is "invalid" where one is missing because the model's output could not be read. `reason` is the
    last refusal of the model's output, "" where what it proposed last was taken. `raw` is the model's last text.
    `verdict` is None for a method without a world model.
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
    """Returns the crop at a frame and angle; raises ObserveError for a request that is not allowed."""

    def __call__(self, sequence: str, frame_index: int, angle_deg: float) -> Observation: ...


class GetPanorama(Protocol):
    """Returns a whole panorama; raises ObserveError for a request that is not allowed."""

    def __call__(self, sequence: str, frame_index: int) -> Panorama: ...


class Record(Protocol):
    """Appends a step to the transcript of the current question."""

    def __call__(self, step: Step) -> None: ...


class RecordWrite(Protocol):
    """Appends a write, accepted or refused, to the world model's record of the current question."""

    def __call__(self, write: Write) -> None: ...


@dataclass(frozen=True, slots=True)
class Task:
    """One question with everything that a method may use to answer it."""

    question: Question
    sequence: SequenceInfo
    observe: Observe
    panorama: GetPanorama
    record: Record
    record_write: RecordWrite


class Method(Protocol):
    """Answers questions. `answer` is called concurrently from several threads."""

    @property
    def name(self) -> str: ...

    def answer(self, task: Task) -> Prediction:
        """Answer one question. An exception becomes an `error` prediction; it never ends the run."""
        ...


class ConfigurableMethod(Method, Protocol):
    """A method whose settings the run's manifest stores: a run resumes only under equal settings."""

    def settings(self) -> dict[str, Any]: ...
