"""`labels_2d_panoptic_stitched_CW/<sequence>.json`: every pixel of the keyframes, from the strokes that paint it.

`labels_2d_pose_stitched_coco/<sequence>.json`: seventeen keypoints of the figures that are drawn.

Run-length codes of the segments of a picture, in the compressed text of COCO files.

Counts go down the columns, left to right, and begin with the pixels before the first run. From the third on, the
difference from the count two before is written, five bits per character, lowest first; the sixth bit says that more
follow, and the highest of the last five is the sign.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.box_files import annotated, occlusion, spans
from jrdb_avr.loaders.synthetic.pictures import Painter
from jrdb_avr.loaders.synthetic.skeleton import JOINTS, L_EYE, LEFT_SIDE, R_EYE, RIGHT_SIDE
from jrdb_avr.loaders.synthetic.world import World, rng_of, turned
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.labels import OBJECTS
from jrdb_avr.schema.panorama import HEIGHT, WIDTH
from jrdb_avr.schema.rules import KEYFRAME_STEP

_EDGES: Final = (
    *((1, 2), (0, 4), (3, 4), (8, 10), (5, 7), (10, 13), (14, 16), (4, 5)),
    *((7, 12), (4, 8), (3, 6), (13, 15), (11, 14), (6, 9), (8, 11)),
)
_SIDEWAYS: Final = 0.8
"""Seen so far from the side, the limbs behind the body are covered by it."""
_AWAY: Final = -0.25
"""Turned so far away, the eyes cannot be seen."""


def visibility(world: World) -> Ints:
    """(frames, people, 17): 0 not visible, 1 occluded, 2 visible."""
    side, toward = turned(world.motion)
    out = np.where(world.joint_covered, 1, 2)
    for limbs, behind in ((RIGHT_SIDE, side < -_SIDEWAYS), (LEFT_SIDE, side > _SIDEWAYS)):
        out[..., limbs] = np.where(behind[..., None], np.minimum(out[..., limbs], 1), out[..., limbs])
    eyes = [R_EYE, L_EYE]
    out[..., eyes] = np.where((toward < _AWAY)[..., None], 0, out[..., eyes])
    rows = world.joints[..., 1]
    return np.where((rows < 0) | (rows >= HEIGHT), 0, out).astype(np.int64)


def pose_file(world: World) -> Iterator[bytes]:
    """The file's text, in parts. Columns are those of the panorama; a pose over the seam has some at either edge."""
    rng = rng_of(world.seed, world.name, "poses")
    hidden = occlusion(world) >= 2
    posed = annotated(world) & (occlusion(world) < 3) & ~spans(rng, hidden, 0.004, 10, 60)
    bare = spans(rng, posed & hidden, 0.0004, 1, 3)
    shift = 1 + world.name.endswith(("_1", "_3"))
    # The last frame is missing in some files.
    frames = world.frames - world.name.endswith(("_0", "_2"))
    yield b'{"images":'
    yield msgspec.json.encode([_image(world.name, frame, shift) for frame in range(frames)])
    yield b',"annotations":['
    seen = visibility(world)
    number = 0
    for frame in range(frames):
        people = np.flatnonzero(posed[frame])
        points = np.empty((len(people), len(JOINTS), 3), np.int64)
        points[..., 2] = seen[frame, people]
        points[..., :2] = np.floor(world.joints[frame, people])
        points[..., 0] %= WIDTH
        points[..., :2] *= points[..., 2:] > 0
        rows = []
        told = np.count_nonzero(points[..., 2], axis=1).tolist()
        for i, keypoints, count in zip(people.tolist(), points.reshape(len(people), 51).tolist(), told, strict=True):
            row: dict[str, Any] = {
                "id": number,
                "image_id": frame + shift,
                "track_id": world.people[i].track,
                "category_id": 1,
                "keypoints": keypoints,
                "num_keypoints": count,
            }
            if bare[frame, i]:
                del row["keypoints"]
            rows.append(row)
            number += 1
        yield b"," * (number > len(rows) > 0) + msgspec.json.encode(rows)[1:-1]
    category = {"id": 1, "name": "person", "keypoints": JOINTS, "skeleton": [[a + 1, b + 1] for a, b in _EDGES]}
    yield b'],"categories":' + msgspec.json.encode([category]) + b"}"


def _image(sequence: str, frame: int, shift: int) -> dict[str, Any]:
    # The width is that of one camera, as in the published files.
    name = f"image_stitched/{sequence}/{frame:06d}.jpg"
    return {"id": frame + shift, "width": WIDTH // 5, "height": HEIGHT, "file_name": name}


class Segment(NamedTuple):
    """One segment's id in the picture, its code, pixels, and box (x, y, w, h)."""

    id: int
    counts: str
    area: int
    box: tuple[int, int, int, int]


def segments_of(picture: npt.NDArray[np.uint16]) -> list[Segment]:
    """Every segment of a picture (rows, columns) of ids, by id; 0 is no segment."""
    height = picture.shape[0]
    flat = np.ascontiguousarray(picture.T).ravel()
    first = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    length = np.diff(np.append(first, len(flat)))
    ids = flat[first].astype(np.int64)
    order = np.argsort(ids, kind="stable")
    ids, first, length = ids[order], first[order], length[order]
    starts = np.flatnonzero(np.concatenate([[True], ids[1:] != ids[:-1]]))
    ends = np.append(starts[1:], len(ids))
    # Of each run, the pixels before it since the run before, then its own.
    before = first.copy()
    before[1:] -= (first + length)[:-1]
    before[starts] = first[starts]
    pairs = np.stack([before, length], axis=1)
    last = first + length
    tail = len(flat) - last[ends - 1]
    top, bottom = first % height, (last - 1) % height
    # A run that goes on in the next column fills a column's end and the next one's begin.
    crosses = first // height != (last - 1) // height
    top, bottom = np.where(crosses, 0, top), np.where(crosses, height - 1, bottom)
    out = []
    for start, end, rest in zip(starts.tolist(), ends.tolist(), tail.tolist(), strict=True):
        if ids[start] == 0:
            continue
        counts = pairs[start:end].ravel()
        if rest:
            counts = np.append(counts, rest)
        x = int(first[start] // height)
        y = int(top[start:end].min())
        right, low = int((last[end - 1] - 1) // height), int(bottom[start:end].max())
        box = (x, y, right - x + 1, low - y + 1)
        out.append(Segment(int(ids[start]), compressed(counts), int(length[start:end].sum()), box))
    return out


def compressed(counts: Ints) -> str:
    """The text of run lengths."""
    values = counts.astype(np.int64).copy()
    values[3:] -= counts[1:-2]
    digits = []
    more = []
    rest = values
    # Six times five bits hold any count of a panorama.
    for _ in range(6):
        digit = rest & 31
        rest = rest >> 5
        ended = np.where(digit & 16, rest == -1, rest == 0)
        digits.append(digit)
        more.append(~ended)
    digit_table = np.stack(digits, axis=1)
    more_table = np.stack(more, axis=1)
    # A character is written while all before it said that more follow.
    written = np.ones_like(more_table)
    written[:, 1:] = np.logical_and.accumulate(more_table[:, :-1], axis=1)
    text = (digit_table | np.where(more_table, 32, 0)) + 48
    return bytes(text[written].astype(np.uint8)).decode("ascii")


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
    yield msgspec.json.encode([_image_panoptic(world.name, frame) for frame in frames])
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


def _image_panoptic(sequence: str, frame: int) -> dict[str, Any]:
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
