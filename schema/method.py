"""What a method of the benchmark sees and returns: the public interface of method authors.

A method gets one `Task` at a time: the public columns of a question, the frames it may look at, the functions
`observe` and `panorama` to look with, and `record` and `keep` for its transcript and its world model's writes. It
returns a `Prediction`. Nothing else of the store is in its reach.
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


@dataclass(frozen=True, slots=True)
class Question:
    """A row of `questions.parquet`."""

    question_id: str
    sequence: str
    family: str
    template: str
    question: str
    choices: tuple[str, ...]
    answer_mode: AnswerMode


@dataclass(frozen=True, slots=True)
class SequenceInfo:
    """A row of `sequences.parquet`: `frames` are those that can be observed, ascending."""

    sequence: str
    fps: float
    frame_count: int
    frames: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Observation:
    """One look: a 480 x 480 x 3 uint8 RGB crop of the stitched panorama, and where it was taken.

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
    """One line of a transcript; images are named by sequence, frame and angle, their bytes are left out."""

    kind: StepKind
    request: str
    response: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a method says of one question.

    `n_observations` counts crops and panoramas. `answer` and `evidence` are judged apart, either may be missing;
    `status` is invalid when either is unreadable, and `reason` then says why. `raw` is the model's last text.
    """

    status: Status
    answer: Answer | None = None
    evidence: Evidence | None = None
    raw: str = ""
    reason: str = ""
    n_observations: int = 0
    n_model_calls: int = 0
    prompt_tokens: int = 0
    completion_tokens: int = 0


class Observe(Protocol):
    """`observe(sequence, frame_index, angle_deg)`; raises ObserveError for what is not allowed."""

    def __call__(self, sequence: str, frame_index: int, angle_deg: float) -> Observation: ...


class Show(Protocol):
    """`panorama(sequence, frame_index)`: a whole panorama; raises ObserveError for what is not allowed."""

    def __call__(self, sequence: str, frame_index: int) -> Panorama: ...


class Record(Protocol):
    """Appends a step to the transcript of the question at hand."""

    def __call__(self, step: Step) -> None: ...


class Keep(Protocol):
    """Appends a write, accepted or refused, to the record of the world model of the question at hand."""

    def __call__(self, write: Write) -> None: ...


@dataclass(frozen=True, slots=True)
class Task:
    """One question with everything a method may use to answer it."""

    question: Question
    sequence: SequenceInfo
    observe: Observe
    panorama: Show
    record: Record
    keep: Keep


class Method(Protocol):
    """A way to take the benchmark. `answer` is called concurrently from several threads."""

    @property
    def name(self) -> str: ...

    def answer(self, task: Task) -> Prediction:
        """Answer one question. An exception becomes an `error` prediction; it never ends the run."""
        ...


class Settled(Method, Protocol):
    """A method whose settings are kept in the run's manifest: a run is resumed only under equal settings."""

    def settings(self) -> dict[str, Any]: ...
