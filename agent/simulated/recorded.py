"""A detector's readings of real panoramas: the profile `recorded` reads them in place of the annotated boxes.

The file is a JSON object: {frame: {angle: [[x, y, w, h, score, pose, ...], ...]}}, with boxes in pixels of the crop. A
reading that overlaps an annotated person is a reading of this person. Any other reading is a false person.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.agent.simulated.noise import Reader, ReadPerson
from jrdb_avr.agent.simulated.people import Person
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import CROP, Box, angle_error, center_angle, crop_left, iou

_SAME: Final = 0.4
"""Minimum IoU of a reading with the person that it shows."""
_TWICE: Final = 0.5
"""Minimum IoU of two readings of one person in two crops of a frame."""
_NEAR_DEG: Final = 11.25
"""Maximum angle between a picture and a crop with readings."""

Readings = dict[int, dict[float, list[list[Any]]]]


@functools.cache
def load_readings(path: str) -> Readings:
    """Return the readings in a file by frame and angle, none for "". Raise InputError if the file cannot be read."""
    try:
        return msgspec.json.decode(Path(path).read_bytes() if path else b"{}", type=Readings, strict=False)
    except (OSError, msgspec.DecodeError) as error:
        raise InputError(f"--simulate readings: cannot take {path}: {error}", field="readings") from None


class RecordedReader(Reader):
    """Reader that takes boxes and postures from the readings of a detector."""

    def people(self, everyone: Sequence[Person]) -> tuple[ReadPerson, ...]:
        """Return the people who are read in the picture, from left to right. `everyone` are the annotated people."""
        readings = load_readings(self.errors.readings)
        crops = readings[min(readings, key=lambda at: abs(at - self.view.frame))] if readings else {}
        people: list[ReadPerson] = []
        for angle, found in crops.items():
            if self.view.width == CROP and angle_error(angle, center_angle(self.view.left, CROP)) > _NEAR_DEG:
                continue
            for x, y, w, h, _, pose, *_ in found:
                stitched = Box(crop_left(angle) + x, y, w, h)
                box = self.view.place(stitched)
                if box is not None and not any(iou(box, person.box) >= _TWICE for person in people):
                    people.append(self._read(stitched, box, pose, everyone))
        return tuple(sorted({each.identity: each for each in people}.values(), key=lambda person: person.box.x))

    def _read(self, stitched: Box, box: Box, pose: str | None, everyone: Sequence[Person]) -> ReadPerson:
        """Return a reading as a person: the annotated one with the largest overlap, or a false one."""
        poses = frozenset((pose,)) if pose in POSES else frozenset[str]()
        best = max(everyone, key=lambda person: iou(person.box, stitched), default=None)
        if best is None or iou(best.box, stitched) < _SAME:
            best = Person(-1 - int(center_angle(stitched.x, stitched.w)), stitched)
        return ReadPerson(best.track, replace(best, labels={**best.labels, "pose": poses}), box, self)
