"""Every fact of every interval table, computed from the raw JSON by brute force.

Plain Python over the rows of `oracle_reading`, frame by frame and person by person, following the definitions and
sharing no code with what it checks: constants and spellings are written out again. Slow, and meant to be read.

Where the definitions leave something open, what a user would expect: a fact between people, or of a person and a thing,
needs the people's 2D boxes in that frame; things that the reasoning layer names and the panoptic layer does not hold
are things all the same; nobody "handles" people; a group with two venues that the majority tells has none.

`facts(root, sequence)` returns {table: list of row dicts} in the columns of the interval tables.
"""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise

from oracle_covering import Covering
from oracle_files import PERSON_CATEGORIES, POSES, read_root, said_too

from jrdb_avr.schema.rules import LoadRules

LAYERS = (
    "2d",
    "actions",
    "groups",
    "3d",
    "demographics",
    "interactions",
    "group_info",
    "handles",
    "pose",
    "panoptic",
    "timestamps",
    "images",
)


JUDGED = LoadRules().visibility == "clear"
"""Whether the program judges by default who is in clear view. Nothing else is taken from it."""

LABELED = ("actions", "memberships", "interactions", "handles")
"""Tables of written labels; beside each stands one of what may hold without a label."""


def facts(root, sequence, judged=JUDGED):
    return Oracle(read_root(root, sequence), sequence, judged).tables()


def step_of(frames):
    divisor = 0
    for a, b in pairwise(frames):
        divisor = math.gcd(divisor, b - a)
    return 15 if divisor % 15 == 0 else 1


