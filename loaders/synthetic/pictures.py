"""Panoramas of a simulated sequence, from the farthest to the nearest: surroundings, partitions, things and people with
their marks. The same strokes, with numbers for colours, give the segments of the panoptic layer.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.backdrop import Backdrop, backdrop
from jrdb_avr.loaders.synthetic.bonds import shown
from jrdb_avr.loaders.synthetic.box_files import annotated
from jrdb_avr.loaders.synthetic.figures import BODY, Color, Figure, Pen, draw_figure, look_of
from jrdb_avr.loaders.synthetic.furniture import draw_thing
from jrdb_avr.loaders.synthetic.objects import BELOW, at_tick
from jrdb_avr.loaders.synthetic.script import NONE
from jrdb_avr.loaders.synthetic.skeleton import facing
from jrdb_avr.loaders.synthetic.world import FARTHEST, FLOOR, World, body_rows, rng_of, turned
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import INTERACTIONS, OTHER_ACTIONS, POSES, VERBS
from jrdb_avr.schema.markers import ALONE, HEADING_STEP, MAX_DISTANCE_DM, MAX_GROUP, Mark, draw
from jrdb_avr.schema.panorama import FOCAL_ROWS, WIDTH, Box, row_of_height
from jrdb_avr.schema.rules import KEYFRAME_STEP

Image = npt.NDArray[np.uint8]

QUALITY: Final = 92
"""JPEG quality of the panoramas."""

_PERSON, _PANEL, _THING = range(3)
_Carried = dict[int, list[tuple[int, str, int]]]
"""Per person, (hand or BELOW, category, thing) of what is drawn with the figure."""
STEPS: Final = -2
"""The part of a drawing that is the stairs below a person."""

_PANELS: Final[tuple[Color, ...]] = ((96, 84, 70), (70, 84, 100), (84, 96, 80), (100, 78, 84))


def image_frames(world: World, which: str) -> list[int]:
    """Frames that get a panorama.

    `none`; `keyframes`; `changes`: keyframes, and of every tick but the first the first frame and the one before, so
    that they do not tell at which of them anything changes; `all`.
    """
    keyframes = range(0, world.frames, KEYFRAME_STEP)
    if which == "changes":
        starts = world.starts[1:-1]
        return sorted({*keyframes, *starts.tolist(), *(starts - 1).tolist()})
    return list({"none": range(0), "keyframes": keyframes, "all": range(world.frames)}[which])


def marks_of(world: World, labelled: Bools, frame: int) -> dict[int, Mark]:
    """What the marks of the people present say at a frame: the truth of the world, by place in `world.people`.

    A group counts the people `labelled` (frames, people): one left alone by the annotators' dropouts is alone.
    """
    out = {}
    here = np.flatnonzero(world.present[frame])
    clusters = world.cluster[frame, here].tolist()
    counted = world.cluster[frame, labelled[frame]].tolist()
    tick = int(world.tick[frame])
    partners = shown(world.bonds, tick, here[labelled[frame, here]])
    handled = {person: row for person, *row in reversed(at_tick(world.things.handling, tick))}
    for i, cluster in zip(here.tolist(), clusters, strict=True):
        person = world.people[i]
        heading = np.degrees(world.motion.heading[frame, i])
        distance = round(float(world.distance[frame, i]) * 10)
        mark = Mark(
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
        if i in partners:
            partner, label = partners[i]
            mark = replace(mark, partner=world.people[partner].identity, interaction=INTERACTIONS[label])
        if i in handled:
            thing, verb, _ = handled[i]
            mark = replace(mark, object=world.things.things[thing].category, verb=VERBS[verb])
        out[i] = mark
    return out


def _place(action: str) -> int:
    return OTHER_ACTIONS.index(action)


@dataclass(frozen=True)
class Segments:
    """Numbers of what is drawn in a sequence: the surroundings first, as in `Backdrop.ids`, then steps, partitions,
    things and people."""

    surroundings: tuple[str, ...]
    panels: int
    things: int

    @property
    def steps(self) -> int:
        return len(self.surroundings) + 1

    def panel(self, index: int) -> int:
        return self.steps + 1 + index

    def thing(self, index: int) -> int:
        return self.panel(self.panels) + index

    def person(self, index: int) -> int:
        return self.thing(self.things) + index


@dataclass(frozen=True)
class Painter:
    """Paints the frames of one world; the surroundings are made once and turned with the robot."""

    world: World
    labelled: Bools
    backdrop: Backdrop
    panel_colors: tuple[Color, ...]
    segments: Segments
    facing: tuple[Floats, Floats]

    @classmethod
    def of(cls, world: World) -> Painter:
        rng = rng_of(world.seed, world.name, "colors")
        colors = tuple(_PANELS[int(rng.integers(len(_PANELS)))] for _ in world.panels)
        around = backdrop(rng)
        segments = Segments(around.categories, len(world.panels), len(world.things.things))
        return cls(world, annotated(world), around, colors, segments, facing(world.pose, *turned(world.motion)))

    def paint(self, frame: int) -> Image:
        """The panorama (480, 3760, 3), RGB."""
        image: Image = np.roll(self.backdrop.image, self._turn(frame), axis=1)
        marks = marks_of(self.world, self.labelled, frame)
        carried = self._carried(frame)
        for kind, index in self._from_far(frame):
            self._draw(image, frame, kind, index, _as_color, carried)
            # Who has no box in the labels carries no mark: nothing could be asked or told of it.
            if kind == _PERSON and self.labelled[frame, index]:
                x, y, w, h = self.world.boxes[frame, index].tolist()
                draw(image, Box(x, y, w, h), marks[index])
        return image

    def segment(self, frame: int) -> npt.NDArray[np.uint16]:
        """The number of the segment (see `Segments`) at every pixel, (480, 3760)."""
        image = np.roll(self.backdrop.ids, self._turn(frame), axis=1)
        carried = self._carried(frame)
        for kind, index in self._from_far(frame):
            self._draw(image, frame, kind, index, self._numbering(kind, index), carried)
        return image

    def _turn(self, frame: int) -> int:
        # Turning left by yaw moves what is far to the right by as much.
        return round(float(self.world.motion.robot[frame, 2]) / (2 * np.pi) * WIDTH)

    def _numbering(self, kind: int, index: int) -> Pen:
        own = self.segments.person(index) if kind == _PERSON else self.segments.panel(index)

        def pen(color: Color, part: int) -> Color:
            number = self.segments.thing(part) if part >= 0 else self.segments.steps if part == STEPS else own
            return (number, number, number)

        return pen

    def _from_far(self, frame: int) -> list[tuple[int, int]]:
        """(kind, place) of everything there is at a frame."""
        world = self.world
        there = [(float(world.distance[frame, i]), _PERSON, i) for i in np.flatnonzero(world.present[frame]).tolist()]
        there += [(float(d), _PANEL, k) for k, d in enumerate(world.panel_distance[frame].tolist())]
        there += [(d, _THING, k) for k, d in enumerate(world.thing_distance[frame].tolist()) if d < FARTHEST]
        return [(kind, index) for _, kind, index in sorted(there, reverse=True)]

    def _draw(self, image: npt.NDArray[Any], frame: int, kind: int, index: int, pen: Pen, carried: _Carried) -> None:
        if kind == _PERSON:
            self._person(image, frame, index, pen, carried.get(index, []))
        elif kind == _PANEL:
            self._panel(image, frame, index, pen)
        else:
            thing = self.world.things.stands[index]
            x, y, w, h = self.world.thing_boxes[frame, index].tolist()
            for left in _copies(x, w):
                draw_thing(image, self.world.things.things[thing].category, (left, y, w, h), pen, thing)

    def _panel(self, image: npt.NDArray[Any], frame: int, index: int, pen: Pen) -> None:
        x, y, w, h = self.world.panel_boxes[frame, index].tolist()
        color = self.panel_colors[index]
        edge = pen((color[0] - 30, color[1] - 30, color[2] - 30), BODY)
        poster = pen((color[0] + 25, color[1] + 30, color[2] + 20), BODY)
        for left in _copies(x, w):
            cv2.rectangle(image, (left, y), (left + w, y + h), pen(color, BODY), -1)
            cv2.rectangle(image, (left, y), (left + w, y + h), edge, 2)
            for part in range(1, 5):
                at = left + w * part // 5
                cv2.line(image, (at, y), (at, y + h), edge, 1)
                cv2.rectangle(
                    image, (at - w // 7, y + h // 6), (at - w // 16, y + h // 2), poster if part % 2 else edge, -1
                )

    def _person(self, image: npt.NDArray[Any], frame: int, i: int, pen: Pen, mine: list[tuple[int, str, int]]) -> None:
        world = self.world
        x, _, w, _ = world.boxes[frame, i].tolist()
        distance = float(world.distance[frame, i])
        top, bottom = (
            round(row) for row in body_rows(world.motion.z[frame, i], world.distance[frame, i], world.height[frame, i])
        )
        ground = round(row_of_height(FLOOR, distance))
        for left in _copies(x, w):
            if pen is _as_color:
                _shadow(image, left, ground, w)
            if ground - bottom > 1:
                _steps(image, left, bottom, w, ground - bottom, pen)
            figure = Figure(
                left,
                top,
                w,
                bottom - top,
                POSES[int(world.pose[frame, i])],
                world.joints[frame, i] + np.array([left - x, 0.0]),
                FOCAL_ROWS / distance,
                float(self.facing[0][frame, i]),
                float(self.facing[1][frame, i]),
                look_of(world.people[i].identity),
                next((thing for hand, _, thing in mine if hand == BELOW), BODY),
                tuple(held for held in mine if held[0] != BELOW),
            )
            draw_figure(image, figure, pen)

    def _carried(self, frame: int) -> _Carried:
        out: _Carried = {}
        for person, thing, _, hand in at_tick(self.world.things.handling, int(self.world.tick[frame])):
            one = self.world.things.things[thing]
            if not one.standing:
                out.setdefault(person, []).append((hand, one.category, thing))
        return out


def _as_color(color: Color, part: int) -> Color:
    """The pen of pictures."""
    return color


def _copies(x: int, w: int) -> list[int]:
    """Left columns of the copies of a thing that touch the image."""
    start = x % WIDTH
    return [start, start - WIDTH] if start + w > WIDTH else [start]


def _shadow(image: npt.NDArray[Any], x: int, ground: int, w: int) -> None:
    cv2.ellipse(image, (x + w // 2, ground - 1), (max(1, w // 2), max(1, w // 8)), 0, 0, 360, (62, 58, 54), -1)


def _steps(image: npt.NDArray[Any], x: int, y: int, w: int, h: int, pen: Pen) -> None:
    cv2.rectangle(image, (x, y), (x + w - 1, y + h), pen((104, 100, 96), STEPS), -1)
    for row in range(y, y + h, max(3, h // 5)):
        cv2.line(image, (x, row), (x + w - 1, row), pen((74, 70, 68), STEPS), 1)


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
