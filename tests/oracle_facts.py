"""Every fact of every interval table, computed from the raw JSON by brute force.

Plain Python, frame by frame and person by person, following the definitions and sharing no code with what it checks:
constants and spellings are written out again. Slow, and meant to be read.

`facts(root, sequence)` returns {table: list of row dicts} in the columns of the interval tables.
"""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path

POSES = {
    "walking",
    "standing",
    "sitting",
    "cycling",
    "going upstairs",
    "going downstairs",
    "bending",
    "skating",
    "scootering",
    "running",
    "lying",
}
DOORS = {"opening the door", "pushing the door", "holding the door"}


def facts(root, sequence):
    return Oracle(Path(root), sequence).tables()


def _file(root, folder, sequence):
    for path in (root / "labels" / folder / f"{sequence}.json", root / folder / f"{sequence}.json"):
        if path.exists():
            return json.loads(path.read_text())["labels"]
    return None


def _code(value):
    """A difficulty 1..3, None if unreadable."""
    try:
        return int(float(value)) if float(value) in (1, 2, 3) else None
    except (TypeError, ValueError):
        return None


def step_of(frames):
    divisor = 0
    for a, b in pairwise(frames):
        divisor = math.gcd(divisor, b - a)
    return 15 if divisor % 15 == 0 else 1