class Oracle:
    def __init__(self, found, sequence, judged=JUDGED):
        self.sequence = sequence
        self.judged = judged
        self.found = found
        self.people = {(row["frame"], row["track"]): row for row in found.rows("boxes_2d")}
        solid = {(row["frame"], row["track"]): row for row in found.rows("boxes_3d")}
        self.located = {key: row for key, row in solid.items() if (row["num_points"] or 0) > 0}
        self.boxed = [*self.people, *solid]
        self.known_2d = set(found.frames.get("2d", ()))
        self.tracks = {}
        for frame, track in sorted(self.people):
            self.tracks.setdefault(frame, []).append(track)
        self.has_attributes = any(row["has_attributes"] for row in self.people.values())
        self.told_occlusion = any(row["occlusion"] is not None for row in self.people.values())
        self.covering = Covering(self.people) if judged and not self.told_occlusion else None
        self.written = {key: {} for key in self.people}
        for row in found.rows("actions"):
            listed = self.written[row["frame"], row["track"]]
            listed[row["action"]] = easier(listed.get(row["action"]), row["difficulty"])
        self.actions = {key: said_too(listed) for key, listed in self.written.items()}
        self.clusters = {
            (row["frame"], row["track"]): (row["cluster"], row["difficulty"]) for row in found.rows("groups")
        }
        self.grouped = {frame: True for frame, _ in self.clusters}
        self.members = {}
        for (frame, track), (cluster, _) in self.clusters.items():
            self.members.setdefault((frame, cluster), []).append(track)
        self.action_frames = self._known("actions")
        self.action_step = step_of(self.action_frames) if self.action_frames else None
        self.group_frames = self._known("groups")
        self.poses = {(row["frame"], row["track"]): row["keypoints"] for row in found.rows("poses")}
        self.listed = {(row["layer"], row["frame"], row["track"]) for row in found.rows("listed")}
        # What somebody does with a person without a box stands in no table: other people's words may leave it out too.
        for row in found.rows("interactions"):
            for one, other in (("track", "partner"), ("partner", "track")):
                if (row["frame"], row[one]) not in self.people:
                    self.listed.discard(("interactions", row["frame"], row[other]))
        self.stamps = {row["frame"]: row["timestamp"] for row in found.rows("timestamps") if row["sensor"] == "images"}
        self._times = {}
        labelled = {f for layer in ("2d", "groups") for f in self._known(layer)} | {f for f, _ in self.people}
        self.first, self.last = min(labelled, default=0), max(labelled, default=0)
        self.keyframes = self._keyframes()

    def _span(self, first, last):
        return {"first": first, "last": last, "first_s": self.seconds(first), "last_s": self.seconds(last)}

    def _known(self, layer):
        return sorted(self.found.frames.get(layer, ()))

    def seconds(self, frame):
        """By the image timestamps, counted from frame 0; even between stamped frames, 1/15 s per frame beyond them."""
        return self._clock(frame) - self._clock(0)

    def _clock(self, frame):
        if frame not in self._times:
            self._times[frame] = self._time(frame)
        return self._times[frame]

    def _time(self, frame):
        if not self.stamps:
            return frame / 15
        start = self.stamps[min(self.stamps)]
        before = max((f for f in self.stamps if f <= frame), default=None)
        after = min((f for f in self.stamps if f >= frame), default=None)
        if before is None or after is None:
            edge = after if before is None else before
            return self.stamps[edge] - start + (frame - edge) / 15
        share = (frame - before) / (after - before) if after > before else 0.0
        return self.stamps[before] - start + share * (self.stamps[after] - self.stamps[before])

    def _keyframes(self):
        base = self.action_frames or self._known("2d") or self._known("3d")
        if not base:
            return []
        marks = base if step_of(base) == 15 else [f for f in range(base[0], base[-1] + 1) if f % 15 == 0]
        with_boxes = {f for f, _ in self.people}
        return [f for f in marks if f in self.known_2d or f not in with_boxes]

    # -- facts of one person in one frame --

    def certain(self, frame, track, action):
        return self.legible(frame, track, action) and not self.covered(frame, track)

    def legible(self, frame, track, action):
        """Whether a label is certain but for the view of the person."""
        listed = self.actions.get((frame, track), {})
        if listed.get(action) not in (1, 2):
            return False
        whole = self.people[frame, track]["has_actions"]
        return action not in POSES or (whole and len(POSES & set(self.written[frame, track])) == 1)

    def gap(self, frame, track, action):
        """Inside a closed gap: listed at most seven frames apart on both sides, at one frame per step."""
        if self.action_step in (None, 15):
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
        if action in listed:
            return "true" if self.certain(frame, track, action) else "unknown"
        if (frame, track) not in self.people or not self.people[frame, track]["has_actions"]:
            return "unknown"
        if action in POSES and self.one_pose(frame, track) is None:
            return "unknown"
        return "false"

    def pose(self, frame, track):
        return None if self.covered(frame, track) else self.one_pose(frame, track)

    def one_pose(self, frame, track):
        """The pose that the list of a person tells, also of a covered one."""
        poses = [a for a in self.written.get((frame, track), {}) if a in POSES]
        return poses[0] if len(poses) == 1 and self.legible(frame, track, poses[0]) else None

    def clear(self, frame, track):
        record = self.people.get((frame, track))
        if record is None:
            return False
        y, w, h = (record[side] for side in "ywh")
        if self.told_occlusion if self.judged else self.has_attributes:
            visible = record["occlusion"] in ("Fully_visible", "Mostly_visible")
        else:
            visible = not self.judged or (
                self.covering.share(frame, track) is not None
                and self.covering.share(frame, track) < Fraction(1, 2)
                and self.grouped_about(frame, track)
            )
        fits = y >= 0 and y + h <= 480 and 12 <= w <= 480 and h >= 40
        return visible and fits and record["no_eval"] is not True

    def covered(self, frame, track):
        """Certainly not in clear view: such a person counts for nobody in the frame."""
        if not self.judged or (frame, track) not in self.people:
            return False
        if self.told_occlusion:
            return self.people[frame, track]["occlusion"] in ("Severely_occluded", "Fully_occluded")
        share = self.covering.share(frame, track)
        return share is not None and share >= Fraction(4, 5)

    def grouped_about(self, frame, track):
        """Whether the nearest frame with group labels, at most a second away, has an easy one of the person."""
        if not self.clusters:
            return True
        away = sorted((abs(by), by) for by in range(-15, 16) if self.grouped.get(frame + by))
        return bool(away) and self.clusters.get((frame + away[0][1], track), (None, None))[1] in (1, 2)

    def counting(self, frame):
        """Everybody with a box but for covered people."""
        return [track for track in self.in_frame(frame) if not self.covered(frame, track)]

    def angle(self, frame, track):
        record = self.people[frame, track]
        return ((record["x"] + record["w"] / 2) / 3760 * 360) % 360

    def in_frame(self, frame):
        return self.tracks.get(frame, [])

    def group_sizes(self, frame, track):
        """Every size that the group of a person could have."""
        if not self.judged:
            size = self.group_size_of_all(frame, track)
            return [] if size is None else [size]
        mine, code = self.clusters.get((frame, track), (None, None))
        if code not in (1, 2) or frame not in self.known_2d or self.covered(frame, track):
            return []
        others = [(self.clusters.get((frame, t), (None, None)), t) for t in self.counting(frame) if t != track]
        sure = [self.clear(frame, t) for (group, code), t in others if code in (1, 2) and group == mine]
        perhaps = [t for (_, code), t in others if code not in (1, 2)]
        least = 1 + sure.count(True)
        return [*range(least, least + sure.count(False) + len(perhaps) + 1)]

    def group_size_of_all(self, frame, track):
        people = self.in_frame(frame)
        if frame not in self.known_2d or any((frame, t) not in self.clusters for t in people):
            return None
        cluster = self.clusters[frame, track][0]
        mine = [self.clusters[frame, t] for t in people if self.clusters[frame, t][0] == cluster]
        # Somebody may be hidden for a moment and belong to the group all the same.
        around = range(frame - 15, frame + 16)
        # What boxes or groups show beyond the readable frames is part of the sequence, and unread.
        grid = range(min(self.known_2d) - 15, max(self.known_2d) + 16, step_of(sorted(self.known_2d)))
        if any(f in grid and self.first <= f <= self.last and f not in self.known_2d for f in around):
            return None
        near = {t for f in around for t in self.members.get((f, cluster), ())}
        near |= {t for f in around for t in self.in_frame(f) if (f, t) not in self.clusters}
        return len(mine) if near <= set(people) and all(code in (1, 2) for _, code in mine) else None

    # -- tables --

    def tables(self):
        result = {
            "sequence": self._sequence(),
            "frames": self._frames(),
            "demographics": self._demographics(),
            "sightings": [self._sighting(f, t) for f, t in sorted(self.people)],
            "actions": self._action_intervals(),
            "memberships": self._membership_intervals(),
            "interactions": self._interactions(),
            "handles": self._handles(),
            "objects": self._objects(),
            "object_sightings": self._object_sightings(),
            "presences": self._presences(),
            "absences": self._absences(),
            "group_info": self._group_info(),
            "beside": self._robot_view() + self._person_frame(),
            "segments": self._segments(),
        }
        result["persons"] = self._persons(result["demographics"])
        for name in LABELED:
            result[f"possible_{name}"] = [row for row in result[name] if not row["written"]]
            result[name] = [row for row in result[name] if row["written"]]
        return {name: [{"sequence": self.sequence, **row} for row in rows] for name, rows in result.items()}

    def _sequence(self):
        leading = self.action_frames or self._known("2d") or self._known("3d")
        return [
            {
                "fps": 15.0,
                "frame_count": max(self._all_frames()) + 1,
                "layers": [name for name in LAYERS if self.found.frames.get(name)],
                "action_step": step_of(leading),
                "keyframes": self.keyframes,
                "visibility": self._evidence(),
            }
        ]

    def _evidence(self):
        if self.told_occlusion if self.judged else self.has_attributes:
            return "attributes"
        return "geometry" if self.judged and self.people else "nothing"

    def _all_frames(self):
        """Of every layer but the timestamps, which may reach further than what they stamp."""
        known = {f for layer, frames in self.found.frames.items() if layer != "timestamps" for f in frames}
        return sorted(known | {f for f, _ in self.people})

    def _frames(self):
        return [
            {
                "frame": f,
                "seconds": self.seconds(f),
                "keyframe": f in self.keyframes,
                "annotated": f in self.known_2d,
                "image": f in self.found.frames.get("images", ()),
            }
            for f in sorted({*self._all_frames(), *self.keyframes})
        ]

    def _persons(self, demographics):
        rows = []
        for track in sorted({t for _, t in self.boxed}):
            frames = [f for f, t in self.boxed if t == track]
            told = {}
            for name in ("gender", "age", "ethnicity"):
                mine = [row["value"] for row in demographics if (row["track"], row["attribute"]) == (track, name)]
                told[name] = mine[0] if len(mine) == 1 else None
            rows.append({"track": track, **told, "first_frame": min(frames), "last_frame": max(frames)})
        return rows

    def _demographics(self):
        """Each frame votes once for each value that it tells with difficulty 1-2."""
        votes = {
            (row["track"], row["attribute"], row["value"], row["frame"])
            for row in self.found.rows("demographics")
            if row["value"] is not None and row["difficulty"] in (1, 2)
        }
        rows = []
        for track, attribute, value in sorted({vote[:3] for vote in votes}):
            mine = sum(vote[:3] == (track, attribute, value) for vote in votes)
            every = sum(vote[:2] == (track, attribute) for vote in votes)
            rows.append(
                {"track": track, "attribute": attribute, "value": value, "votes": mine, "chosen": 2 * mine > every}
            )
        return rows

    def _group_info(self):
        """Each member votes in each frame for the values that it tells of the group it is in at that frame."""
        votes = {
            (self.clusters[row["frame"], row["track"]][0], row["attribute"], row["value"], row["frame"], row["track"])
            for row in self.found.rows("group_info")
            if row["value"] is not None
            and row["difficulty"] in (1, 2)
            and (row["frame"], row["track"]) in self.clusters
        }
        rows = []
        for cluster, attribute, value in sorted({vote[:3] for vote in votes}):
            mine = sum(vote[:3] == (cluster, attribute, value) for vote in votes)
            telling = len({vote[3:] for vote in votes if vote[:2] == (cluster, attribute)})
            rows.append(
                {
                    "cluster": cluster,
                    "attribute": attribute,
                    "value": value,
                    "votes": mine,
                    "chosen": 2 * mine > telling,
                }
            )
        venues = [row["cluster"] for row in rows if row["chosen"] and row["attribute"] == "venue"]
        return [
            row | {"chosen": row["chosen"] and (row["attribute"] != "venue" or venues.count(row["cluster"]) == 1)}
            for row in rows
        ]

    def _interactions(self):
        """Both directions of every fact between two people with a box; the easier of all that say it counts."""
        said = {}
        for row in self.found.rows("interactions"):
            frame, pair = row["frame"], (row["track"], row["partner"])
            if all((frame, track) in self.people for track in pair):
                for label, difficulty in said_too({row["label"]: row["difficulty"]}).items():
                    for key in ((*pair, label), (*reversed(pair), label)):
                        said.setdefault(key, {}).setdefault(frame, []).append((label == row["label"], difficulty))
        return [
            {"source": source, "target": target, "label": label, **row}
            for (source, target, label), frames in sorted(said.items())
            for row in self._relation("interactions", frames)
        ]

    def _handles(self):
        people = {row["category_id"] for row in self.found.rows("categories") if row["category"] in PERSON_CATEGORIES}
        said = {}
        for row in self.found.rows("handles"):
            if (row["frame"], row["track"]) in self.people and row["category_id"] not in people:
                for verb, difficulty in said_too({row["verb"]: row["difficulty"]}).items():
                    frames = said.setdefault((row["track"], row["object"], row["category_id"], verb), {})
                    frames.setdefault(row["frame"], []).append((verb == row["verb"], difficulty))
        return [
            {"track": track, "object": thing, "category_id": category, "verb": verb, **row}
            for (track, thing, category, verb), frames in sorted(said.items())
            for row in self._relation("handles", frames)
        ]

    def _relation(self, layer, frames):
        """Intervals of a relation by frame: each statement as whether it is written, and its difficulty."""
        known = self._known(layer)
        step = step_of(known)

        def kind(frame):
            if frame in frames:
                written = [difficulty for is_written, difficulty in frames[frame] if is_written]
                return ("certain" if {1, 2} & {*written} else "hard") if written else "said too"
            return "gap" if step == 1 and self._closed(frame, frames.__contains__) else None

        return [{**self._span(first, last), **_flags(what)} for first, last, what in _chains(known, step, kind)]

    def _objects(self):
        """Things with a track, as the panoptic layer shows them, and those that only somebody handles."""
        names = {row["category_id"]: row["category"] for row in self.found.rows("categories")}
        seen = {}
        for row in self.found.rows("panoptic"):
            if row["object"] is not None:
                seen.setdefault((row["object"], row["category_id"]), []).append(row["frame"])
        for row in self.found.rows("handles"):
            seen.setdefault((row["object"], row["category_id"]), [])
        return [
            {"object": thing, "category_id": category, "category": names.get(category)}
            | {"first_frame": min(frames, default=None), "last_frame": max(frames, default=None)}
            for (thing, category), frames in sorted(seen.items())
            if names.get(category) not in PERSON_CATEGORIES
        ]

    def _object_sightings(self):
        things = {(row["object"], row["category_id"]) for row in self._objects()}
        return [
            {name: row[name] for name in ("frame", "object", "category_id", *"xywh")}
            | {"angle": (row["x"] + row["w"] / 2) / 3760 * 360 % 360}
            for row in self.found.rows("panoptic")
            if (row["object"], row["category_id"]) in things and row["x"] is not None
        ]

    def _presences(self):
        """Frames of a person with a box, for certain in clear view."""
        return self._stretches(lambda track, mine: {f: self.clear(f, track) for f in mine})

    def _absences(self):
        """Frames between two boxes without one, for certain where there is none a second before and after."""

        def away(track, mine):
            frames = {f for f in self.known_2d if f not in mine}
            return {f: {f - 15, f + 15} <= frames for f in frames if min(mine) < f < max(mine)}

        return self._stretches(away)

    def _stretches(self, find):
        step = step_of(self._known("2d"))
        rows = []
        for track in sorted({t for _, t in self.people}):
            last = None
            for frame, certain in sorted(find(track, {f for f, t in self.people if t == track}).items()):
                if last != (frame - step, certain):
                    rows.append({"track": track, "first": frame, "certain": certain})
                rows[-1] |= self._span(rows[-1]["first"], frame)
                last = frame, certain
        return rows

    def _sighting(self, frame, track):
        record = self.people[frame, track]
        angle = self.angle(frame, track)
        keypoints = self.poses.get((frame, track))
        sizes = self.group_sizes(frame, track)
        row = {
            "frame": frame,
            "track": track,
            **{side: record[side] for side in "xywh"},
            "angle": angle,
            "occlusion": record["occlusion"],
            "no_eval": record["no_eval"] is True,
            "clear": self.clear(frame, track),
            "covered": self.covered(frame, track),
            # The first three points are head, right eye, left eye.
            "face_visible": None if keypoints is None else 2 in [keypoints[3 * i + 2] for i in range(3)],
            "listed": record["has_actions"],
            "interactions_listed": ("interactions", frame, track) in self.listed,
            "handles_listed": ("handles", frame, track) in self.listed,
            "pose": self.pose(frame, track),
            "posed": self.one_pose(frame, track) is not None,
            "cluster": self.clusters.get((frame, track), (None,))[0],
            "group_size": sizes[0] if len(sizes) == 1 else None,
            "group_size_min": min(sizes, default=None),
            "group_size_max": max(sizes, default=None),
            "sector": next((name for name in CENTERS if off_axis(angle, name) <= 40 + 1e-9), None),
            "located": (frame, track) in self.located,
            "robot_view_listed": True,
            "person_view_listed": (frame, track) in self.located,
        }
        empty = dict.fromkeys(("distance", "distance_word", "distance_word_other", "cx", "cy", "cz", "heading"))
        if not row["located"]:
            return row | empty
        box = self.located[frame, track]
        distance = math.hypot(box["cx"], box["cy"]) if box["distance"] is None else box["distance"]
        words = distance_words(distance)
        # A heading of half a turn is -pi, as headings lie in [-pi, pi).
        turned = math.remainder(-box["rot_z"], 2 * math.pi)
        return row | {
            "distance": distance,
            "distance_word": words[0],
            "distance_word_other": words[1],
            **{name: box[name] for name in ("cx", "cy", "cz")},
            "heading": turned + math.pi if turned < 0 else turned - math.pi,
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
                    if action in self.written.get((frame, track), {}):
                        doubtful = "doubtful" if listed[action] in (1, 2) else "hard"
                        return "certain" if self.certain(frame, track, action) else doubtful
                    if action in listed:
                        return "said too"
                    return "gap" if self.gap(frame, track, action) else None

                for first, last, what in _chains(self.action_frames, step, kind):
                    codes = [self.actions.get((f, track), {}).get(action) for f in range(first, last + 1, step)]
                    difficulty = None if None in codes else max(codes)
                    rows.append(
                        {"track": track, "action": action, **self._span(first, last), "difficulty": difficulty}
                        | _flags(what)
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
                rows.append({"track": track, "cluster": cluster, **self._span(first, last), **_flags(what)})
        return rows

    def _robot_view(self):
        rows = []
        for frame in self.keyframes:
            people = self.counting(frame)
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
        seen = [other for other in others if 1 <= turns[other] <= 90 and self.clear(frame, other)]
        if seen:
            nearest = min(turns[other] for other in seen)
            could = [other for other in others if turns[other] < nearest + 1]
        else:
            could = [other for other in others if turns[other] <= 90]
        certain = bool(seen) and len(could) == 1
        label = f"first to the {side} of (robot view)"
        return [
            {"source": source, "target": t, "label": label, **self._span(frame, frame), "certain": certain}
            for t in could
        ]

    def _person_frame(self):
        seen = {}  # (source, target, label, certain) -> frames
        for frame in self.keyframes:
            people = [t for f, t in self.located if f == frame]
            for source in people:
                for target in people:
                    if source == target:
                        continue
                    for label, certain in self._beside(frame, source, target):
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
                    {"source": source, "target": target, "label": label, **self._span(frame, last), "certain": certain}
                )
        return rows

    def _beside(self, frame, source, target):
        a, b = self.located[frame, source], self.located[frame, target]
        dx, dy, dz = (b[k] - a[k] for k in ("cx", "cy", "cz"))
        metres = math.sqrt(dx * dx + dy * dy + dz * dz)
        if metres > 5.5:
            return []
        heading = math.pi - a["rot_z"]
        ahead = dx * math.cos(heading) + dy * math.sin(heading)
        left = dy * math.cos(heading) - dx * math.sin(heading)
        sectors = person_sectors(math.degrees(math.atan2(left, ahead)))
        words = [w for w in distance_words(metres) if w in ("very close", "close", "moderate")]
        near = len(words) == 1 and metres < 4.5 and abs(dz) <= 1.35
        return [(f"{sector}, {word}", near and sure) for sector, sure in sectors.items() for word in words]

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


def easier(a, b):
    """The easier of two difficulties; None is unreadable."""
    return min((c for c in (a, b) if c is not None), default=None)


def _flags(what):
    return {"certain": what == "certain", "gap": what == "gap", "written": what in ("certain", "doubtful", "hard")}


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


def off_axis(angle, sector):
    """Degrees between a panorama angle and the axis of a sector of the robot's."""
    return abs((angle - CENTERS[sector] + 180) % 360 - 180)


CENTERS = {"behind": 0, "left": 90, "ahead": 180, "right": 270}


def person_sectors(bearing):
    """{every sector that somebody at a bearing, degrees to the left of straight ahead, could be in: if it is certain}.

    Beside an axis of the person within 20 degrees, and anywhere in the half circle round it perhaps. Between two axes,
    perhaps where either could be, and certainly where drawn sectors (30 to 45 degrees off the front, 35 to 45 off the
    back) and eighths of a circle (22.5 to 67.5 degrees) agree, with 2 degrees to spare.
    """
    off = {axis: abs((bearing - turn + 180) % 360 - 180) for axis, turn in PERSON_AXES.items()}
    found = {axis: away <= 20 + 1e-9 for axis, away in off.items() if away <= 90 + 1e-9}
    for end, low in (("front", 32), ("back", 37)):
        for side in ("left", "right"):
            if end in found and side in found:
                found[f"{end} {side}"] = low - 1e-9 <= off[end] <= 43 + 1e-9
    return found


PERSON_AXES = {"front": 0, "left": 90, "back": 180, "right": 270}


def distance_words(metres):
    """The word of a distance and the other one near a bound, else None."""
    words = ["very close", "close", "moderate", "far", "very far"]
    bounds = [0.5, 1.5, 5.0, 10.0]
    place = sum(metres > bound for bound in bounds)
    for i, bound in enumerate(bounds):
        if abs(metres - bound) <= 0.1 * bound + 1e-9:
            return words[place], words[i + 1] if place == i else words[i]
    return words[place], None
