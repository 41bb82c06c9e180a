"""Proven candidates about how much time lies between two events, and how many people somebody is with."""

from __future__ import annotations

import itertools

from oracle_asked import LONG, WAIT, Asked
from oracle_people import GROUP, MAYBE, NO, TOGETHER, YES

GAP = 75
LEAST = 4
SECONDS = {"mode": "number", "read": "seconds_between", "at": ["t1", "t2"]}


class Gaps(Asked):
    def gap_starts(self, track, t0):
        found = set()
        if not {"2d", "actions"} <= self.layers or (conditions := self.anchored(track, t0)) is None:
            return found
        firsts = [row for row in self.segments if row["track"] == track and row["start"] > t0]
        firsts = [row for row in firsts if self.quiet(track, row["action"], t0, row["first"])]
        for one, two in itertools.permutations(firsts, 2):
            looks = (one["first"], two["first"])
            if one["start"] < t0 + WAIT or two["start"] < one["start"] + GAP or one["action"] == two["action"]:
                continue
            if not all(self.shown(t) for t in looks) or all(self.ahead(t, track) for t in looks):
                continue
            event = {"event": "start", "of": "a", "after": "t0"}
            times = {"t0": t0, "t1": {**event, "action": one["action"]}, "t2": {**event, "action": two["action"]}}
            answer = f'{{"value":{(two["start"] - one["start"]) / 15}}}'
            found.add(("gap", track, self.plan(conditions, times, SECONDS), answer))
        return found

    def gap_absence(self, track, t0):
        """From the last box before the first absence after t0 to the first one after it."""
        found = set()
        if "2d" not in self.layers or (conditions := self.anchored(track, t0)) is None:
            return found
        gone = next((t for t in self.keyframes if t > t0 and self.seen(t, track) is False), None)
        if gone is None:
            return found
        boxes = [f for f, other in self.people if other == track]
        last, back = max(f for f in boxes if f < gone), min((f for f in boxes if f > gone), default=None)
        if back is None or last < t0 + WAIT or back < last + GAP:
            return found
        # In a frame without annotation there may be a box nobody knows of.
        steps = {b - a for a, b in itertools.pairwise(sorted(self.known_2d))}
        grid = range(last, back, 15 if all(step % 15 == 0 for step in steps) else 1)
        there = [t for t in self.keyframes if t0 <= t <= last]
        if not all(f in self.known_2d for f in grid) or not all(self.seen(t, track) for t in there):
            return found
        looks = (last, back)
        if not all(self.clear(t, track) and self.shown(t) for t in looks) or all(self.ahead(t, track) for t in looks):
            return found
        left = {"event": "leaves", "of": "a", "after": "t0"}
        times = {"t0": t0, "t1": left, "t2": {"event": "returns", "of": "a", "after": "t1"}}
        found.add(("gap", track, self.plan(conditions, times, SECONDS), f'{{"value":{(back - last) / 15}}}'))
        return found

    def gap_count(self, track, t1):
        found = set()
        if "2d" not in self.layers or (conditions := self.anchored(track, t1)) is None or self.ahead(t1, track):
            return found
        for label in (*TOGETHER, GROUP):
            if label == GROUP and any(kind == "group_size" for kind, _ in conditions):
                continue
            met, between = {}, set()  # track -> the keyframes at which it is certain
            for frame in range(t1, self.keyframes[-1] + 1):
                facts = self.company(frame, track, label)
                if frame not in self.keyframes:
                    if facts is not None and not self.company_told(frame, track, label):
                        break
                    between |= {other for other, fact in (facts or {}).items() if fact != NO}
                    continue
                if facts is None or MAYBE in facts.values():
                    break
                for other in (other for other, fact in facts.items() if fact == YES):
                    met.setdefault(other, []).append(frame)
                if frame < t1 + LONG or len(met) < LEAST or between - set(met):
                    continue
                seen = [self.first_seen_with(track, times, other) for other, times in met.items()]
                if all(t is not None and self.shown(t) for t in seen):
                    times = {"t1": t1, "t2": frame}
                    how = {"mode": "number", "read": "count", "at": ["t1", "t2"], "relation": label}
                    found.add(("gap", track, self.plan(conditions, times, how), f'{{"value":{float(len(met))}}}'))
        return found

    def company(self, frame, track, label):
        """{other: whether it is in the relation}; None where the person has no box."""
        if (frame, track) not in self.people:
            return None
        return {other: self.related(frame, track, label, other) for other in self.in_frame(frame) if other != track}

    def company_told(self, frame, track, label):
        """Whether nobody could be in the relation only because nothing is known."""
        people = self.in_frame(frame)
        if len(people) == 1:
            return True
        others = [other for other in people if other != track and not self.spoken(frame, track, label, other)]
        return all(self.tells(frame, one, label) for one in others) and (self.tells(frame, track, label) or not others)

    def spoken(self, frame, track, label, other):
        if label == GROUP:
            return bool(set(self.groups_of(frame, track)) & set(self.groups_of(frame, other)))
        return self._stands(frame, (track, label, other)) is not None

    def first_seen_with(self, track, times, other):
        return next((t for t in times if self.clear(t, track) and self.clear(t, other)), None)
