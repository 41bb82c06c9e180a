"""Draw the panoramas of a synthetic sequence: surroundings, partitions, things and people, the farthest first.

The same strokes, with numbers for colours, give the segments of the panoptic layer.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from jrdb_avr.loaders.synthetic.backdrop import Backdrop
from jrdb_avr.loaders.synthetic.figures import OWNER, Canvas, Figure, Held, Pixels, draw_figure, draw_thing
from jrdb_avr.loaders.synthetic.objects import BELOW
from jrdb_avr.loaders.synthetic.script import one_of
from jrdb_avr.loaders.synthetic.shapes import Color, shade
from jrdb_avr.loaders.synthetic.skeleton import facing
from jrdb_avr.loaders.synthetic.world import FARTHEST, FLOOR, World, body_rows
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import POSES
from jrdb_avr.schema.panorama import FOCAL_ROWS, WIDTH, row_of_height
from jrdb_avr.schema.rules import KEYFRAME_STEP

QUALITY: Final = 92
"""JPEG quality of the panoramas."""
STAIRS: Final = -2
"""Part of a drawing that is the stairs below a person."""

_PERSON, _PANEL, _THING = range(3)
_PANELS: Final[tuple[Color, ...]] = ((96, 84, 70), (70, 84, 100), (84, 96, 80), (100, 78, 84))


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
    """

    def __init__(self, world: World) -> None:
        rng = world.rng("colors")
        self._world = world
        self._panel_colors = [one_of(rng, _PANELS) for _ in range(world.panel_boxes.shape[1])]
        self._backdrop = Backdrop(rng)
        self.surroundings = self._backdrop.categories
        self.steps, self.panels = len(self.surroundings) + 1, len(self.surroundings) + 2
        self.things = self.panels + len(self._panel_colors)
        self.people = self.things + len(world.things.things)
        self._across, self._toward = facing(world.pose, *world.turned)

    def paint(self, frame: int) -> Pixels:
        """Return the panorama (480, 3760, 3), RGB."""
        return self._render(frame, self._backdrop.image)

    def segment(self, frame: int) -> Pixels:
        """Return the number of the segment at each pixel, (480, 3760)."""
        things = {thing: self.things + thing for thing in range(len(self._world.things.things))}
        return self._render(frame, self._backdrop.ids, {STAIRS: self.steps, **things})

    def _render(self, frame: int, backdrop: Pixels, numbers: dict[int, int] | None = None) -> Pixels:
        """Draw all items before the backdrop, in colours or in the numbers of their parts."""
        # Turning left by yaw moves what is far to the right by as much.
        turn = round(float(self._world.motion.robot[frame, 2]) / (2 * np.pi) * WIDTH)
        image, carried = np.roll(backdrop, turn, axis=1), self._carried(frame)
        for kind, index in self._from_far(frame):
            owner = index + (self.people if kind == _PERSON else self.panels)
            canvas = Canvas(image, None if numbers is None else numbers | {OWNER: owner})
            self._draw(canvas, frame, kind, index, carried)
        return image

    def _from_far(self, frame: int) -> list[tuple[int, int]]:
        """Return (kind, index) of all people, partitions and things at a frame, the farthest first."""
        world = self._world
        items = [(float(world.distance[frame, i]), _PERSON, i) for i in np.flatnonzero(world.present[frame]).tolist()]
        items += [(float(d), _PANEL, k) for k, d in enumerate(world.panel_distance[frame].tolist())]
        items += [(d, _THING, k) for k, d in enumerate(world.thing_distance[frame].tolist()) if d < FARTHEST]
        return [(kind, index) for _, kind, index in sorted(items, reverse=True)]

    def _draw(self, canvas: Canvas, frame: int, kind: int, index: int, carried: dict[int, list[Held]]) -> None:
        boxes = (self._world.boxes, self._world.panel_boxes, self._world.thing_boxes)[kind]
        x, y, w, h = boxes[frame, index].tolist()
        # The left columns of the copies of it that touch the image.
        start = x % WIDTH
        for left in [start, start - WIDTH] if start + w > WIDTH else [start]:
            if kind == _PERSON:
                self._draw_person(canvas, frame, index, left, carried.get(index, []))
            elif kind == _PANEL:
                _draw_panel(canvas, (left, y, w, h), self._panel_colors[index])
            else:
                thing = self._world.things.stands[index]
                draw_thing(canvas, self._world.things.things[thing].category, (left, y, w, h), thing)

    def _draw_person(self, canvas: Canvas, frame: int, i: int, left: int, carried: list[Held]) -> None:
        world, distance = self._world, self._world.distance[frame, i]
        x, _, w, _ = world.boxes[frame, i].tolist()
        top, bottom = (round(row) for row in body_rows(world.motion.z[frame, i], distance, world.height[frame, i]))
        ground = round(row_of_height(FLOOR, float(distance)))
        if canvas.numbers is None:
            # A shadow, which is no part of any segment.
            canvas.ellipse((left + w // 2, ground - 1), (max(1, w // 2), max(1, w // 8)), (62, 58, 54))
        if ground - bottom > 1:
            canvas.rectangle((left, bottom), (left + w - 1, ground), (104, 100, 96), STAIRS)
            for row in range(bottom, ground, max(3, (ground - bottom) // 5)):
                canvas.lines([(left, row), (left + w - 1, row)], (74, 70, 68), STAIRS)
        joints = np.rint(world.joints[frame, i] + np.array([left - x, 0.0])).astype(np.int64).tolist()
        figure = Figure(
            left,
            top,
            w,
            bottom - top,
            POSES[int(world.pose[frame, i])],
            [(column, row) for column, row in joints],
            FOCAL_ROWS / float(distance),
            float(self._across[frame, i]),
            float(self._toward[frame, i]),
            world.people[i].identity,
            next((thing for hand, _, thing in carried if hand == BELOW), OWNER),
            tuple(held for held in carried if held[0] != BELOW),
        )
        draw_figure(canvas, figure)

    def _carried(self, frame: int) -> dict[int, list[Held]]:
        """Return the things that are drawn with each person."""
        out: dict[int, list[Held]] = {}
        for person, thing, _, hand in self._world.things.handling.at(int(self._world.tick[frame])):
            item = self._world.things.things[thing]
            if not item.standing:
                out.setdefault(person, []).append((hand, item.category, thing))
        return out


def _draw_panel(canvas: Canvas, box: tuple[int, int, int, int], color: Color) -> None:
    """Draw a partition with posters on it."""
    x, y, w, h = box
    edge = shade(color, -30)
    canvas.rectangle((x, y), (x + w, y + h), color)
    canvas.rectangle((x, y), (x + w, y + h), edge, width=2)
    for part in range(1, 5):
        at = x + w * part // 5
        canvas.lines([(at, y), (at, y + h)], edge)
        poster = shade(color, 25, 30, 20) if part % 2 else edge
        canvas.rectangle((at - w // 7, y + h // 6), (at - w // 16, y + h // 2), poster)


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
