"""Pictures of the diagnostic methods given-looks and given-target: crops around the boxes that the proofs need.

    python -m jrdb_avr.engine.run.given STORE

The child process reads the answers and prints the looks of each question: no answer, label, template or track. The
process that talks to the model makes the crops from the looks, and a method receives the crops alone.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import msgspec
import numpy as np

from jrdb_avr.queries.opaque import stored_ids
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.method import Observation, Observe, Task
from jrdb_avr.schema.panorama import WIDTH, center_angle
from jrdb_avr.schema.questions import NeededBox

GIVEN: Final = ("given-looks", "given-target")
"""Methods that get pictures from here."""

_MOMENTS: Final = ("frame", "span", "frame_viewpoint")
"""Answer modes that ask for a frame."""

_RED, _LINE = (255, 0, 0), 2


class GivenLook(NamedTuple):
    """A look at a needed box: frame, angle in degrees, and in stitched pixels the target's box at the time asked."""

    frame: int
    angle: float
    box: tuple[float, float, float, float] | None


class GivenPictures:
    """The function from a task to the pictures that the proofs of its question need, in order of time."""

    def __init__(self, store: Store, observe: Observe, marked: bool) -> None:
        """Read the looks in a child process.

        Args:
            store: A store with answers.
            observe: The function that returns a crop of a frame.
            marked: Whether to draw the target's box in the picture of the time asked.

        Raises:
            StoreError: If the answers cannot be read.
        """
        environment = {name: value for name, value in os.environ.items() if not name.endswith("_API_KEY")}
        command = [sys.executable, "-m", "jrdb_avr.engine.run.given", str(store.path)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        if done.returncode:
            raise StoreError(done.stderr.strip() or "the process that reads the needed boxes ended: try again")
        self._looks = msgspec.json.decode(done.stdout, type=dict[str, list[GivenLook]])
        self._observe, self._stored_ids, self._marked = observe, stored_ids(store), marked

    def __call__(self, task: Task) -> list[Observation]:
        """Return the pictures of a question."""
        shown = task.question.question_id
        looks = self._looks[self._stored_ids.get(shown, shown)]
        return [self._picture(task.question.sequence, look) for look in looks if look.frame in task.sequence.frames]

    def _picture(self, sequence: str, look: GivenLook) -> Observation:
        import cv2

        seen = self._observe(sequence, look.frame, look.angle)
        if look.box is None or not self._marked:
            return seen
        x, y, w, h = look.box
        # The crop is around the box, so that the box begins at most half a panorama to the left of it.
        left = (x - seen.left + WIDTH / 2) % WIDTH - WIDTH / 2
        image = np.array(seen.image)
        cv2.rectangle(image, (round(left), round(y)), (round(left + w) - 1, round(y + h) - 1), _RED, _LINE)
        return replace(seen, image=image)


def looks_of(needed: Sequence[NeededBox], target: int, around: bool) -> list[GivenLook]:
    """Return one look per needed person and frame, in order of time. The target comes first in a frame.

    Args:
        needed: The boxes that the proofs of a question need.
        target: Track of the target.
        around: Whether the answer is a frame or a span, so that the frames beside a decisive box are needed too.

    Returns:
        The looks. The look at the target in the last frame that needs the target has the box.
    """
    boxes = {(box.frame, box.track != target, box.track): box for box in needed}
    asked = max(key for key in boxes if not key[1])
    for box in needed:
        for frame in (box.frame - 1, box.frame + 1) if around and box.decisive else ():
            boxes.setdefault((frame, box.track != target, box.track), box)
    return [
        GivenLook(key[0], center_angle(box.x, box.w), (box.x, box.y, box.w, box.h) if key == asked else None)
        for key, box in sorted(boxes.items(), key=lambda entry: entry[0])
    ]


def main(path: str) -> None:
    """Print the looks of all questions of a store as JSON."""
    questions, answers = Store(path).question_tables("questions", "answers")
    modes = dict(zip(questions["question_id"].to_pylist(), questions["answer_mode"].to_pylist(), strict=True))
    looks = {
        row["question_id"]: looks_of(
            msgspec.json.decode(row["needed"], type=list[NeededBox]),
            row["target_track"],
            modes[row["question_id"]] in _MOMENTS,
        )
        for row in answers.to_pylist()
    }
    sys.stdout.write(msgspec.json.encode(looks).decode())


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except AvrError as error:
        sys.exit(str(error))
