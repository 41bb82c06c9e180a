"""Proven candidates about one described person: what it starts, becomes and does next, and where it is."""

from __future__ import annotations

from oracle_asked import LONG, WAIT, Asked
from oracle_people import text


class Alone(Asked):
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
            if there is None or self.seen(times[0], track) is None:
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

    def consequence(self, track, t0):
        """The pose of t0 holds at every keyframe for ten seconds; the next keyframe lies in a stable one of another."""
        found = set()
        held = self.pose(t0, track)
        if not {"2d", "actions"} <= self.layers or held is None:
            return found
        if (conditions := self.anchored(track, t0, poseless=True)) is None:
            return found
        last = t0
        while last + 15 in self.keyframes and self.pose(last + 15, track) == held:
            last += 15
        for row in self.segments:
            first, after = row["first"], row["action"]
            if row["track"] != track or not last < first <= last + 15 or last < t0 + LONG:
                continue
            if last + 15 not in self.keyframes or self.pose(last + 15, track) != after:
                continue
            if after in self.stated(conditions) or not self.shown(first) or self.ahead(first, track):
                continue
            times = {"t0": t0, "t1": {"event": "end", "of": "a", "after": "t0"}}
            how = {"mode": "multiple_choice", "read": "next_action", "at": "t1"}
            found.add(("consequence", track, self.plan(conditions, times, how), after))
        return found
