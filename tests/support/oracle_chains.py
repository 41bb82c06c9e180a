"""Proven candidates about somebody found by hops from a described person."""

from __future__ import annotations

import itertools
import json

from oracle_asked import LONG, SHIFT, Asked
from oracle_people import EMPTY, FIRST, MAYBE, NO, RELATIONS, SEVERAL, WINDOWS, YES

SEARCH = 30
NOWHERE = (EMPTY, SEVERAL, MAYBE)
CHOICE = {"mode": "multiple_choice", "read": "action"}


class Chains(Asked):
    def paths(self, frame, path, hops):
        """Every (relations, people) of so many hops from the end of a path."""
        if hops == 0:
            yield (), path
            return
        for label in RELATIONS:
            reached = self.step(frame, path[-1], label)
            if reached not in NOWHERE and reached not in path:
                for labels, people in self.paths(frame, (*path, reached), hops - 1):
                    yield (label, *labels), people

    def walk(self, frame, start, labels):
        """Who stands at the end of a path, or why nobody does: nobody is met twice."""
        path = [start]
        for label in labels:
            reached = self.step(frame, path[-1], label)
            if reached in NOWHERE:
                return reached
            if reached in path:
                return EMPTY
            path.append(reached)
        return path[-1]

    def needs_hops(self, t0, labels, people, answer, read):
        """hop.stop and hop.skip: `read` gives somebody's answer, None for unknown, or another word."""
        ends = list(people[:-1])
        ends += [self.walk(t0, people[0], labels[:i] + labels[i + 1 :]) for i in range(len(labels))]
        found = [None if end == MAYBE else end if end in NOWHERE else read(end) for end in ends]
        return not {None, answer} & set(found)

    def program(self, conditions, labels, t):
        """The pose at the end of a path from whom the conditions fit at t; None where it is unknown."""
        start = self.fits(conditions, t)
        return self.pose_there(t, start if start in NOWHERE else self.walk(t, start, labels))

    def program_needs_time(self, conditions, labels, t0, answer):
        """time.shift and time.drop of the whole program."""
        return self.program_moves(lambda t: self.program(conditions, labels, t), t0, answer)

    def program_moves(self, program, t0, answer):
        shifted = [program(t0 + by) for by in (-SHIFT, SHIFT) if t0 + by in self.keyframes]
        elsewhere = [program(t) for t in self.keyframes if t != t0]
        defined = [other for other in elsewhere if other is not None and other not in NOWHERE]
        moves = any(other not in (None, answer) for other in shifted)
        return moves and (not defined or any(other != answer for other in defined))

    def anchors(self, track, t0):
        return self.anchored(track, t0) if {"2d", "actions"} <= self.layers else None

    def poses_of_chains(self, track, t0):
        """two_hop and three_hop."""
        found = set()
        if (conditions := self.anchors(track, t0)) is None:
            return found
        for hops, template in ((2, "two_hop"), (3, "three_hop")):
            for labels, people in self.paths(t0, (track,), hops):
                last = people[-1]
                answer = self.pose(t0, last)
                if answer is None or answer in self.stated(conditions, labels) or self.ahead(t0, last):
                    continue
                if not all(self.clear(t0, person) for person in people):
                    continue
                if not self.needs_hops(t0, labels, people, answer, lambda end: self.pose(t0, end)):
                    continue
                if self.program_needs_time(conditions, labels, t0, answer):
                    plan = self.plan(conditions, {"t0": t0}, {**CHOICE, "at": "t0"}, labels)
                    found.add((template, last, plan, answer))
        return found

    def joined(self, frame, b, r3, c, r4, apart):
        """The one person, but for those apart, who is in r3 with b and in r4 with c."""
        others = [track for track in self.in_frame(frame) if track not in apart]
        both = {d: [self.related(frame, b, r3, d), self.related(frame, c, r4, d)] for d in others}
        return self.only(both)

    def fork_program(self, conditions, labels, t):
        r1, r2, r3, r4 = labels
        a = self.fits(conditions, t)
        if a in NOWHERE:
            return None if a == MAYBE else a
        b, c = self.step(t, a, r1), self.step(t, a, r2)
        if {b, c} & {EMPTY, SEVERAL} or b == c != MAYBE:
            return EMPTY
        if MAYBE in (b, c):
            return None
        return self.pose_there(t, self.joined(t, b, r3, c, r4, (a, b, c)))

    def pose_there(self, t, end):
        """The pose of whoever stands at an end, if anybody does; None where it is unknown."""
        return None if end == MAYBE else end if end in NOWHERE else self.pose(t, end)

    def fork_join(self, track, t0):
        found = set()
        if (conditions := self.anchors(track, t0)) is None:
            return found
        reached = {label: self.step(t0, track, label) for label in RELATIONS}
        reached = {label: other for label, other in reached.items() if other not in NOWHERE}
        for r1, r2 in itertools.product(reached, repeat=2):
            b, c = reached[r1], reached[r2]
            if r1 >= r2 or b == c or not all(self.clear(t0, person) for person in (b, c)):
                continue
            read = [self.pose(t0, person) for person in (track, b, c)]
            rest = [person for person in self.in_frame(t0) if person not in (track, b, c)]
            for r3, r4 in itertools.product(self.several(t0, b, rest), self.several(t0, c, rest)):
                d = self.joined(t0, b, r3, c, r4, (track, b, c))
                if d in NOWHERE or not self.clear(t0, d) or self.ahead(t0, d):
                    continue
                answer, labels = self.pose(t0, d), (r1, r2, r3, r4)
                if answer is None or answer in self.stated(conditions, labels):
                    continue
                without_b = self.pose_there(t0, self.joined(t0, track, r3, c, r4, (track, c)))
                without_c = self.pose_there(t0, self.joined(t0, b, r3, track, r4, (track, b)))
                if {read[0], without_b, without_c} & {None, answer} or not {*read[1:]} - {None, answer}:
                    continue
                if self.program_moves(lambda t, labels=labels: self.fork_program(conditions, labels, t), t0, answer):
                    edges = (("a", r1, "b"), ("a", r2, "c"), ("b", r3, "d"), ("c", r4, "d"))
                    plan = self.graph_plan(conditions, {"t0": t0}, {**CHOICE, "at": "t0"}, edges)
                    found.add(("fork_join", d, plan, answer))
        return found

    def several(self, t0, source, rest):
        """The relations that certainly hold of two or more of the rest; who is first is one person only."""
        for label in (*RELATIONS, *WINDOWS):
            if label not in FIRST and [self.related(t0, source, label, d) for d in rest].count(YES) >= 2:
                yield label

    def later_pose(self, track, t0):
        found = set()
        if (conditions := self.anchors(track, t0)) is None:
            return found
        for labels, people in self.paths(t0, (track,), 2):
            last = people[-1]
            before = self.pose(t0, last)
            if before is None or not all(self.clear(t0, person) for person in people):
                continue
            for t1 in self.keyframes:
                answer = self.pose(t1, last)
                if t1 < t0 + LONG or answer in (None, before) or answer in self.stated(conditions, labels):
                    continue
                if not self.clear(t1, last) or not self.shown(t1) or self.ahead(t1, last):
                    continue
                if not self.needs_hops(t0, labels, people, answer, lambda end, t1=t1: self.pose_at(t1, end)):
                    continue
                if self.needs_time(t0, (t1,), answer, lambda times, last=last: self.pose_at(times[0], last)):
                    plan = self.plan(conditions, {"t0": t0, "t1": t1}, {**CHOICE, "at": "t1"}, labels)
                    found.add(("later_pose", last, plan, answer))
        return found

    def action_search(self, track, t0):
        found = set()
        if (conditions := self.anchors(track, t0)) is None:
            return found
        for labels, people in self.paths(t0, (track,), 2):
            last = people[-1]
            if not all(self.clear(t0, person) for person in people):
                continue
            for row in self.segments:
                action, first, start = row["action"], row["first"], row["start"]
                if row["track"] != last or start < t0 + SEARCH or not self.quiet(last, action, t0, first):
                    continue
                angle = self.angle(first, last)
                if turned(angle, self.angle(t0, last)) <= 20 or not self.shown(first) or self.ahead(first, last):
                    continue
                if self.one_view([*((t0, person) for person in people), (first, last)]):
                    continue
                answer = f'{{"frame":{start},"angle_deg":{json.dumps(angle)}}}'

                def read(end, action=action, start=start, angle=angle, answer=answer):
                    return self.start_read(end, action, t0, start, angle, answer)

                if self.needs_hops(t0, labels, people, answer, read):
                    event = {"event": "start", "of": "c", "action": action, "after": "t0"}
                    how = {"mode": "frame_viewpoint", "read": "start_view", "at": "t1"}
                    found.add(
                        ("action_search", last, self.plan(conditions, {"t0": t0, "t1": event}, how, labels), answer)
                    )
        return found

    def start_read(self, track, action, t0, start, angle, answer):
        """The stored answer where somebody's start would score against it; None where it could, as far as is known."""
        for row in self.segments:
            theirs = (row["track"], row["action"]) == (track, action) and row["start"] > t0
            if theirs and self.quiet(track, action, t0, row["first"]):
                near = abs(row["start"] - start) <= 15 and turned(self.angle(row["first"], track), angle) <= 20
                return answer if near else EMPTY
        # Whoever is first seen to do it at a frame began after the one before, as the labels count them.
        for frame in range(start - 15, start + 15 + self.step_frames):
            if (frame, track) in self.people and turned(self.angle(frame, track), angle) <= 20:
                before = self.state(frame - 15, track, action)
                if self.state(frame, track, action) != NO and before != YES:
                    return None
        return EMPTY


def turned(a, b):
    """Degrees between two directions."""
    return abs((a - b + 180) % 360 - 180)
