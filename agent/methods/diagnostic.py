"""Diagnostic methods: the model answers in one call from crops that it did not choose. They are never ranked.

random-looks draws its looks. given-looks and given-target get crops from the engine, which derives them from the proofs
of the question. These methods receive the crops alone.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from jrdb_avr.agent.methods.attempt import Attempt, ImageFrame, stitched_evidence
from jrdb_avr.agent.methods.monolithic import answer_pictures
from jrdb_avr.agent.methods.requests import shared_settings
from jrdb_avr.agent.model.client import Chat
from jrdb_avr.agent.model.conventions import CONTRACT, Convention
from jrdb_avr.agent.model.messages import metadata_line, picture_of
from jrdb_avr.schema.answers import Evidence
from jrdb_avr.schema.method import Observation, Prediction, Task
from jrdb_avr.schema.panorama import CROP, Box, clockwise, from_crop

_SEED: Final = 0
"""Seed of the drawn looks. The looks of a question follow from it and from the id of the question."""

_STEP_DEG: Final = 40
"""Maximum degrees between two looks that show everything between them. A person between them is whole in one."""

TURNS: Final = tuple(range(_STEP_DEG, 360, _STEP_DEG))
"""Turns in degrees from a first look to the looks that show the rest of the circle."""

_MARKED: Final = "In one picture, a red box is drawn round the person whom the question asks about.\n"

Pictures = Callable[[Task], Sequence[Observation]]
"""Function that returns the crops of a question, in the order in which the model gets them."""


class _Crops(ImageFrame):
    """The crops that a box of a reply may refer to. A frame stands for its first crop."""

    lefts: dict[int, int]

    def evidence(self, frame: int, box: Box) -> Evidence:
        """Return the evidence that consists of a box in the first crop of a frame."""
        return stitched_evidence(frame, from_crop(box, self.lefts[frame]))


@dataclass(frozen=True)
class Diagnostic:
    """A diagnostic method.

    name: a name of `DIAGNOSTIC`. pictures: the crops of a question. budget: number of drawn looks, or None. marked:
    whether a box in a picture marks the person whom the question asks about.
    """

    name: str
    chat: Chat
    pictures: Pictures
    budget: int | None = None
    marked: bool = False
    convention: Convention = CONTRACT

    def settings(self) -> dict[str, Any]:
        """Return the method's settings for a run's manifest."""
        drawn = {} if self.budget is None else {"budget": self.budget, "seed": _SEED}
        return {"diagnostic": True, **drawn, **shared_settings(self.convention)}

    def answer(self, task: Task) -> Prediction:
        """Answer in one call, or in two calls if the first reply cannot be read.

        Args:
            task: The question to answer.

        Returns:
            The prediction.
        """
        attempt = Attempt(task, self.chat, self.convention)
        crops = [attempt.look(crop.frame_index, crop.angle_deg, crop) for crop in self.pictures(task)]
        image = _Crops(tuple(dict.fromkeys(crop.frame_index for crop in crops)), CROP, CROP, 0)
        image.lefts = {crop.frame_index: crop.left for crop in reversed(crops)}
        parts = [
            part
            for count, crop in enumerate(crops, 1)
            for part in (f"Picture {count}: {metadata_line(crop)}", picture_of(crop))
        ]
        return answer_pictures(attempt, image, parts, "given", marked=_MARKED if self.marked else "")


def random_pictures(budget: int) -> Pictures:
    """Return the function that draws the looks of `random-looks`.

    Args:
        budget: Number of looks.

    Returns:
        The function. Frames and angles (degrees) are uniform over the legal frames and the circle.
    """

    def draw(task: Task) -> list[Observation]:
        drawn = random.Random(f"{_SEED} {task.question.question_id}")  # noqa: S311
        views = [(drawn.choice(task.sequence.frames), drawn.uniform(0, 360)) for _ in range(budget)]
        return [task.observe(task.question.sequence, frame, angle) for frame, angle in views]

    return draw


def angles_between(first: float, last: float) -> list[float]:
    """Return the angles of looks between two people, each in the middle of another look.

    Args:
        first: Panorama angle of a person in degrees.
        last: Panorama angle of the other person in degrees.

    Returns:
        The fewest angles in degrees whose looks show everything between the people. One look shows both people if they
        are near enough, and none is needed if the looks at them show both.
    """
    turn = (clockwise(first, last) + 180) % 360 - 180
    count = max(math.ceil(abs(turn) / _STEP_DEG) - 1, int(abs(turn) > _STEP_DEG / 2))
    return [(first + turn * step / (count + 1)) % 360 for step in range(1, count + 1)]
