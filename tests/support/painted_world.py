"""Small worlds painted for tests: people with marks on grey panoramas, and an observer that looks at the files."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.schema.markers import Mark, draw
from jrdb_avr.schema.method import Question, SequenceInfo, Task
from jrdb_avr.schema.panorama import HEIGHT, WIDTH, Box

SEQUENCE = "painted"


@dataclass
class Actor:
    """A person: `box(frame)` is a Box or None (not there), `mark(frame)` what the mark says."""

    box: object
    mark: object


def still(x, identity, *, y=120, w=70, h=220, **mark):
    """An actor that stays where it is and as it is."""
    return Actor(lambda frame: Box(x, y, w, h), lambda frame: Mark(identity, **mark))


@dataclass
class World:
    root: object
    actors: list
    frames: tuple
    fps: float = 15.0
    painted: set = field(default_factory=set)

    def __post_init__(self):
        folder = self.root / SEQUENCE
        folder.mkdir(parents=True)
        self.info = SequenceInfo(SEQUENCE, self.fps, self.frames[-1] + 1, tuple(self.frames))
        observer = Observer(self.root, [self.info])

        def painted(frame):
            # When first looked at: worlds of many frames cost only what is seen.
            if frame not in self.painted:
                self.painted.add(frame)
                self.paint(folder / f"{frame:06d}.jpg", frame)
            return frame

        self.observe = lambda sequence, frame_index, angle_deg: observer(sequence, painted(frame_index), angle_deg)
        self.panorama = lambda sequence, frame_index: observer.stored(sequence, painted(frame_index))

    def paint(self, path, frame):
        image = np.full((HEIGHT, WIDTH, 3), 96, np.uint8)
        image[240:] = 70
        for actor in self.actors:
            if (box := actor.box(frame)) is not None:
                draw(image, box, actor.mark(frame))
        cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 90])

    def task(self, question, mode, choices=(), steps=None, writes=None):
        row = Question("0" * 16, SEQUENCE, question, tuple(choices), mode)
        record = (steps if steps is not None else []).append
        return Task(row, self.info, self.observe, self.panorama, record, ([] if writes is None else writes).append)
