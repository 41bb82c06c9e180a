"""Panoramas of a simulated sequence: background, partitions and people from the farthest to the nearest, with marks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.marks import ALONE, HEADING_STEP, MAX_DISTANCE_DM, MAX_GROUP, Mark, draw
from jrdb_avr.schema.panorama import FOCAL_ROWS, HEIGHT, HORIZON_ROW, WIDTH, Box
from jrdb_avr.schema.rules import KEYFRAME_STEP
from jrdb_avr.schema.vocabulary import OTHER_ACTIONS, POSES

from .figures import Color, Figure, draw_figure, look_of
from .labels import annotated
from .script import NONE
from .world import FLOOR, World, rng_of

Image = npt.NDArray[np.uint8]
Bools = npt.NDArray[np.bool_]

QUALITY: Final = 92
"""JPEG quality of the panoramas."""

_WALLS: Final[tuple[Color, ...]] = ((150, 145, 132), (132, 145, 150), (150, 138, 120), (138, 148, 135))
_FLOORS: Final[tuple[Color, ...]] = ((118, 108, 96), (104, 108, 112), (112, 112, 98), (100, 96, 92))
_PANELS: Final[tuple[Color, ...]] = ((96, 84, 70), (70, 84, 100), (84, 96, 80), (100, 78, 84))


def image_frames(world: World, which: str) -> list[int]:
    """Frames that get a panorama.

    `none`; `keyframes`; `changes`: keyframes, and the last frame before and the first after each change of state;
    `all`.
    """
    steps = {
        "none": (),
        "keyframes": (0,),
        "changes": (0, world.phase - 1, world.phase),
        "all": range(KEYFRAME_STEP),
    }[which]
    return [frame for frame in range(world.frames) if frame % KEYFRAME_STEP in steps]


def marks_of(world: World, labelled: Bools, frame: int) -> dict[int, Mark]:
    """What the marks of the people present say at a frame: the truth of the world, by place in `world.people`.

    A group counts the people `labelled` (frames, people): one left alone by the annotators' dropouts is alone.
    """
    out = {}
    here = np.flatnonzero(world.present[frame])
    clusters = world.cluster[frame, here].tolist()
    counted = world.cluster[frame, labelled[frame]].tolist()
    for i, cluster in zip(here.tolist(), clusters, strict=True):
        person = world.people[i]
        heading = np.degrees(world.motion.heading[frame, i])
        distance = round(float(world.distance[frame, i]) * 10)
        out[i] = Mark(
            identity=person.identity,
            gender=person.gender,
            age=person.age,
            pose=POSES[int(world.pose[frame, i])],
            actions=tuple(
                sorted((OTHER_ACTIONS[a] for a in world.actions[frame, i].tolist() if a != NONE), key=_place)
            ),
            group=cluster % MAX_GROUP + 1 if counted.count(cluster) > 1 else ALONE,
            distance_dm=distance if distance <= MAX_DISTANCE_DM else None,
            heading_deg=round(heading / HEADING_STEP) * HEADING_STEP % 360,
        )
    return out


def _place(action: str) -> int:
    return OTHER_ACTIONS.index(action)


@dataclass(frozen=True)
class Painter:
    """Paints the frames of one world; the background is made once and turned with the robot."""

    world: World
    labelled: Bools
    background: Image
    panel_colors: tuple[Color, ...]

    @classmethod
    def of(cls, world: World) -> Painter:
        rng = rng_of(world.seed, world.name, "colors")
        colors = tuple(_PANELS[int(rng.integers(len(_PANELS)))] for _ in world.panels)
        return cls(world, annotated(world), _background(rng), colors)

    def paint(self, frame: int) -> Image:
        """The panorama (480, 3760, 3), RGB."""
        world = self.world
        yaw = float(world.motion.robot[frame, 2])
        # Turning left by yaw moves what is far to the right by as much.
        image: Image = np.roll(self.background, round(yaw / (2 * np.pi) * WIDTH), axis=1)
        marks = marks_of(world, self.labelled, frame)
        things = [(float(world.distance[frame, i]), 1, i) for i in marks]
        things += [(float(d), 0, k) for k, d in enumerate(world.panel_distance[frame].tolist())]
        for _, person, index in sorted(things, reverse=True):
            if person:
                self._person(image, frame, index, marks[index])
            else:
                self._panel(image, frame, index)
        return image

    def _panel(self, image: Image, frame: int, index: int) -> None:
        x, y, w, h = self.world.panel_boxes[frame, index].tolist()
        color = self.panel_colors[index]
        edge = (color[0] - 30, color[1] - 30, color[2] - 30)
        poster = (color[0] + 25, color[1] + 30, color[2] + 20)
        for left in _copies(x, w):
            cv2.rectangle(image, (left, y), (left + w, y + h), color, -1)
            cv2.rectangle(image, (left, y), (left + w, y + h), edge, 2)
            for part in range(1, 5):
                at = left + w * part // 5
                cv2.line(image, (at, y), (at, y + h), edge, 1)
                cv2.rectangle(
                    image, (at - w // 7, y + h // 6), (at - w // 16, y + h // 2), poster if part % 2 else edge, -1
                )

    def _person(self, image: Image, frame: int, i: int, mark: Mark) -> None:
        world = self.world
        x, y, w, h = world.boxes[frame, i].tolist()
        distance = float(world.distance[frame, i])
        feet = FLOOR + float(world.motion.z[frame, i])
        top = round(HORIZON_ROW - FOCAL_ROWS * (feet + float(world.height[frame, i])) / distance)
        bottom = round(HORIZON_ROW - FOCAL_ROWS * feet / distance)
        ground = round(HORIZON_ROW - FOCAL_ROWS * FLOOR / distance)
        azimuth = np.arctan2(world.motion.y[frame, i], world.motion.x[frame, i])
        side = -float(np.sin(world.motion.heading[frame, i] - azimuth))
        for left in _copies(x, w):
            _shadow(image, left, ground, w)
            if ground - bottom > 1:
                _steps(image, left, bottom, w, ground - bottom)
            stride = frame * 0.5 + i
            look = look_of(mark.identity)
            draw_figure(image, Figure(left, top, w, bottom - top, mark.pose or "", mark.actions, side, stride, look))
        draw(image, Box(x, y, w, h), mark)


def _copies(x: int, w: int) -> list[int]:
    """Left columns of the copies of a thing that touch the image."""
    start = x % WIDTH
    return [start, start - WIDTH] if start + w > WIDTH else [start]


def _shadow(image: Image, x: int, ground: int, w: int) -> None:
    cv2.ellipse(image, (x + w // 2, ground - 1), (max(1, w // 2), max(1, w // 8)), 0, 0, 360, (62, 58, 54), -1)


def _steps(image: Image, x: int, y: int, w: int, h: int) -> None:
    cv2.rectangle(image, (x, y), (x + w - 1, y + h), (104, 100, 96), -1)
    for row in range(y, y + h, max(3, h // 5)):
        cv2.line(image, (x, row), (x + w - 1, row), (74, 70, 68), 1)


def _background(rng: np.random.Generator) -> Image:
    """Walls with windows, doors and pillars all round above the horizon, a tiled floor below; no bright pixel."""
    wall, floor = _WALLS[int(rng.integers(len(_WALLS)))], _FLOORS[int(rng.integers(len(_FLOORS)))]
    image = np.empty((HEIGHT, WIDTH, 3), np.float32)
    rows = np.arange(HEIGHT, dtype=np.float32)[:, None, None]
    foot = 240
    image[:foot] = np.array(wall, np.float32) * (0.72 + 0.3 * rows[:foot] / foot)
    image[foot:] = np.array(floor, np.float32) * (0.86 + 0.3 * (rows[foot:] - foot) / (HEIGHT - foot))
    # Joints of the tiles: rings at equal distances, and spokes.
    for meters in np.arange(1.0, 24.0, 1.0):
        row = int(HORIZON_ROW - FOCAL_ROWS * FLOOR / meters)
        if foot < row < HEIGHT:
            image[row] *= 0.9
    canvas = np.clip(image, 0, 175).astype(np.uint8)
    for column in range(0, WIDTH, 188):
        cv2.line(canvas, (column, foot), (column, HEIGHT), (floor[0] - 14, floor[1] - 14, floor[2] - 14), 1)
    _furnish(canvas, rng, foot, wall)
    noise = rng.normal(0, 1, (HEIGHT // 8, WIDTH // 8)).astype(np.float32)
    # Joined at the seam before it is blown up, so that no edge shows there.
    joined = np.hstack([noise[:, -1:], noise, noise[:, :1]])
    grain = cv2.resize(joined, (WIDTH + 16, HEIGHT), interpolation=cv2.INTER_LINEAR)
    grained = canvas + grain[:, 8:-8, None] * 1.5
    return np.asarray(np.clip(grained, 0, 180), np.uint8)


def _furnish(canvas: Image, rng: np.random.Generator, foot: int, wall: Color) -> None:
    """Landmarks on the wall, each 235 columns its own."""
    dark = (wall[0] - 45, wall[1] - 45, wall[2] - 45)
    for slot in range(16):
        x = slot * 235 + int(rng.integers(10, 60))
        kind = int(rng.integers(5))
        tint = tuple(int(c) for c in rng.integers(70, 150, 3))
        if kind == 0:
            cv2.rectangle(canvas, (x, 60), (x + 130, 150), (130, 150, 168), -1)
            cv2.rectangle(canvas, (x, 60), (x + 130, 150), dark, 3)
            cv2.line(canvas, (x + 65, 60), (x + 65, 150), dark, 2)
        elif kind == 1:
            cv2.rectangle(canvas, (x, 120), (x + 60, foot), tint, -1)
            cv2.rectangle(canvas, (x, 120), (x + 60, foot), dark, 2)
            cv2.circle(canvas, (x + 50, 185), 3, dark, -1)
        elif kind == 2:
            cv2.rectangle(canvas, (x, 0), (x + 34, foot), dark, -1)
        elif kind == 3:
            cv2.rectangle(canvas, (x, 80), (x + 100, 150), tint, -1)
            cv2.putText(canvas, str(slot), (x + 20, 135), cv2.FONT_HERSHEY_SIMPLEX, 1.5, (40, 40, 40), 3)
        else:
            cv2.rectangle(canvas, (x + 36, 170), (x + 48, foot), (80, 60, 45), -1)
            cv2.ellipse(canvas, (x + 42, 130), (40, 55), 0, 0, 360, (60, 95, 60), -1)


def write_images(world: World, frames: list[int], folder: Path) -> None:
    """Write `NNNNNN.jpg` of these frames into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    painter = Painter.of(world)
    for frame in frames:
        bgr = cv2.cvtColor(painter.paint(frame), cv2.COLOR_RGB2BGR)
        done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        if not done:
            raise InputError(f"the panorama of {world.name} frame {frame} cannot be encoded", frame=f"{frame:06d}")
        (folder / f"{frame:06d}.jpg").write_bytes(data.tobytes())
