"""Write the box files of a simulated sequence frame by frame: base 2D with actions and groups, and 3D.

The files state the truth of the world, with the annotators' habits of the real ones: hard labels (mostly of people who
are covered), dropouts, several spellings of one value, and at low rates each awkward case that these layers hold. None
of them states a wrong fact as certain.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from jrdb_avr.loaders.synthetic.script import NONE, POSE
from jrdb_avr.loaders.synthetic.world import FLOOR, World, spans
from jrdb_avr.schema.arrays import Bools, Ints
from jrdb_avr.schema.labels import OCCLUSIONS, OTHER_ACTIONS, POSES
from jrdb_avr.schema.panorama import HEIGHT, WIDTH
from jrdb_avr.schema.rules import KEYFRAME_STEP

_Record = dict[str, Any]

HARD_CODE: Final = 3
ABSENT_PARTNER: Final = 9000
"""Number of a person without any other record."""


def drawn_difficulty(world: World) -> tuple[Ints, Ints]:
    """Difficulty of the actions (frames, people, 3: pose and the two others) and of the group (frames, people)."""
    rng = world.rng("difficulty")
    frames, count = world.present.shape
    # One draw per person, and action while it lasts: a label does not turn hard and back while nothing changes.
    draw = np.empty((frames, count, 4))
    states = [world.pose, world.actions[..., 0], world.actions[..., 1], world.cluster]
    for k, state in enumerate(states):
        changed = np.vstack([np.ones((1, count), bool), state[1:] != state[:-1]])
        fresh = rng.random((frames, count))
        last = np.maximum.accumulate(np.where(changed, np.arange(frames)[:, None], 0), axis=0)
        draw[..., k] = np.take_along_axis(fresh, last, axis=0)
    middle = np.floor(rng.random((int(world.tick[-1]) + 1, count))[world.tick] * 2).astype(np.int64) + 1
    hard_if = np.where(world.hidden[..., None], (0.52, 0.52, 0.52, 0.36), (0.05, 0.05, 0.05, 0.03))
    level = np.where(draw < hard_if, HARD_CODE, middle[..., None])
    return level[..., :3], level[..., 3]


class Quirks:
    """Records that are written in an awkward way. Each field is a (frames, people) mask or one draw per record."""

    def __init__(self, world: World) -> None:
        rng = world.rng("quirks")
        shape, hidden = world.present.shape, world.hidden
        everywhere = np.ones(shape, bool)
        bare = np.all(world.actions == NONE, axis=-1)
        self.number_form = rng.choice(3, size=shape, p=[0.90, 0.08, 0.02])
        self.truncated_form = rng.choice(4, size=shape, p=[0.70, 0.20, 0.05, 0.05])
        self.float_box = rng.random(shape) < 0.05
        self.past_seam: Bools = rng.random((shape[1],)) < 0.5
        self.no_occlusion = spans(rng, hidden, 0.0002, 1, 3)
        self.no_eval = spans(rng, hidden, 0.0004, 10, 40)
        self.no_eval_3d = spans(rng, hidden, 0.0015, 10, 40)
        # Without some of its members, the files would count a group as smaller than it is.
        single = np.array([len(world.parties[person.party].members) == 1 for person in world.people])
        self.no_group = spans(rng, hidden, 0.0005, 5, 30) & (world.apart | single)
        # A list without the truth in it would deny what is true: only where there is nothing to deny but the pose.
        self.no_actions = spans(rng, hidden, 0.0004, 5, 20) & bare
        self.empty_actions = spans(rng, hidden, 0.0004, 5, 20) & bare
        self.impossible = spans(rng, hidden, 0.0004, 5, 20) & bare
        self.no_pose = spans(rng, hidden, 0.0002, 5, 20)
        self.two_poses = (world.pose == POSE["bending"]) & (rng.random((shape[1],)) < 0.06)
        self.spelling = spans(rng, everywhere, 0.0005, 5, 60)
        self.unknown_word = spans(rng, hidden, 0.0001, 5, 30)
        self.no_points = spans(rng, hidden, 0.003, 5, 30)
        self.no_distance = spans(rng, everywhere, 0.0003, 1, 10)
        self.no_3d = spans(rng, hidden, 0.0008, 5, 30)
        self.turns = rng.choice([-1, 0, 1], size=shape, p=[0.1, 0.8, 0.1])
        self.points_noise = rng.uniform(0.7, 1.3, shape)
        # A box cut at the image's edge, where the smaller part is a sliver; only of people who are hardly visible.
        self.sliver: Bools = hidden & (rng.random(shape) < 0.5)
        # File names inside differ from their keys, as in the 2022 train release.
        self.file_shift = 2 * world.named(0, 1)
        self.foreign = int(rng.integers(0, world.frames)) if world.named(1) else -1
        self.flat = int(rng.integers(0, world.frames)) if world.named(2) else -1
        self.lost_2d = (world.frames // 15 // 2) * 15 + 7 if world.named(2) else -1
        self.lost_3d = range(30, 33) if world.named(0) else range(0)
        self.empty_2d = world.frames - 2 if world.named(3) else -1
        self.empty_3d = 4 if world.named(2) else -1


_OTHER_SPELLINGS: Final = {
    "holding sth": "holding something",
    "looking at sth": "looking_at_sth",
    "looking into sth": "Looking into something",
    "interaction with door": "opening the door",
    "talking to someone": "talking-to-someone",
}


@dataclass(frozen=True)
class LabelFrame:
    """One frame of `labels_2d_stitched`: its key, the places of the people with a box, and a record for each of them.

    `foreign`: records of nobody. Box files with more in them hold the same records, extended.
    """

    frame: int
    key: str
    people: list[int]
    records: list[_Record]
    foreign: list[_Record]


def frames_2d(world: World, quirks: Quirks) -> Iterator[LabelFrame]:
    """Yield the frames of `labels_2d_stitched/<sequence>.json`, in order."""
    actions_level, group_level = drawn_difficulty(world)
    names = cluster_names(world)
    for frame in range(world.frames):
        if frame == quirks.lost_2d:
            continue
        rows: list[_Record] = []
        people = [] if frame == quirks.empty_2d else np.flatnonzero(world.boxed[frame]).tolist()
        boxes = world.boxes[frame].tolist()
        for i in people:
            box = _written_box(boxes[i], quirks, frame, i)
            record: _Record = {
                "label_id": f"pedestrian:{world.people[i].track}",
                "file_id": f"{frame + quirks.file_shift:06d}.jpg",
                "box": box,
                "attributes": _attributes(world, quirks, frame, i, box),
            }
            actions = _action_label(world, quirks, frame, i, actions_level[frame, i].tolist())
            if actions is not None:
                record["action_label"] = actions
            if not quirks.no_group[frame, i]:
                cluster = names[int(world.cluster[frame, i])]
                record["social_group"] = {"cluster_ID": cluster, "cluster_stat": int(group_level[frame, i])}
                if actions and not world.apart[frame, i] and len(world.parties[world.people[i].party].members) > 2:
                    record["social_activity"] = {POSES[int(world.pose[frame, i])]: 1.0}
            rows.append(record)
        foreign: list[_Record] = []
        if rows and frame == quirks.foreign:
            foreign = [{**rows[0], "label_id": "person:-1"}]
        elif rows and frame == quirks.flat:
            x, y, w, h = rows[0]["box"]
            flat_boxes = ([x, y, 0, h], [x, y, w, -h])
            foreign = [
                {**rows[0], "label_id": f"pedestrian:{ABSENT_PARTNER + k}", "box": b} for k, b in enumerate(flat_boxes)
            ]
        yield LabelFrame(frame, f"{frame:06d}.jpg", people, rows, foreign)


def cluster_names(world: World) -> list[int]:
    """Return the number that the files give to each cluster of the world.

    A party that comes after another one is gone may take its number again: people who never meet share it.
    """
    count = len(world.parties) + len(world.people)
    names: list[int] = world.rng("clusters").permutation(max(1000, count))[:count].tolist()
    in_view = [world.present[:, party.members].any(axis=1) for party in world.parties]
    gone = [int(np.flatnonzero(item)[-1]) if item.any() else world.frames for item in in_view]
    begun = [int(np.argmax(item)) if item.any() else -1 for item in in_view]
    free = list(range(len(world.parties)))
    for late, party in enumerate(world.parties):
        # The number of a party of one says nothing about a group.
        early = next((k for k in free if gone[k] < begun[late]), None) if len(party.members) == 1 else None
        if early is not None:
            names[late] = names[early]
            free = [k for k in free if k not in (early, late)]
    return names


def _written_box(box: list[int], quirks: Quirks, frame: int, i: int) -> list[float]:
    """Return a box as annotators write it: whole numbers or floats; over the seam with x < 0 or beyond 3760."""
    x, y, w, h = box
    x %= WIDTH
    if x + w > WIDTH:
        inside = WIDTH - x
        if quirks.sliver[frame, i] and min(inside, w - inside) <= 10:
            return [x, y, inside, h] if inside <= w - inside else [0, y, w - inside, h]
        if not quirks.past_seam[i]:
            x -= WIDTH
    if quirks.float_box[frame, i]:
        return [float(x), float(y), float(w), float(h)]
    return [x, y, w, h]


def _attributes(world: World, quirks: Quirks, frame: int, i: int, box: list[float]) -> _Record:
    out: _Record = {
        "area": float(box[2] * box[3]),
        "interpolated": frame % KEYFRAME_STEP != 0,
        "no_eval": bool(quirks.no_eval[frame, i]),
    }
    if not quirks.no_occlusion[frame, i]:
        cut = box[1] <= 0 or box[1] + box[3] >= HEIGHT
        out["occlusion"] = OCCLUSIONS[int(world.occlusion[frame, i])]
        form = int(quirks.truncated_form[frame, i])
        if form < 3:
            out["truncated"] = ("true" if cut else "false", cut, None)[form]
    return out


def _action_label(world: World, quirks: Quirks, frame: int, i: int, levels: list[int]) -> _Record | None:
    """Return the difficulty by name, or None if the key is missing."""
    if quirks.no_actions[frame, i]:
        return None
    if quirks.empty_actions[frame, i]:
        return {}
    if quirks.impossible[frame, i]:
        return {"impossible": 1}
    number = (int, float, str)[int(quirks.number_form[frame, i])]
    out: _Record = {}
    if not quirks.no_pose[frame, i]:
        out[POSES[int(world.pose[frame, i])]] = number(levels[0])
        if quirks.two_poses[frame, i]:
            out["standing"] = number(levels[0])
    for action, level in zip(world.actions[frame, i].tolist(), levels[1:], strict=True):
        if action != NONE:
            name = OTHER_ACTIONS[action]
            out[_OTHER_SPELLINGS.get(name, name) if quirks.spelling[frame, i] else name] = number(level)
    if quirks.unknown_word[frame, i]:
        out["waiting for sth"] = number(2)
    return out


def lidar_points(world: World, quirks: Quirks) -> Ints:
    """Return the number of lidar points on each body, (frames, people)."""
    # A box has some points even if no camera sees the person, because the lidars are at another place.
    visible = np.maximum(1.0 - world.covered, 0.02)
    # They thin out with the square of the distance.
    points = np.round(9000 * world.height * world.width * visible / world.distance**2 * quirks.points_noise)
    return np.where(quirks.no_points, 0, np.maximum(points, 1)).astype(np.int64)


def frames_3d(world: World, quirks: Quirks) -> Iterator[tuple[str, list[_Record]]]:
    """Yield keys and records of `labels_3d/<sequence>.json`, in order."""
    motion, points = world.motion, lidar_points(world, quirks)
    turned = np.pi - motion.heading + 2 * np.pi * quirks.turns
    middle = FLOOR + motion.z + world.height / 2
    columns = (motion.x, motion.y, middle, world.width, world.width, world.height, turned, world.distance)
    table = np.round(np.stack(columns, axis=-1), 3)
    boxed_people = world.present & ~quirks.no_3d
    for frame in range(world.frames):
        if frame in quirks.lost_3d:
            continue
        rows: list[_Record] = []
        indexes = table[frame].tolist()
        for i in [] if frame == quirks.empty_3d else np.flatnonzero(boxed_people[frame]).tolist():
            *box, distance = indexes[i]
            attributes: _Record = {
                "distance": None if quirks.no_distance[frame, i] else distance,
                "interpolated": True,
                "no_eval": bool(quirks.no_eval_3d[frame, i]),
                "num_points": int(points[frame, i]),
            }
            rows.append(
                {
                    "label_id": f"pedestrian:{world.people[i].track}",
                    "file_id": f"{frame + quirks.file_shift:06d}.pcd",
                    "box": dict(zip(("cx", "cy", "cz", "l", "w", "h", "rot_z"), box, strict=True)),
                    "attributes": attributes,
                }
            )
        yield f"{frame:06d}.pcd", rows
