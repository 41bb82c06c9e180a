"""`labels_2d_panoptic_stitched_CW/<sequence>.json`: every pixel of the keyframes, from the strokes that paint it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import msgspec

from jrdb_avr.schema.panorama import HEIGHT, WIDTH
from jrdb_avr.schema.rules import KEYFRAME_STEP
from jrdb_avr.schema.things import OBJECTS

from .render import Painter
from .rle import Segment, segments_of
from .world import World, rng_of

STUFF: Final = frozenset(
    ("road", "terrain", "sky", "vegetation", "wall", "column", "building", "stair", "ceiling", "barrier/fence", "glass")
)
_FEW: Final = 12
"""Pixels: a smaller rest of something is not annotated."""


def category_ids(world: World) -> list[int]:
    """The file's number of each category of `schema.things.OBJECTS`: every file has its own."""
    return [int(one) + 1 for one in rng_of(world.seed, world.name, "categories").permutation(len(OBJECTS))]


def panoptic_file(world: World) -> Iterator[bytes]:
    """The file's text, in parts."""
    painter = Painter.of(world)
    numbers = category_ids(world)
    spelled = _spelling(world.name)
    frames = range(0, world.frames, KEYFRAME_STEP)
    # A keyframe that nobody got round to; the same number twice in another.
    skipped = frames[len(frames) // 2] if world.name.endswith("_1") else -1
    doubled = frames[len(frames) // 3] if world.name.endswith("_3") else -1
    names = _names(world, painter)
    yield b'{"categories":'
    yield msgspec.json.encode(
        [{"id": numbers[k], "name": spelled(name), "isthing": int(name not in STUFF)} for k, name in enumerate(OBJECTS)]
    )
    yield b',"images":'
    yield msgspec.json.encode([_image(world.name, frame) for frame in frames])
    yield b',"annotations":['
    count = 0
    for frame in frames:
        if frame == skipped:
            continue
        rows = []
        for segment in segments_of(painter.segment(frame)):
            category, track = names[segment.id]
            if segment.area < _FEW:
                continue
            rows.append(_annotation(world.name, count, frame, segment, numbers[OBJECTS.index(category)], track))
            count += 1
        if frame == doubled:
            rows.append(rows[-1] | {"id": count})
            count += 1
        if rows:
            yield b"," * (count > len(rows)) + msgspec.json.encode(rows)[1:-1]
    yield b"]}"


def _names(world: World, painter: Painter) -> dict[int, tuple[str, int | None]]:
    """Category and tracking number (None for stuff) of each segment; numbers restart in every category."""
    used: dict[str, int] = {}
    for thing in world.things.things:
        used[thing.category] = max(used.get(thing.category, 0), thing.number)
    out: dict[int, tuple[str, int | None]] = {}

    def add(segment: int, category: str) -> None:
        if category in STUFF:
            out[segment] = category, None
            return
        used[category] = used.get(category, 0) + 1
        out[segment] = category, used[category]

    segments = painter.segments
    for place, category in enumerate(segments.surroundings):
        add(place + 1, category)
    out[segments.steps] = "stair", None
    for index in range(segments.panels):
        add(segments.panel(index), "wall_panel")
    for index, thing in enumerate(world.things.things):
        out[segments.thing(index)] = thing.category, thing.number
    for index, person in enumerate(world.people):
        out[segments.person(index)] = "pedestrian", person.track
    return out


def _spelling(sequence: str) -> Any:
    """How a file writes the names of categories."""
    if sequence.endswith("_2"):
        return str.upper
    if sequence.endswith("_3"):
        return lambda name: f"t_{name}"
    return str


def _image(sequence: str, frame: int) -> dict[str, Any]:
    name = f"image_stitched/{sequence}/{frame:06d}.jpg"
    return {"id": frame // KEYFRAME_STEP + 1, "file_name": name, "width": WIDTH, "height": HEIGHT}


def _annotation(
    sequence: str, number: int, frame: int, segment: Segment, category: int, track: int | None
) -> dict[str, Any]:
    out: dict[str, Any] = {
        "id": number,
        "image_id": frame // KEYFRAME_STEP + 1,
        "category_id": category,
        "segmentation": {"size": [HEIGHT, WIDTH], "counts": segment.counts},
        "area": segment.area,
        "bbox": list(segment.box),
        "iscrowd": 0,
    }
    if track is not None:
        # The tracking number's place in the files of different years.
        if sequence.endswith("_1"):
            out["attributes"] = {"tracking_id": track}
        elif sequence.endswith("_2"):
            out["attributes"] = {"floor_id": track}
        else:
            out["tracking_id"] = track
    return out
