"""Draw the panoramas of a synthetic sequence: surroundings, partitions, things and people, the farthest first.

All is drawn as numbers of parts. The colours of the parts give the panorama, their segments give the panoptic layer.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.objects import BELOW
from jrdb_avr.loaders.synthetic.script import POSE, Rng, one_of
from jrdb_avr.loaders.synthetic.skeleton import (
    AWAY,
    HEAD,
    HIP,
    L_ELBOW,
    L_FOOT,
    L_HIP,
    L_KNEE,
    L_SHOULDER,
    L_WRIST,
    NECK,
    R_ELBOW,
    R_FOOT,
    R_HIP,
    R_KNEE,
    R_SHOULDER,
    R_WRIST,
)
from jrdb_avr.loaders.synthetic.world import FARTHEST, FLOOR, World
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.panorama import FOCAL_ROWS, HEIGHT, WIDTH, row_of_height
from jrdb_avr.schema.rules import KEYFRAME_STEP
from jrdb_avr.schema.things import OBJECTS

Picture = npt.NDArray[np.uint16]
"""Number of the part or segment at each pixel, (480, 3760)."""
Color = tuple[int, int, int]

QUALITY: Final = 92
"""JPEG quality of the panoramas."""

_PERSON, _PANEL, _THING = range(3)
_TROUSERS, _SHIRT, _SKIN = range(3)
"""Parts of a person."""
_STROKES: Final = (
    (_TROUSERS, 0.13, (R_FOOT, R_KNEE, R_HIP, L_HIP, L_KNEE, L_FOOT)),
    (_SHIRT, 0.20, (R_HIP, R_SHOULDER, L_SHOULDER, L_HIP, NECK, HIP)),
    (_SHIRT, 0.09, (R_ELBOW, R_SHOULDER, L_SHOULDER, L_ELBOW)),
    (_SKIN, 0.07, (R_WRIST, R_ELBOW)),
    (_SKIN, 0.07, (L_WRIST, L_ELBOW)),
    (_SKIN, 0.10, (NECK, HEAD)),
)
"""Lines of a person from joint to joint: the part, and the width in metres."""

_WALLS: Final = ((150, 145, 132), (132, 145, 150), (150, 138, 120), (138, 148, 135))
_FLOORS: Final = ((118, 108, 96), (104, 108, 112), (112, 112, 98), (100, 96, 92))
_PANELS: Final = ((96, 84, 70), (70, 84, 100), (84, 96, 80), (100, 78, 84))
_STEPS: Final = (104, 100, 96)
_PEOPLE: Final = (
    ((40, 45, 70), (70, 60, 50), (50, 55, 50), (60, 60, 65)),
    ((150, 50, 50), (60, 90, 150), (60, 120, 70), (150, 110, 50), (110, 70, 130), (60, 130, 140), (160, 90, 110)),
    ((180, 140, 115), (150, 110, 85), (110, 80, 60)),
)
"""RGB colours of each part of a person. Their counts have no common divisor, so that few people look the same."""

_FOOT: Final = 240
"""Row of the line between walls and floor."""
_SLOTS: Final = 16
_LANDMARKS: Final = {
    "window": (60, 150, 130),
    "door": (120, _FOOT, 60),
    "column": (0, _FOOT, 34),
    "poster": (80, 150, 100),
    "vegetation": (100, _FOOT, 40),
}
"""First row, last row and width of what is at the walls, in pixels."""


def panorama_frames(world: World, which: str) -> list[int]:
    """Return the frames that get a panorama.

    `none`; `keyframes`; `changes`: keyframes, and of every tick but the first the first frame and the one before, so
    that they do not reveal at which of them anything changes; `all`.
    """
    keyframes = range(0, world.frames, KEYFRAME_STEP)
    if which == "changes":
        starts = world.starts[1:-1]
        return sorted({*keyframes, *starts.tolist(), *(starts - 1).tolist()})
    return list({"none": range(0), "keyframes": keyframes, "all": range(world.frames)}[which])


class Painter:
    """Painter of the frames of one world. The surroundings are made once and turned with the robot.

    `steps`, `panels`, `things` and `people` are the first numbers of the segments. The surroundings have those from 1.
    Segments are parts too, but the parts of a person follow one another at a distance of the number of people.
    """

    def __init__(self, world: World) -> None:
        rng = world.rng("colors")
        self._world = world
        panels = [one_of(rng, _PANELS) for _ in range(world.panel_boxes.shape[1])]
        self._backdrop, self.surroundings, colors = _surroundings(rng)
        self.steps, self.panels = len(self.surroundings) + 1, len(self.surroundings) + 2
        self.things = self.panels + len(panels)
        self.people = self.things + len(world.things.things)
        kinds = [OBJECTS.index(thing.category) for thing in world.things.things]
        # A colour of its own for each category.
        things = [(40 + 37 * kind % 120, 40 + 91 * kind % 120, 40 + 53 * kind % 120) for kind in kinds]
        people = [choices[person.identity % len(choices)] for choices in _PEOPLE for person in world.people]
        self._colors = np.array([(0, 0, 0), *colors, _STEPS, *panels, *things, *people], np.uint8)

    def paint(self, frame: int) -> npt.NDArray[np.uint8]:
        """Return the panorama (480, 3760, 3), RGB."""
        return np.asarray(self._colors[self._draw(frame)])

    def segment(self, frame: int) -> Picture:
        """Return the number of the segment at each pixel, (480, 3760)."""
        parts = self._draw(frame)
        return np.where(parts < self.people, parts, self.people + (parts - self.people) % len(self._world.people))

    def _draw(self, frame: int) -> Picture:
        """Draw all items before the surroundings."""
        world = self._world
        # Turning left by yaw moves what is far to the right by as much.
        picture = np.roll(self._backdrop, round(float(world.motion.robot[frame, 2]) / (2 * np.pi) * WIDTH), axis=1)
        for kind, index in self._from_far(frame):
            x, y, w, h = (world.boxes, world.panel_boxes, world.thing_boxes)[kind][frame, index].tolist()
            # Twice, because it may touch both edges of the image.
            for left in (x % WIDTH, x % WIDTH - WIDTH):
                if kind == _PERSON:
                    self._draw_person(picture, frame, index, (left, y, w, h))
                else:
                    part = self.panels + index if kind == _PANEL else self.things + world.things.stands[index]
                    _draw_thing(picture, part, (left, y, w, h))
        return picture

    def _from_far(self, frame: int) -> list[tuple[int, int]]:
        """Return (kind, index) of all people, partitions and things at a frame, the farthest first."""
        world = self._world
        items = [(float(world.distance[frame, i]), _PERSON, i) for i in np.flatnonzero(world.present[frame]).tolist()]
        items += [(float(d), _PANEL, k) for k, d in enumerate(world.panel_distance[frame].tolist())]
        items += [(d, _THING, k) for k, d in enumerate(world.thing_distance[frame].tolist()) if d < FARTHEST]
        return [(kind, index) for _, kind, index in sorted(items, reverse=True)]

    def _draw_person(self, picture: Picture, frame: int, i: int, box: tuple[int, int, int, int]) -> None:
        """Draw a person around the joints, with the steps below and the things that the person carries or rides."""
        world, (left, y, w, h) = self._world, box
        distance = float(world.distance[frame, i])
        meter, ground = FOCAL_ROWS / distance, round(row_of_height(FLOOR, distance))
        if ground - y - h > 1:
            cv2.rectangle(picture, (left, y + h, w, ground - y - h), (self.steps,), -1)
        points = np.rint(world.joints[frame, i] + (left - world.boxes[frame, i, 0], 0)).astype(np.int32)
        pose, away = int(world.pose[frame, i]), world.turned[1][frame, i] < AWAY
        size = max(2, round(0.2 * meter))
        seat = int(points[HIP, 1]) if pose == POSE["sitting"] else ground - size // 2
        places = [(*(points[wrist] - size // 2).tolist(), size, size) for wrist in (R_WRIST, L_WRIST)]
        places.append((left, seat, w, ground - seat))
        handled = [
            (self.things + thing, places[hand], hand == BELOW or away, hand == BELOW and pose == POSE["cycling"])
            for person, thing, _, hand in world.things.handling.at(int(world.tick[frame]))
            if person == i and not world.things.things[thing].standing
        ]
        for part, place, behind, wheels in handled:
            if behind:
                _draw_thing(picture, part, place, wheels)
        parts = range(self.people + i, len(self._colors), len(world.people))
        for part, width, joints in _STROKES:
            cv2.polylines(picture, [points[list(joints)]], False, (parts[part],), max(1, round(width * meter)))
        head = parts[_TROUSERS if away else _SKIN]
        cv2.circle(picture, points[HEAD].tolist(), max(2, round(0.12 * meter)), (head,), -1)
        for part, place, behind, _ in handled:
            if not behind:
                _draw_thing(picture, part, place)


def _draw_thing(picture: Picture, part: int, box: tuple[int, int, int, int], wheels: bool = False) -> None:
    """Draw a thing as a rectangle, or two wheels in its place."""
    x, y, w, h = box
    if not wheels:
        cv2.rectangle(picture, box, (part,), -1)
        return
    for column in (x + w // 6, x + w - w // 6):
        cv2.circle(picture, (column, y + h - w // 6), w // 6, (part,), max(1, w // 30))


def _surroundings(rng: Rng) -> tuple[Picture, list[str], list[Color]]:
    """Draw walls with landmarks above a floor, before the robot turns.

    Returns the parts, which count from 1, and the category and the colour of each.
    """
    picture = np.ones((HEIGHT, WIDTH), np.uint16)
    picture[_FOOT:] = 2
    categories, colors = ["wall", "floor/walking_path"], [one_of(rng, _WALLS), one_of(rng, _FLOORS)]
    for slot in range(_SLOTS):
        left = slot * (WIDTH // _SLOTS) + int(rng.integers(10, 60))
        categories.append(one_of(rng, tuple(_LANDMARKS)))
        top, bottom, width = _LANDMARKS[categories[-1]]
        picture[top:bottom, left : left + width] = len(categories)
        red, green, blue = rng.integers(70, 150, 3).tolist()
        colors.append((red, green, blue))
    return picture, categories, colors


def write_images(world: World, frames: list[int], folder: Path) -> None:
    """Write `NNNNNN.jpg` of these frames into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    painter = Painter(world)
    for frame in frames:
        bgr = cv2.cvtColor(painter.paint(frame), cv2.COLOR_RGB2BGR)
        done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        if not done:
            raise InputError(f"the panorama of {world.name} frame {frame} cannot be encoded", frame=f"{frame:06d}")
        (folder / f"{frame:06d}.jpg").write_bytes(data.tobytes())
