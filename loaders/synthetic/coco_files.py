"""Write the COCO files of a simulated sequence: keypoints of the figures, and panoptic segments of the keyframes.

`labels_2d_pose_stitched_coco/<sequence>.json` holds seventeen keypoints of each figure that is drawn.
`labels_2d_panoptic_stitched_CW/<sequence>.json` holds every pixel of the keyframes, from the strokes that paint it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from jrdb_avr.loaders.synthetic.box_files import _Record
from jrdb_avr.loaders.synthetic.pictures import Painter
from jrdb_avr.loaders.synthetic.skeleton import AWAY, JOINTS, L_EYE, LEFT_SIDE, R_EYE, RIGHT_SIDE
from jrdb_avr.loaders.synthetic.world import World, spans
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.labels import SKELETON
from jrdb_avr.schema.panorama import HEIGHT, WIDTH
from jrdb_avr.schema.rules import KEYFRAME_STEP
from jrdb_avr.schema.things import OBJECTS

_PERSON: Final = {"id": 1, "name": "person", "keypoints": JOINTS, "skeleton": [[a + 1, b + 1] for a, b in SKELETON]}
_SIDEWAYS: Final = 0.8
"""Minimum turn from the robot if the body covers the limbs behind it."""
STUFF: Final = frozenset(
    ("road", "terrain", "sky", "vegetation", "wall", "column", "building", "stair", "ceiling", "barrier/fence", "glass")
)
_FEW: Final = 12
"""Minimum number of pixels of an annotated segment."""


def _coco_text(before: _Record, annotations: Iterable[list[_Record]], after: _Record) -> Iterator[bytes]:
    """Yield a file's text in parts: the keys before the annotations, the annotations by frame, and the keys after."""
    yield msgspec.json.encode(before)[:-1] + b',"annotations":['
    count = 0
    for rows in annotations:
        numbered = [{"id": count + k, **row} for k, row in enumerate(rows)]
        yield b"," * (count > 0 and bool(rows)) + msgspec.json.encode(numbered)[1:-1]
        count += len(rows)
    yield b"]" + b"," * bool(after) + msgspec.json.encode(after)[1:]


def _file_name(world: World, frame: int) -> str:
    return f"image_stitched/{world.name}/{frame:06d}.jpg"


def visibility(world: World) -> Ints:
    """Return the visibility of joints, (frames, people, 17): 0 not visible, 1 occluded, 2 visible."""
    side, toward = world.turned
    out = np.where(world.joint_covered, 1, 2)
    for limbs, behind in ((RIGHT_SIDE, side < -_SIDEWAYS), (LEFT_SIDE, side > _SIDEWAYS)):
        out[..., limbs] = np.where(behind[..., None], 1, out[..., limbs])
    out[..., [R_EYE, L_EYE]] *= (toward >= AWAY)[..., None]
    rows = world.joints[..., 1]
    return np.where((rows < 0) | (rows >= HEIGHT), 0, out).astype(np.int64)


