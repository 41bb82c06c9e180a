"""Every proven candidate of a small world, worked out from the raw JSON by brute force.

Plain Python over the facts of `oracle_people.People`; nothing of the engine is used. `proven(root, sequence)` returns
{(template, target track, canonical plan, answer)} of the templates in `KNOWN`.
"""

from __future__ import annotations

import itertools
import math

from oracle_people import ACTIONS, EMPTY, NO, People, condition_poses, poses_in, text

WAIT = SHIFT = 45
LONG = 150
SEARCH = 30


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


class World(People):
    def __init__(self, root, sequence):
        super().__init__(root, sequence)
        self.segments = [row for row in self.rows["segments"] if row["action"] in ACTIONS]
        self.metres = {key: sight["distance"] for key, sight in self.sights.items()}
        # Whether actions are annotated once a second.
        steps = {b - a for a, b in itertools.pairwise(self.action_frames)}
        self.step_frames = 15 if math.gcd(0, *steps) % 15 == 0 else 1

    def later(self, frame):
        return [t for t in self.keyframes if t >= frame + WAIT]

    def plan(self, conditions, times, answer, labels=()):
        """The plan's canonical text; `labels` are the relations from a to b, from b to c, ..."""
        names = "abcd"[: len(labels) + 1]
        plan = {"root": "a", "target": names[-1], "answer": {"of": names[-1], **answer}}
        plan["times"] = {name: {"frame": t} if isinstance(t, int) else t for name, t in times.items()}
        plan["nodes"] = [{"id": name, "conditions": []} for name in names]
        plan["nodes"][0]["conditions"] = self.plain(conditions)
        hops = zip(names, labels, names[1:], strict=False)
        plan["edges"] = [{"source": a, "relation": label, "target": b, "at": "t0"} for a, label, b in hops]
        return text(plan)

    @staticmethod
    def stated(conditions, labels=()):
        """The poses that a question's words name."""
        named = [condition_poses(condition) for condition in conditions] + [poses_in(label) for label in labels]
        return set().union(*named)

    def pose_at(self, frame, track):
        """The pose read of a person, EMPTY of somebody absent, None where it is unknown."""
        return EMPTY if self.seen(frame, track) is False else self.pose(frame, track)

    # -- templates --

    def start_and_span(self, track, t0):
        found = set()
        if not {"2d", "actions"} <= self.layers or (conditions := self.anchored(track, t0)) is None:
            return found
        for row in self.segments:
            first, last, action = row["first"], row["last"], row["action"]
            if row["track"] != track or row["start"] < t0 + WAIT:
                continue
            if not self.quiet(track, action, t0, first):
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

    def quiet(self, track, action, t0, first):
        """Whether an action is false from t0 until just before a frame."""
        return all(self.state(f, track, action) == NO for f in range(t0, first, self.step_frames))

    def change(self, track, t0):
        found = set()
        before = self.pose(t0, track)
        if not {"2d", "actions"} <= self.layers or before is None:
            return found
        if (conditions := self.anchored(track, t0, poseless=True)) is None:
            return found

        for t1 in self.later(t0):
            after = self.pose(t1, track)
            if after in (None, before) or not self.clear(t1, track) or not self.shown(t1) or self.ahead(t1, track):
                continue
            if after in self.stated(conditions):
                continue
            if self.needs_time(t0, (t1,), after, lambda times: self.pose_at(times[0], track)):
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
        """time.shift and time.drop: `read` gives an answer, None for unknown, or EMPTY."""

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
        defined = [other for other in elsewhere if other not in (None, EMPTY)]
        return not defined or any(other != answer for other in defined)