class Oracle:
    def __init__(self, root, sequence):
        self.sequence = sequence
        self.people = {}  # (frame, track) -> 2D record
        self.known_2d = set()
        self.located = {}  # (frame, track) -> 3D record with points
        self.frames_3d = set()
        self.boxed = []  # (frame, track) of any box
        self._read_2d(_file(root, "labels_2d_stitched", sequence))
        self._read_3d(_file(root, "labels_3d", sequence))
        folder = root / "images" / "image_stitched" / sequence
        self.pictures = {int(p.stem) for p in folder.glob("*.jpg")} if folder.exists() else set()
        self.tracks = {}
        for frame, track in sorted(self.people):
            self.tracks.setdefault(frame, []).append(track)
        self.has_attributes = any("attributes" in r for r in self.people.values())
        self.actions = {key: self._actions(record) for key, record in self.people.items()}
        self.clusters = {}
        for key, record in self.people.items():
            group = record.get("social_group")
            if group is not None:
                self.clusters[key] = (group["cluster_ID"], _code(group["cluster_stat"]))
        self.action_frames = sorted({f for (f, _), names in self.actions.items() if names})
        self.group_frames = sorted({f for f, _ in self.clusters})
        self.keyframes = self._keyframes()

    # -- reading --

    def _read_2d(self, labels):
        for key, records in (labels or {}).items():
            frame, whole = int(key[:6]), True
            for record in records:
                prefix, _, number = record["label_id"].partition(":")
                if prefix != "pedestrian":
                    continue
                x, y, w, h = record["box"]
                if not (w > 0 and h > 0 and all(map(math.isfinite, (x, y, w, h)))):
                    whole = False
                elif (frame, int(number)) not in self.people:
                    self.people[frame, int(number)] = record
                    self.boxed.append((frame, int(number)))
            if whole:
                self.known_2d.add(frame)

    def _read_3d(self, labels):
        for key, records in (labels or {}).items():
            self.frames_3d.add(int(key[:6]))
            for record in records:
                place = int(key[:6]), int(record["label_id"].split(":")[1])
                self.boxed.append(place)
                if (record["attributes"].get("num_points") or 0) > 0:
                    self.located[place] = record

    @staticmethod
    def _actions(record):
        """{action: difficulty}; the easier of two spellings of one action, None only if no code is readable."""
        found = {}
        for name, value in (record.get("action_label") or {}).items():
            name = name.lower().replace("_", " ").replace("-", " ").strip()
            name = "interaction with door" if name in DOORS else name.replace(" something", " sth")
            if name != "impossible":
                found.setdefault(name, []).append(_code(value))
        return {name: min((c for c in codes if c is not None), default=None) for name, codes in found.items()}

    def _keyframes(self):
        base = self.action_frames or sorted(self.known_2d) or sorted(self.frames_3d)
        if not base:
            return []
        marks = base if step_of(base) == 15 else [f for f in range(base[0], base[-1] + 1) if f % 15 == 0]
        with_boxes = {f for f, _ in self.people}
        return [f for f in marks if f in self.known_2d or f not in with_boxes]

    # -- facts of one person in one frame --

    def certain(self, frame, track, action):
        listed = self.actions.get((frame, track), {})
        if listed.get(action) not in (1, 2):
            return False
        return action not in POSES or len(POSES & set(listed)) == 1

    def gap(self, frame, track, action):
        """Inside a closed gap: listed at most seven frames apart on both sides, at one frame per step."""
        if not self.action_frames or step_of(self.action_frames) == 15:
            return False
        if action in self.actions.get((frame, track), {}):
            return False
        return self._closed(frame, lambda f: action in self.actions.get((f, track), {}))

    @staticmethod
    def _closed(frame, listed):
        before = next((d for d in range(1, 9) if listed(frame - d)), None)
        after = next((d for d in range(1, 9) if listed(frame + d)), None)
        return before is not None and after is not None and before + after - 1 <= 7

    def state(self, frame, track, action):
        """true, false or unknown."""
        if self.gap(frame, track, action):
            return "unknown"
        listed = self.actions.get((frame, track), {})
        if not listed:
            return "unknown"
        if action in listed:
            return "true" if self.certain(frame, track, action) else "unknown"
        if action in POSES and self.pose(frame, track) is None:
            return "unknown"
        return "false"

    def pose(self, frame, track):
        poses = [a for a in self.actions.get((frame, track), {}) if a in POSES]
        return poses[0] if len(poses) == 1 and self.certain(frame, track, poses[0]) else None

    def clear(self, frame, track):
        record = self.people.get((frame, track))
        if record is None:
            return False
        _, y, w, h = record["box"]
        attributes = record.get("attributes") or {}
        visible = not self.has_attributes or attributes.get("occlusion") in ("Fully_visible", "Mostly_visible")
        fits = y >= 0 and y + h <= 480 and 12 <= w <= 480 and h >= 40
        return visible and fits and attributes.get("no_eval") is not True

    def angle(self, frame, track):
        x, _, w, _ = self.people[frame, track]["box"]
        return ((x + w / 2) / 3760 * 360) % 360

    def in_frame(self, frame):
        return self.tracks.get(frame, [])

    def group_size(self, frame, track):
        people = self.in_frame(frame)
        if frame not in self.known_2d or any((frame, t) not in self.clusters for t in people):
            return None
        mine = [self.clusters[frame, t] for t in people if self.clusters[frame, t][0] == self.clusters[frame, track][0]]
        return len(mine) if all(code in (1, 2) for _, code in mine) else None

    # -- tables --

    def tables(self):
        result = {
            "sequence": self._sequence(),
            "frames": self._frames(),
            "persons": self._persons(),
            "sightings": [self._sighting(f, t) for f, t in sorted(self.people)],
            "actions": self._action_intervals(),
            "memberships": self._membership_intervals(),
            "beside": self._robot_view() + self._person_frame(),
            "segments": self._segments(),
        }
        return {name: [{"sequence": self.sequence, **row} for row in rows] for name, rows in result.items()}

    def _sequence(self):
        layers = {
            "2d": self.known_2d,
            "actions": self.action_frames,
            "groups": self.group_frames,
            "3d": self.frames_3d,
            "images": self.pictures,
        }
        leading = self.action_frames or sorted(self.known_2d) or sorted(self.frames_3d)
        return [
            {
                "fps": 15.0,
                "frame_count": max(self._all_frames()) + 1,
                "layers": [name for name, frames in layers.items() if frames],
                "action_step": step_of(leading),
                "keyframes": self.keyframes,
                "has_attributes": self.has_attributes,
            }
        ]

    def _all_frames(self):
        return sorted(self.known_2d | self.frames_3d | self.pictures | {f for f, _ in self.people})

    def _frames(self):
        return [
            {
                "frame": f,
                "seconds": f / 15,
                "keyframe": f in self.keyframes,
                "annotated": f in self.known_2d,
                "image": f in self.pictures,
            }
            for f in self._all_frames()
        ]

    def _persons(self):
        rows = []
        for track in sorted({t for _, t in self.boxed}):
            frames = [f for f, t in self.boxed if t == track]
            rows.append(
                {"track": track, "gender": None, "age": None, "first_frame": min(frames), "last_frame": max(frames)}
            )
        return rows

    def _sighting(self, frame, track):
        record = self.people[frame, track]
        attributes = record.get("attributes") or {}
        angle = self.angle(frame, track)
        sectors = robot_sectors(angle)
        row = {
            "frame": frame,
            "track": track,
            **dict(zip("xywh", map(float, record["box"]), strict=True)),
            "angle": angle,
            "occlusion": attributes.get("occlusion"),
            "no_eval": attributes.get("no_eval") is True,
            "clear": self.clear(frame, track),
            "face_visible": None,
            "listed": bool(self.actions[frame, track]),
            "pose": self.pose(frame, track),
            "cluster": self.clusters.get((frame, track), (None,))[0],
            "group_size": self.group_size(frame, track),
            "sector": sectors[0],
            "sector_other": sectors[1],
            "located": (frame, track) in self.located,
        }
        empty = dict.fromkeys(("distance", "distance_word", "distance_word_other", "cx", "cy", "cz", "heading"))
        if not row["located"]:
            return row | empty
        solid = self.located[frame, track]
        box = solid["box"]
        distance = solid["attributes"].get("distance")
        distance = math.hypot(box["cx"], box["cy"]) if distance is None else distance
        words = distance_words(distance)
        heading = math.pi - box["rot_z"]
        return row | {
            "distance": distance,
            "distance_word": words[0],
            "distance_word_other": words[1],
            **{name: box[name] for name in ("cx", "cy", "cz")},
            "heading": math.atan2(math.sin(heading), math.cos(heading)),
        }

    def _action_intervals(self):
        if not self.action_frames:
            return []
        step = step_of(self.action_frames)
        rows = []
        for track in sorted({t for _, t in self.people}):
            names = {a for (_, t), listed in self.actions.items() if t == track for a in listed}
            for action in sorted(names):

                def kind(frame, track=track, action=action):
                    listed = self.actions.get((frame, track), {})
                    if action in listed:
                        return "certain" if self.certain(frame, track, action) else "hard"
                    return "gap" if self.gap(frame, track, action) else None

                for first, last, what in _chains(self.action_frames, step, kind):
                    codes = [self.actions.get((f, track), {}).get(action) for f in range(first, last + 1, step)]
                    difficulty = None if what == "gap" or None in codes else max(codes)
                    rows.append(
                        {"track": track, "action": action, **_span(first, last), "difficulty": difficulty}
                        | {"certain": what == "certain", "gap": what == "gap"}
                    )
        return rows

    def _membership_intervals(self):
        if not self.group_frames:
            return []
        step = step_of(self.group_frames)
        rows = []
        for track, cluster in sorted({(t, c[0]) for (_, t), c in self.clusters.items()}):

            def member(frame, track=track, cluster=cluster):
                return self.clusters.get((frame, track), (None, None))[0] == cluster

            def kind(frame, track=track, member=member):
                if member(frame):
                    return "certain" if self.clusters[frame, track][1] in (1, 2) else "hard"
                return "gap" if step == 1 and self._closed(frame, member) else None

            for first, last, what in _chains(self.group_frames, step, kind):
                rows.append(
                    {"track": track, "cluster": cluster, **_span(first, last)}
                    | {"certain": what == "certain", "gap": what == "gap"}
                )
        return rows

    def _robot_view(self):
        rows = []
        for frame in self.keyframes:
            people = self.in_frame(frame)
            for source in people:
                for side in ("left", "right"):
                    rows += self._first_met(frame, source, side, [t for t in people if t != source])
        return rows

    def _first_met(self, frame, source, side, others):
        here = self.angle(frame, source)
        turns = {}
        for other in others:
            there = self.angle(frame, other)
            turns[other] = (here - there) % 360 if side == "left" else (there - here) % 360
        could = []
        settled = None
        for other in sorted(others, key=lambda t: turns[t]):
            if settled is not None:
                if turns[other] < turns[settled] + 1:
                    could.append(other)
            elif turns[other] <= 60:
                could.append(other)
                if turns[other] >= 1 and self.clear(frame, other):
                    settled = other
        # Sorting may put an equal turn before the one that settles it; it was added either way.
        certain = settled is not None and len(could) == 1
        label = f"first to the {side} of (robot view)"
        return [
            {"source": source, "target": t, "label": label, **_span(frame, frame), "certain": certain} for t in could
        ]

    def _person_frame(self):
        seen = {}  # (source, target, label, certain) -> frames
        for frame in self.keyframes:
            people = [t for f, t in self.located if f == frame]
            for source in people:
                for target in people:
                    if source == target:
                        continue
                    labels, certain = self._beside(frame, source, target)
                    for label in labels:
                        seen.setdefault((source, target, label, certain), set()).add(frame)
        rows = []
        for (source, target, label, certain), frames in seen.items():
            for frame in sorted(frames):
                if frame - 15 in frames:
                    continue
                last = frame
                while last + 15 in frames:
                    last += 15
                rows.append(
                    {"source": source, "target": target, "label": label, **_span(frame, last), "certain": certain}
                )
        return rows

    def _beside(self, frame, source, target):
        a, b = self.located[frame, source]["box"], self.located[frame, target]["box"]
        dx, dy, dz = (b[k] - a[k] for k in ("cx", "cy", "cz"))
        metres = math.sqrt(dx * dx + dy * dy + dz * dz)
        if metres > 5.5:
            return [], False
        heading = math.pi - a["rot_z"]
        ahead = dx * math.cos(heading) + dy * math.sin(heading)
        left = dy * math.cos(heading) - dx * math.sin(heading)
        sectors = person_sectors(math.degrees(math.atan2(left, ahead)))
        words = [w for w in distance_words(metres) if w in ("very close", "close", "moderate")]
        certain = len(sectors) == 1 and len(words) == 1 and metres < 4.5 and abs(dz) <= 1.35
        return [f"{sector}, {word}" for sector in sectors for word in words], certain

    def _segments(self):
        if not self.action_frames:
            return []
        step = step_of(self.action_frames)
        low, high = self.action_frames[0], self.action_frames[-1]
        grid = range(low, high + 1, step)
        half = 7 if step == 15 else 0
        rows = []
        pairs = {(t, a) for (_, t), listed in self.actions.items() for a in listed}
        for track, action in sorted(pairs):
            state = {f: self.state(f, track, action) for f in grid}
            false_clear = {f: state[f] == "false" and self.clear(f, track) for f in grid}

            def inside(frame, track=track, action=action, state=state):
                true = state[frame] == "true" and self.clear(frame, track)
                return "run" if true or self.gap(frame, track, action) else None

            for first, last, _ in _chains(list(grid), step, inside):
                before = range(first - 15, first, step)
                after = range(last + step, last + 15 + 1, step)
                around = [*range(first - 45, first, step), *range(last + step, last + 45 + 1, step)]
                if last - first < 30 or not all(f in false_clear and false_clear[f] for f in before):
                    continue
                if any(state[f] != "false" for f in around if low <= f <= high):
                    continue
                quiet = first
                while quiet - step >= low and state[quiet - step] == "false":
                    quiet -= step
                rows.append(
                    {"track": track, "action": action, "first": first, "last": last}
                    | {"start": first - half, "end": last + half, "quiet_from": quiet}
                    | {"closed": all(f in false_clear and false_clear[f] for f in after)}
                )
        return rows