def pose_file(world: World) -> Iterator[bytes]:
    """Yield the file's text in parts. Columns are panorama columns. A pose over the seam has some at each edge."""
    shift = 1 + world.named(1, 3)
    # The last frame is missing in some files.
    frames = range(world.frames - world.named(0, 2))
    # The width is that of one camera, as in the published files.
    size = {"width": WIDTH // 5, "height": HEIGHT}
    images = [{"id": frame + shift, **size, "file_name": _file_name(world, frame)} for frame in frames]
    return _coco_text({"images": images}, _poses(world, frames, shift), {"categories": [_PERSON]})


def _poses(world: World, frames: range, shift: int) -> Iterator[list[_Record]]:
    rng = world.rng("poses")
    posed = world.boxed & (world.occlusion < 3) & ~spans(rng, world.hidden, 0.004, 10, 60)
    bare = spans(rng, posed & world.hidden, 0.0004, 1, 3)
    shown = visibility(world)
    for frame in frames:
        people = np.flatnonzero(posed[frame])
        points = np.empty((len(people), len(JOINTS), 3), np.int64)
        points[..., 2] = shown[frame, people]
        points[..., :2] = np.floor(world.joints[frame, people])
        points[..., 0] %= WIDTH
        points[..., :2] *= points[..., 2:] > 0
        rows: list[_Record] = []
        for i, keypoints in zip(people.tolist(), points.reshape(len(people), 51).tolist(), strict=True):
            row = {"image_id": frame + shift, "track_id": world.people[i].track, "category_id": 1}
            labelled = {} if bare[frame, i] else {"keypoints": keypoints}
            rows.append({**row, **labelled, "num_keypoints": sum(value > 0 for value in keypoints[2::3])})
        yield rows


def segments_of(picture: npt.NDArray[np.uint16]) -> Iterator[tuple[int, _Record]]:
    """Yield the id of each segment of a picture (rows, columns) of ids, and its mask, number of pixels and box."""
    height = picture.shape[0]
    flat = np.ascontiguousarray(picture.T).ravel()
    first = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    last = np.append(first[1:], len(flat)) - 1
    ids = flat[first].astype(np.int64)
    order = np.argsort(ids, kind="stable")
    for runs in np.split(order, np.flatnonzero(np.diff(ids[order])) + 1):
        begin, end = first[runs], last[runs]
        # Of each run, the pixels before it since the run before, then its own; at the end those after the last.
        counts = np.diff(np.stack([begin, end + 1], axis=1).ravel(), prepend=0, append=len(flat))
        # A run that goes on in the next column fills a column's end and the next one's begin.
        crosses = begin // height != end // height
        x, y = int(begin[0] // height), int(np.where(crosses, 0, begin % height).min())
        right, low = int(end[-1] // height), int(np.where(crosses, height - 1, end % height).max())
        text = compressed(counts if counts[-1] else counts[:-1])
        mask, box = {"size": [HEIGHT, WIDTH], "counts": text}, [x, y, right - x + 1, low - y + 1]
        yield int(ids[runs[0]]), {"segmentation": mask, "area": int(counts[1::2].sum()), "bbox": box}


def compressed(counts: Ints) -> str:
    """Return run lengths in the compressed text of COCO files.

    Counts go down the columns, left to right, and begin with the pixels before the first run. From the third on, the
    difference from the count two before is written, five bits per character, lowest first; the sixth bit means that
    more follow, and the highest of the last five is the sign.
    """
    values = counts.copy()
    values[3:] -= counts[1:-2]
    # Six times five bits hold any count of a panorama.
    shifted = values[:, None] >> np.arange(0, 35, 5)
    digits, rest = shifted[:, :-1] & 31, shifted[:, 1:]
    more = np.where(digits & 16, rest != -1, rest != 0)
    # A character is written while all before it announce more.
    written = np.ones_like(more)
    written[:, 1:] = np.logical_and.accumulate(more[:, :-1], axis=1)
    return bytes((digits + 32 * more + 48)[written].astype(np.uint8)).decode("ascii")


def category_ids(world: World) -> list[int]:
    """Return the file's number of each category of `labels.OBJECTS`. Each file has its own numbers."""
    return [int(item) + 1 for item in world.rng("categories").permutation(len(OBJECTS))]


def panoptic_file(world: World) -> Iterator[bytes]:
    """Yield the file's text in parts."""
    spell: Callable[[str], str] = str.upper if world.named(2) else "t_{}".format if world.named(3) else str
    categories = [
        {"id": number, "name": spell(name), "isthing": int(name not in STUFF)}
        for number, name in zip(category_ids(world), OBJECTS, strict=True)
    ]
    size = {"width": WIDTH, "height": HEIGHT}
    images = [
        {"id": frame // KEYFRAME_STEP + 1, "file_name": _file_name(world, frame), **size}
        for frame in range(0, world.frames, KEYFRAME_STEP)
    ]
    return _coco_text({"categories": categories, "images": images}, _segments(world), {})


def _segments(world: World) -> Iterator[list[_Record]]:
    painter, numbers = Painter(world), category_ids(world)
    names = _names(world, painter)
    frames = range(0, world.frames, KEYFRAME_STEP)
    # A keyframe that nobody annotated; a segment that is twice in another.
    skipped = frames[len(frames) // 2] if world.named(1) else -1
    doubled = frames[len(frames) // 3] if world.named(3) else -1
    for frame in frames:
        if frame == skipped:
            continue
        rows: list[_Record] = []
        for segment, mask in segments_of(painter.segment(frame)):
            category, track = names[segment]
            if mask["area"] >= _FEW:
                ids = {"image_id": frame // KEYFRAME_STEP + 1, "category_id": numbers[OBJECTS.index(category)]}
                rows.append({**ids, **mask, "iscrowd": 0, **_tracking(world, track)})
        yield rows + rows[-1:] * (frame == doubled)


def _tracking(world: World, track: int | None) -> _Record:
    """Return the tracking number under the key of the file's year."""
    if track is None:
        return {}
    if world.named(1, 2):
        return {"attributes": {"tracking_id" if world.named(1) else "floor_id": track}}
    return {"tracking_id": track}


def _names(world: World, painter: Painter) -> dict[int, tuple[str, int | None]]:
    """Return category and tracking number (None for stuff) of each segment. Each category has its own numbers."""
    used: dict[str, int] = {}
    for thing in world.things.things:
        used[thing.category] = max(used.get(thing.category, 0), thing.number)
    things, people = painter.things, painter.people
    out: dict[int, tuple[str, int | None]] = {painter.steps: ("stair", None)}
    around = enumerate(painter.surroundings, 1)
    for segment, category in (*around, *((panel, "wall_panel") for panel in range(painter.panels, things))):
        if category not in STUFF:
            used[category] = used.get(category, 0) + 1
        out[segment] = category, None if category in STUFF else used[category]
    out |= {things + k: (thing.category, thing.number) for k, thing in enumerate(world.things.things)}
    out |= {people + k: ("pedestrian", person.track) for k, person in enumerate(world.people)}
    return out
