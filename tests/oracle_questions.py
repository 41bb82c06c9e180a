"""Every proven candidate of a small world, worked out from the raw JSON by brute force.

Plain Python over the facts of `oracle_facts.Oracle`; nothing of the engine is used. `proven(root, sequence)` returns
{(template, target track, canonical plan, answer)}.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math

from oracle_facts import POSES, Oracle, distance_words, robot_sectors

OTHERS = {
    "holding sth",
    "listening to someone",
    "talking to someone",
    "looking at robot",
    "looking into sth",
    "looking at sth",
    "typing",
    "interaction with door",
    "eating sth",
    "talking on the phone",
    "pointing at sth",
    "reading",
    "pushing",
    "greeting gestures",
    "writing",
    "pulling",
}
RANK = {"pose": 2, "action": 3, "group_size": 6, "sector": 7, "distance": 8}
WAIT = SHIFT = 45
YES, NO, MAYBE = "true", "false", "unknown"


def proven(root, sequence):
    world = World(root, sequence)
    found = set()
    for t0 in world.keyframes:
        for track in world.in_frame(t0):
            found |= world.start_and_span(track, t0)
            found |= world.change(track, t0)
            found |= world.presence(track, t0)
            found |= world.distance(track, t0)
    return found


def text(value):
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


class World(Oracle):
    def __init__(self, root, sequence):
        super().__init__(root, sequence)
        tables = self.tables()
        self.layers = set(tables["sequence"][0]["layers"])
        self.segments = [row for row in tables["segments"] if row["action"] in POSES | OTHERS]
        self.sizes = {(row["frame"], row["track"]): row["group_size"] for row in tables["sightings"]}
        self.metres = {(row["frame"], row["track"]): row["distance"] for row in tables["sightings"]}

    # -- descriptions --

    def value(self, condition, frame, track):
        """Whether a condition, (kind, value), is true, false or unknown of a person with a box."""
        kind, wanted = condition
        if kind in ("pose", "action"):
            return self.state(frame, track, wanted)
        if kind == "group_size":
            size = self.sizes[frame, track]
            return MAYBE if size is None else YES if size == wanted else NO
        if kind == "sector":
            could = robot_sectors(self.angle(frame, track))
        else:
            metres = self.metres[frame, track]
            if metres is None:
                return MAYBE
            could = distance_words(metres)
        could = {word for word in could if word is not None}
        return NO if wanted not in could else YES if could == {wanted} else MAYBE

    def conditions(self, frame, track):
        """Everything that is certainly true of a person, as (kind, value)."""
        every = [("pose", pose) for pose in POSES] + [("action", action) for action in OTHERS]
        every += [("group_size", self.sizes[frame, track])] if self.sizes[frame, track] is not None else []
        every += [("sector", word) for word in ("ahead", "right", "behind", "left")]
        every += [("distance", word) for word in ("very close", "close", "moderate", "far", "very far")]
        return [condition for condition in every if self.value(condition, frame, track) == YES]

    def could_match(self, conditions, frame):
        return [
            track
            for track in self.in_frame(frame)
            if all(self.value(condition, frame, track) != NO for condition in conditions)
        ]

    def description(self, frame, track, poseless=False):
        """The one description of a person, or None."""
        true = [c for c in self.conditions(frame, track) if not (poseless and c[0] == "pose")]
        for size in (1, 2, 3):
            fits = []
            for conditions in itertools.combinations(true, size):
                if all(kind in ("sector", "distance") for kind, _ in conditions):
                    continue
                if self.could_match(conditions, frame) == [track]:
                    plain = self.plain(conditions)
                    digest = hashlib.sha256(
                        f"{self.sequence}\n{track}\n{frame}\n{text(plain)[1:-1]}".encode()
                    ).hexdigest()
                    fits.append((sorted(RANK[kind] for kind, _ in conditions), digest, conditions))
            if fits:
                return min(fits)[2]
        return None

    @staticmethod
    def plain(conditions):
        """Conditions as a plan holds them."""
        rows = []
        for kind, value in sorted(conditions, key=lambda c: (RANK[c[0]], str(c[1]))):
            if kind in ("pose", "action"):
                rows.append({"action": value, "at": "t0"})
            else:
                rows.append({"attribute": kind, "value": value, "at": "t0"})
        return rows

    def anchored(self, track, frame, poseless=False):
        """The description, if each of its conditions is needed and the person is seen; else None."""
        conditions = self.description(frame, track, poseless)
        if conditions is None or not self.clear(frame, track) or not self.shown(frame):
            return None
        for dropped in conditions:
            rest = [condition for condition in conditions if condition != dropped]
            if len(self.could_match(rest, frame)) < 2:
                return None
        return conditions

    # -- what is seen --

    def shown(self, frame):
        return not self.pictures or frame in self.pictures

    def ahead(self, frame, track):
        """At least half of the box lies within the 480 columns round the middle of the panorama."""
        x, _, w, _ = self.people[frame, track]["box"]
        return any(
            min(x + turn + w, 2120) - max(x + turn, 1640) >= w / 2 for turn in (-2 * 3760, -3760, 0, 3760, 2 * 3760)
        )

    def seen(self, frame, track):
        """True present, False absent, None unknown."""
        if self.clear(frame, track):
            return True
        around = (frame - 15, frame, frame + 15)
        gone = all(f in self.known_2d and (f, track) not in self.people for f in around)
        return False if gone else None

    def later(self, frame):
        return [t for t in self.keyframes if t >= frame + WAIT]

    def plan(self, conditions, times, answer):
        plan = {"root": "a", "target": "a", "edges": [], "answer": {"of": "a", **answer}}
        plan["times"] = {name: {"frame": t} if isinstance(t, int) else t for name, t in times.items()}
        plan["nodes"] = [{"id": "a", "conditions": self.plain(conditions)}]
        return text(plan)

    # -- templates --

    def start_and_span(self, track, t0):
        found = set()
        if not {"2d", "actions"} <= self.layers or (conditions := self.anchored(track, t0)) is None:
            return found
        for row in self.segments:
            first, last, action = row["first"], row["last"], row["action"]
            if row["track"] != track or row["start"] < t0 + WAIT:
                continue
            grid = range(t0, first, 15 if self.slow else 1)
            if any(self.state(f, track, action) != NO for f in grid):
                continue
            event = {"event": "start", "of": "a", "action": action, "after": "t0"}
            if self.shown(first) and not self.ahead(first, track):
                plan = self.plan(conditions, {"t0": t0, "t1": event}, {"mode": "frame", "read": "start", "at": "t1"})
                found.add(("start", track, plan, text({"frame": row["start"]})))
            both = self.shown(first) and self.shown(last)
            if row["closed"] and both and not (self.ahead(first, track) and self.ahead(last, track)):
                times = {"t0": t0, "t1": event, "t2": {**event, "event": "end", "after": "t1"}}
                plan = self.plan(conditions, times, {"mode": "span", "read": "span", "at": ["t1", "t2"]})
                answer = f'{{"start_frame":{row["start"]},"end_frame":{row["end"]}}}'
                found.add(("span", track, plan, answer))
        return found

    @property
    def slow(self):
        """Whether actions are annotated once a second."""
        steps = {b - a for a, b in itertools.pairwise(self.action_frames)}
        return math.gcd(0, *steps) % 15 == 0

    def change(self, track, t0):
        found = set()
        before = self.pose(t0, track)
        if not {"2d", "actions"} <= self.layers or before is None:
            return found
        if (conditions := self.anchored(track, t0, poseless=True)) is None:
            return found

        def read(t):
            if self.seen(t, track) is False:
                return "empty"
            return self.pose(t, track)

        for t1 in self.later(t0):
            after = self.pose(t1, track)
            if after in (None, before) or not self.clear(t1, track) or not self.shown(t1) or self.ahead(t1, track):
                continue
            if self.needs_time(t0, (t1,), after, lambda times: read(times[0])):
                plan = self.plan(
                    conditions, {"t0": t0, "t1": t1}, {"mode": "multiple_choice", "read": "action", "at": "t1"}
                )
                found.add(("change", track, plan, after))
        return found

    def presence(self, track, t0):
        found = set()
        if "2d" not in self.layers or (conditions := self.anchored(track, t0)) is None:
            return found
        names = {
            (True, True): "both times",
            (True, False): "only at the first time",
            (False, True): "only at the second time",
            (False, False): "neither time",
        }

        def read(times):
            return names.get(tuple(self.seen(t, track) for t in times))

        for t1 in self.later(t0):
            for t2 in self.later(t1):
                answer = read((t1, t2))
                if answer is None or not (self.shown(t1) and self.shown(t2)):
                    continue
                decisive = [t for t in (t1, t2) if self.seen(t, track)] or [t0]
                if all(self.ahead(t, track) for t in decisive):
                    continue
                if self.needs_time(t0, (t1, t2), answer, read):
                    times = {"t0": t0, "t1": t1, "t2": t2}
                    how = {"mode": "multiple_choice", "read": "presence", "at": ["t1", "t2"]}
                    found.add(("presence", track, self.plan(conditions, times, how), answer))
        return found

    def distance(self, track, t0):
        found = set()
        if not {"2d", "3d"} <= self.layers or (conditions := self.anchored(track, t0)) is None:
            return found

        def read(times):
            here, there = self.metres[t0, track], self.metres.get((times[0], track))
            if here is None:
                return None
            if self.seen(times[0], track) is False:
                return "not in view"
            if there is None:
                return None
            if abs(here - there) >= 1.5:
                return "closer to the robot" if there < here else "farther from the robot"
            return "about the same distance" if abs(here - there) < 0.5 else None

        for t1 in self.later(t0):
            answer = read((t1,))
            if answer is None or not self.shown(t1) or self.seen(t1, track) is None:
                continue
            if self.ahead(t1 if self.seen(t1, track) else t0, track):
                continue
            if self.needs_time(t0, (t1,), answer, read):
                how = {"mode": "multiple_choice", "read": "distance_change", "at": ["t0", "t1"]}
                found.add(("distance", track, self.plan(conditions, {"t0": t0, "t1": t1}, how), answer))
        return found

    def needs_time(self, t0, times, answer, read):
        """time.shift and time.drop: `read` gives an answer, None for unknown, or "empty"."""

        def moved(by):
            asked = [t + by for t in times]
            if not all(t0 < t and t in self.keyframes for t in asked):
                return None
            return read(asked)

        if all(moved(by) in (None, answer) for by in (-SHIFT, SHIFT)):
            return False
        elsewhere = []
        for t in self.later(t0):
            asked = [t + other - times[0] for other in times]
            if t != times[0] and all(f in self.keyframes for f in asked):
                elsewhere.append(read(asked))
        defined = [other for other in elsewhere if other not in (None, "empty")]
        return not defined or any(other != answer for other in defined)