def _span(first, last):
    return {"first": first, "last": last, "first_s": first / 15, "last_s": last / 15}


def _chains(frames, step, kind):
    """Maximal chains of frames a step apart with an equal kind that is not None."""
    rows = []
    for frame in range(frames[0], frames[-1] + 1, step):
        what = kind(frame)
        if what is None:
            continue
        if rows and rows[-1][1] == frame - step and rows[-1][2] == what:
            rows[-1][1] = frame
        else:
            rows.append([frame, frame, what])
    return [tuple(row) for row in rows]


def robot_sectors(angle):
    """The sector of a panorama angle and, within 5 degrees of an edge, the other one."""
    turn = {name: abs((angle - center + 180) % 360 - 180) for name, center in CENTERS.items()}
    near = sorted((t, name) for name, t in turn.items() if t <= 50 + 1e-9)
    if len(near) == 1:
        return near[0][1], None
    if abs(near[0][0] - near[1][0]) < 1e-9:  # on the edge itself: the clockwise sector has it
        first = next(n for _, n in near if (angle - CENTERS[n]) % 360 > 180)
        return first, next(n for _, n in near if n != first)
    return near[0][1], near[1][1]


CENTERS = {"behind": 0, "left": 90, "ahead": 180, "right": 270}


def person_sectors(bearing):
    """Every sector that a bearing could be in: those within 2 degrees of it."""
    spans = {"front": (0, 30), "side front": (30, 45), "side": (45, 135), "side back": (135, 145), "back": (145, 180)}
    hand = "left" if bearing >= 0 else "right"
    names = {"side front": f"front {hand}", "side": hand, "side back": f"back {hand}"}
    size = abs(bearing)
    return [names.get(n, n) for n, (low, high) in spans.items() if low - 2 - 1e-9 <= size <= high + 2 + 1e-9]


def distance_words(metres):
    """The word of a distance and the other one near a bound, else None."""
    words = ["very close", "close", "moderate", "far", "very far"]
    bounds = [0.5, 1.5, 5.0, 10.0]
    place = sum(metres > bound for bound in bounds)
    for i, bound in enumerate(bounds):
        if abs(metres - bound) <= 0.1 * bound + 1e-9:
            return words[place], words[i + 1] if place == i else words[i]
    return words[place], None
