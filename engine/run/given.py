"""Pictures of the diagnostic methods given-looks and given-target: crops that show what the proofs need.

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
from itertools import pairwise
from typing import Final, NamedTuple

import msgspec
import numpy as np

from jrdb_avr.agent.methods.diagnostic import TURNS, angles_between
from jrdb_avr.queries.opaque import stored_ids
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.method import Observation, Observe, Task
from jrdb_avr.schema.panorama import Box, center_angle, to_crop
from jrdb_avr.schema.plan import Plan, parse_plan
from jrdb_avr.schema.questions import NeededBox

GIVEN: Final = ("given-looks", "given-target")
"""Methods that get pictures from here."""

_RED, _LINE = (255, 0, 0), 2


class GivenLook(NamedTuple):
    """A look: frame, angle in degrees, and in stitched pixels the target's box at the time asked."""

    frame: int
    angle: float
    box: Box | None


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
        looks = self._looks[self._stored_ids.get(task.question.question_id, task.question.question_id)]
        return [self._picture(task.question.sequence, look) for look in looks if look.frame in task.sequence.frames]

    def _picture(self, sequence: str, look: GivenLook) -> Observation:
        import cv2

        seen = self._observe(sequence, look.frame, look.angle)
        if look.box is None or not self._marked:
            return seen
        x, y, w, h = to_crop(look.box, seen.left)
        image = np.array(seen.image)
        cv2.rectangle(image, (round(x), round(y)), (round(x + w) - 1, round(y + h) - 1), _RED, _LINE)
        return replace(seen, image=image)


def looks_of(needed: Sequence[NeededBox], plan: Plan) -> list[GivenLook]:
    """Return the looks that show what the proofs of a question need, in order of time.

    Each needed person has a look per frame, the target first. Looks between two people whom a relation joins come after
    these. If the answer is a frame or a span, the frames beside a decisive box have looks too. If the target may be
    absent at a time, there are looks in all directions, also if the target is present: their number says nothing.

    Args:
        needed: The boxes that the proofs need.
        plan: The plan of the question.

    Returns:
        The looks. The look at the target in the last frame that needs the target has the box.
    """
    boxes = {(box.frame, box.node != plan.target, box.track): box for box in needed}
    described, *_, asked = sorted(key for key in (*boxes, *boxes) if not key[1])
    absences = plan.answer.times if plan.answer.read in ("presence", "distance_change") else ()
    later = {at for name in absences if (at := plan.times[name].frame or 0) > described[0]}
    beside = (-1, 1) if plan.answer.mode in ("frame", "span", "frame_viewpoint") else ()
    others = [(box.frame + step, box) for box in needed if box.decisive for step in beside]
    for frame, box in (*others, *((frame, boxes[described]) for frame in later)):
        boxes.setdefault((frame, box.node != plan.target, box.track), box)
    looks = [
        GivenLook(key[0], center_angle(box.x, box.w), Box(box.x, box.y, box.w, box.h) if key == asked else None)
        for key, box in sorted(boxes.items(), key=lambda entry: entry[0])
    ]
    looks += [GivenLook(at, (angle + turn) % 360, None) for at, angle, _ in looks if at in later for turn in TURNS]
    for edge in plan.edges:
        at, nodes = plan.times[edge.at].frame or 0, (edge.source, edge.target)
        ends = [center_angle(box.x, box.w) for box in needed if box.frame == at and box.node in nodes]
        looks += [GivenLook(at, angle, None) for pair in pairwise(ends) for angle in angles_between(*pair)]
    return sorted(looks, key=lambda look: look.frame)


def main(path: str) -> None:
    """Print the looks of all questions of a store as JSON."""
    boxes = msgspec.json.Decoder(list[NeededBox])
    rows = Store(path).questions("answers").to_pylist()
    looks = {row["question_id"]: looks_of(boxes.decode(row["needed"]), parse_plan(row["plan"])) for row in rows}
    sys.stdout.write(msgspec.json.encode(looks).decode())


if __name__ == "__main__":
    try:
        main(sys.argv[1])
    except AvrError as error:
        sys.exit(str(error))
