"""Every proven candidate of a small world, computed from the raw JSON by brute force.

Plain Python over the facts of `oracle_facts.Oracle`; it shares no code with the engine. `proven(root, sequence)`
returns {(template, target track, canonical plan, answer)}.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from functools import cache, cached_property

from oracle_choices import MAYBE, NO, YES, doing, implied, shown_actions, true_choices, wrong_sets
from oracle_facts import JUDGED, LABELED, Oracle, distance_words, off_axis
from oracle_files import ACTIONS, AGES, OTHERS, POSES, TOGETHER, VERBS, read_root

GENDERS = ("male", "female")
GROUP = "in the same group as"
FIRST = ("first to the left of (robot view)", "first to the right of (robot view)")
PLACES = tuple(
    f"{sector}, {word}"
    for sector in ("front", "front left", "left", "back left", "back", "back right", "right", "front right")
    for word in ("very close", "close", "moderate")
)
WINDOWS = {
    f"within {degrees} degrees to the {side} of (robot view)": (degrees, side)
    for degrees in (30, 45, 60, 90)
    for side in ("left", "right")
}
RELATIONS = (*TOGETHER, GROUP, *FIRST, *PLACES)
KINDS = ("gender", "age", "pose", "action", "object", "interaction", "group_size", "sector", "distance")
EMPTY, SEVERAL, OTHER = "empty", "several", "something else"


def text(value):
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


class People(Oracle):
    def __init__(self, root, sequence, judged=JUDGED):
        super().__init__(read_root(root, sequence), sequence, judged)
        self.state = cache(self.state)
        self.clear, self.covered = cache(self.clear), cache(self.covered)
        self.rows = self.tables()
        for name in LABELED:
            self.rows[name] += self.rows[f"possible_{name}"]
        self.layers = set(self.rows["sequence"][0]["layers"])
        self.sights = {(row["frame"], row["track"]): row for row in self.rows["sightings"]}
        self.told = {row["track"]: row for row in self.rows["persons"]}
        self.things = {(row["object"], row["category_id"]): row["category"] for row in self.rows["objects"]}
        self.pictures = set(self.found.frames.get("images", ()))
        self.value = cache(self._value)
        self.related = cache(self._related)
        self.step = cache(self._step)
        self.fits = cache(self._fits)
        self.description = cache(self._description)

    # -- conditions --

    def _value(self, condition, frame, track):
        """Whether a condition, (kind, value), is true, false or unknown of a person with a box."""
        kind, wanted = condition
        sight = self.sights[frame, track]
        if kind in ("pose", "action"):
            state = self.state(frame, track, wanted)
            return MAYBE if state == NO and self.flickers(frame, track, wanted) else state
        if kind == "object":
            return self._handles_thing(frame, track, *wanted)
        if kind == "interaction":
            others = [other for other in self.in_frame(frame) if other != track]
            found = {self.in_sight(self.related(frame, track, wanted, other), (frame, other)) for other in others}
            return YES if YES in found else MAYBE if MAYBE in found else NO
        if kind in ("gender", "age"):
            could = {self.told[track][kind]} & {*GENDERS, *AGES}
            # Nobody sees where an age ends: to its neighbours it is unknown.
            if kind == "age" and could and abs(AGES.index(wanted) - AGES.index(min(could))) == 1:
                return MAYBE
        elif kind == "group_size":
            could = {*self.group_sizes(frame, track)}
        elif kind == "sector":
            off = off_axis(self.angle(frame, track), wanted)
            return YES if off <= 40 + 1e-9 else MAYBE if off <= 90 + 1e-9 else NO
        else:
            could = set() if sight["distance"] is None else set(distance_words(sight["distance"]))
        could -= {None}
        if not could:
            return MAYBE
        return NO if wanted not in could else YES if could == {wanted} else MAYBE

    def in_sight(self, fact, *people):
        """A fact that holds for sure only if these (frame, person) are in clear view."""
        return MAYBE if self.judged and fact == YES and not all(self.clear(*one) for one in people) else fact

    def flickers(self, frame, track, action):
        """Whether an action that labels often miss is labelled a second earlier or later."""
        often_missed = ("looking at robot", "looking at sth", "pointing at sth", "interaction with door")
        near = (self.written.get((f, track), {}) for f in (frame - 15, frame + 15))
        return self.judged and action in often_missed and any(action in listed for listed in near)

    def _handles_thing(self, frame, track, category, verb):
        possible = False
        for row in self.handled.get(track, ()):
            what = self.things[row["object"], row["category_id"]]
            if row["verb"] == verb and row["first"] <= frame <= row["last"] and what in (category, None):
                if row["certain"] and what == category:
                    return YES
                possible = True
        return NO if self.sights[frame, track]["handles_listed"] and not possible else MAYBE

    @cached_property
    def handled(self):
        by_track = {}
        for row in self.rows["handles"]:
            by_track.setdefault(row["track"], []).append(row)
        return by_track

    @cached_property
    def pairs(self):
        """Everything done with a thing, as (category, verb), by verbs of the label list that are no poses."""
        every = {(self.things[row["object"], row["category_id"]], row["verb"]) for row in self.rows["handles"]}
        return {(category, verb) for category, verb in every if category is not None and verb in VERBS}

    def conditions(self, frame, track):
        """Everything that is certainly true of a person and may be said of it, as (kind, value)."""
        size = self.sights[frame, track]["group_size"]
        every = [("pose", pose) for pose in POSES] + [("action", action) for action in OTHERS]
        if "pose" not in self.layers or self.sights[frame, track]["face_visible"]:
            every += [("gender", word) for word in GENDERS] + [("age", word) for word in AGES]
        every += [("object", pair) for pair in self.pairs]
        every += [("interaction", label) for label in TOGETHER]
        every += [("group_size", size)] if size is not None else []
        every += [("sector", word) for word in ("ahead", "right", "behind", "left")]
        every += [("distance", word) for word in ("very close", "close", "moderate", "far", "very far")]
        return [condition for condition in every if self.value(condition, frame, track) == YES]

    # -- descriptions --

    def could_match(self, conditions, frame):
        return [
            track
            for track in self.counting(frame)
            if all(self.value(condition, frame, track) != NO for condition in conditions)
        ]

    def _fits(self, conditions, frame):
        """The one person who certainly matches while nobody else could, or EMPTY, SEVERAL or MAYBE."""
        return self.only({t: [self.value(c, frame, t) for c in conditions] for t in self.counting(frame)})

    @staticmethod
    def only(values):
        """{track: values that must all hold} -> who it is."""
        could = [track for track, all_of in values.items() if NO not in all_of]
        sure = [track for track in could if set(values[track]) <= {YES}]
        if len(could) == 1 and sure:
            return could[0]
        return SEVERAL if len(sure) > 1 else MAYBE if could else EMPTY

    def _description(self, frame, track, quiet=False):
        """The one description of a person, or None; a quiet one implies as few actions as any."""
        true, fits = self.conditions(frame, track), []
        for size in (1, 2, 3):
            for conditions in itertools.combinations(true, size):
                if any(set(fit[-1]) <= set(conditions) for fit in fits):
                    continue
                if all(kind in ("sector", "distance") for kind, _ in conditions):
                    continue
                if self.could_match(conditions, frame) == [track]:
                    said = text(self.plain(conditions))[1:-1]
                    digest = hashlib.sha256(f"{self.sequence}\n{track}\n{frame}\n{said}".encode()).hexdigest()
                    words = [value[1] if kind == "object" else value for kind, value in conditions]
                    loud = len(implied([word for word in words if isinstance(word, str)])) if quiet else 0
                    kinds = sorted(KINDS.index(kind) for kind, _ in conditions)
                    fits.append((loud, size, kinds, digest, conditions))
        return min(fits)[-1] if fits else None

    @staticmethod
    def plain(conditions, at="t0"):
        """Conditions as a plan holds them: by kind, then by their text."""
        rows = []
        for kind, value in conditions:
            if kind in ("pose", "action"):
                row = {"action": value}
            elif kind == "object":
                row = {"object": value[0], "verb": value[1]}
            elif kind == "interaction":
                row = {"interaction": value}
            else:
                row = {"attribute": kind, "value": value}
            rows.append((KINDS.index(kind), row if kind in ("gender", "age") else row | {"at": at}))
        return [row for _, row in sorted(rows, key=lambda ranked: (ranked[0], json.dumps(ranked[1])))]

    def anchored(self, track, frame, quiet=False):
        """The description, if each of its conditions is needed and the person is seen; else None."""
        conditions = self.description(frame, track, quiet)
        if conditions is None or not self.clear(frame, track) or not self.shown(frame):
            return None
        for dropped in conditions:
            rest = [condition for condition in conditions if condition != dropped]
            if len(self.could_match(rest, frame)) < 2:
                return None
        return conditions

    # -- relations --

    @cached_property
    def spans(self):
        """{(source, label, target): [(first, last, certain)]}; of members of groups {(track, cluster): ...}."""
        found = {}
        for table in ("interactions", "beside", "memberships"):
            for row in self.rows[table]:
                key = (
                    (row["track"], row["cluster"]) if "cluster" in row else (row["source"], row["label"], row["target"])
                )
                found.setdefault(key, []).append((row["first"], row["last"], row["certain"]))
        return found

    def _stands(self, frame, key):
        """True, unknown, or None where nothing says so."""
        certain = [sure for first, last, sure in self.spans.get(key, ()) if first <= frame <= last]
        return None if not certain else YES if any(certain) else MAYBE

    def groups_of(self, frame, track):
        clusters = [key[1] for key in self.spans if len(key) == 2 and key[0] == track]
        stands = {cluster: self._stands(frame, (track, cluster)) for cluster in clusters}
        return {cluster: state for cluster, state in stands.items() if state is not None}

    def tells(self, frame, track, label):
        """Whether all of a person's relations of this kind are known."""
        if label == GROUP:
            return YES in self.groups_of(frame, track).values()
        column = "interactions_listed" if label in TOGETHER else "located" if label in PLACES else None
        return column is None or self.sights[frame, track][column]

    def _related(self, frame, source, label, target):
        """Whether a relation between two different people with a box in the frame holds."""
        if label in WINDOWS:
            return self._in_window(frame, source, label, target)
        if label == GROUP:
            mine, theirs = self.groups_of(frame, source), self.groups_of(frame, target)
            found = [{mine[cluster], theirs[cluster]} for cluster in set(mine) & set(theirs)]
            stands = None if not found else YES if {YES} in found else MAYBE
        else:
            stands = self._stands(frame, (source, label, target))
        if stands is not None:
            return stands
        return NO if self.tells(frame, source, label) and self.tells(frame, target, label) else MAYBE

    def _in_window(self, frame, source, label, target):
        degrees, side = WINDOWS[label]
        here, there = self.angle(frame, source), self.angle(frame, target)
        turn = (here - there if side == "left" else there - here) % 360
        if min(turn, 360 - turn) <= 1 or abs(turn - degrees) <= 1:
            return MAYBE
        return YES if turn < degrees else NO

    def _step(self, frame, source, label):
        """The one person to whom a relation leads, or EMPTY, SEVERAL or MAYBE."""
        others = [track for track in self.counting(frame) if track != source]
        return self.only({other: [self.related(frame, source, label, other)] for other in others})

    # -- what is seen --

    def shown(self, frame):
        return not self.pictures or frame in self.pictures

    def ahead(self, frame, track):
        """At least half of the box lies within the 480 columns round the middle of the panorama."""
        return self._in_crop(1640, frame, track)

    def _in_crop(self, left, frame, track):
        x, w = self.people[frame, track]["x"], self.people[frame, track]["w"]
        turns = (turn * 3760 for turn in range(-3, 4))
        return any(min(x + turn + w, left + 480) - max(x + turn, left) >= w / 2 for turn in turns)

    def one_view(self, boxes):
        """Whether a crop, which begins at a whole column, shows half of each of these (frame, track).

        Then the last such crop shows no more than half of one of them, so it begins next to its middle.
        """
        middles = [round(self.angle(*box) / 360 * 3760) for box in boxes]
        lefts = [middle + by for middle in middles for by in range(-3, 4)]
        return any(all(self._in_crop(left % 3760, *box) for box in boxes) for left in lefts)

    def seen(self, frame, track):
        """True present, False absent, None unknown."""
        if self.clear(frame, track):
            return True
        around = (frame - 15, frame, frame + 15)
        gone = all(f in self.known_2d and (f, track) not in self.people for f in around)
        return False if gone else None


WAIT = SHIFT = 45
LONG = 150
CHOICE = {"mode": "multiple_choice", "read": "action"}


class Asked(People):
    def __init__(self, root, sequence, judged=JUDGED):
        super().__init__(root, sequence, judged)
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
        return self.graph_plan(conditions, times, answer, zip(names, labels, names[1:], strict=False))

    def graph_plan(self, conditions, times, answer, edges=()):
        """As `plan`, with edges as (source, relation, target)."""
        edges = [{"source": a, "relation": label, "target": b, "at": "t0"} for a, label, b in edges]
        names = ["a", *sorted({edge["target"] for edge in edges})]
        plan = {"root": "a", "target": names[-1], "answer": {"of": names[-1], **answer}, "edges": edges}
        plan["times"] = {name: {"frame": t} if isinstance(t, int) else t for name, t in times.items()}
        plan["nodes"] = [{"id": name, "conditions": []} for name in names]
        plan["nodes"][0]["conditions"] = self.plain(conditions, next(iter(times)))
        return text(plan)

    @cached_property
    def shown_actions(self):
        return shown_actions(self)

    def has_choices(self, frame, track, answer, conditions, labels=(), among=ACTIONS):
        """Whether there are three wrong choices for an action, which the words of the question do not give away."""
        words = {value[1] if kind == "object" else value for kind, value in conditions} | {*labels}
        return bool(wrong_sets(self, frame, track, answer, words, among))

    def action_at(self, frame, track, answer):
        """The answer if a person certainly does it, OTHER if certainly not, EMPTY if absent, None where unknown."""
        if self.seen(frame, track) is False:
            return EMPTY
        return {YES: answer, NO: OTHER, MAYBE: None}[doing(self, frame, track, answer)]

    def new_actions(self, t0, t1, track):
        """What somebody begins to do between two times, as far as it may be the answer."""
        return [one for one in true_choices(self, t1, track) if doing(self, t0, track, one) == NO]

    def descriptions(self, track, t0):
        """The description of a person and the one that implies the fewest actions."""
        found = [self.anchored(track, t0, quiet) for quiet in (False, True)]
        return {conditions for conditions in found if conditions is not None}

    def quiet(self, track, action, t0, first):
        """Whether an action is false from t0 until just before a frame."""
        return all(self.state(f, track, action) == NO for f in range(t0, first, self.step_frames))

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
        for conditions in self.descriptions(track, t0) if {"2d", "actions"} <= self.layers else ():
            for t1 in self.later(t0):
                if not self.clear(t1, track) or not self.shown(t1) or self.ahead(t1, track):
                    continue
                for after in self.new_actions(t0, t1, track):
                    if not self.has_choices(t1, track, after, conditions):
                        continue
                    if self.needs_time(t0, (t1,), after, lambda times, a=after: self.action_at(times[0], track, a)):
                        plan = self.plan(conditions, {"t0": t0, "t1": t1}, {**CHOICE, "at": "t1"})
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

    def next_pose(self, frame, track):
        """The first keyframe, or the second after the last one, at which somebody no longer has the pose of a frame."""
        held = self.pose(frame, track)
        while frame in self.keyframes and self.pose(frame, track) == held:
            frame += 15
        return frame

    def consequence(self, track, t0):
        """The pose of t0 holds at every keyframe for ten seconds; the next keyframe lies in a stable one of another."""
        found = set()
        if not {"2d", "actions"} <= self.layers or self.pose(t0, track) is None:
            return found
        last = self.next_pose(t0, track) - 15
        for row in self.segments:
            first, after = row["first"], row["action"]
            if row["track"] != track or not last < first <= last + 15 or last < t0 + LONG:
                continue
            if last + 15 not in self.keyframes or self.pose(last + 15, track) != after:
                continue
            if not self.shown(first) or self.ahead(first, track):
                continue
            for conditions in self.descriptions(track, t0):
                if self.has_choices(last + 15, track, after, conditions, among=POSES):
                    times = {"t0": t0, "t1": {"event": "end", "of": "a", "after": "t0"}}
                    how = {"mode": "multiple_choice", "read": "next_action", "at": "t1"}
                    found.add(("consequence", track, self.plan(conditions, times, how), after))
        return found


SEARCH = 30
NOWHERE = (EMPTY, SEVERAL, MAYBE)


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

    def program(self, conditions, labels, t, answer):
        """What is read at the end of a path from whom the conditions fit at t."""
        start = self.fits(conditions, t)
        return self.action_there(t, start if start in NOWHERE else self.walk(t, start, labels), answer)

    def program_needs_time(self, conditions, labels, t0, answer):
        """time.shift and time.drop of the whole program."""
        return self.program_moves(lambda t: self.program(conditions, labels, t, answer), t0, answer)

    def program_moves(self, program, t0, answer):
        shifted = [program(t0 + by) for by in (-SHIFT, SHIFT) if t0 + by in self.keyframes]
        elsewhere = [program(t) for t in self.keyframes if t != t0]
        defined = [other for other in elsewhere if other is not None and other not in NOWHERE]
        moves = any(other not in (None, answer) for other in shifted)
        return moves and (not defined or any(other != answer for other in defined))

    def actions_of_chains(self, track, t0):
        """two_hop and three_hop."""
        found = set()
        for conditions in self.descriptions(track, t0) if {"2d", "actions"} <= self.layers else ():
            found |= self._actions_of_chains(track, t0, conditions)
        return found

    def _actions_of_chains(self, track, t0, conditions):
        found = set()
        for hops, template in ((2, "two_hop"), (3, "three_hop")):
            for labels, people in self.paths(t0, (track,), hops):
                last = people[-1]
                if self.ahead(t0, last) or not all(self.clear(t0, person) for person in people):
                    continue
                for answer in true_choices(self, t0, last):
                    if not self.has_choices(t0, last, answer, conditions, labels):
                        continue
                    if not self.needs_hops(
                        t0, labels, people, answer, lambda end, a=answer: self.action_at(t0, end, a)
                    ):
                        continue
                    if self.program_needs_time(conditions, labels, t0, answer):
                        plan = self.plan(conditions, {"t0": t0}, {**CHOICE, "at": "t0"}, labels)
                        found.add((template, last, plan, answer))
        return found

    def joined(self, frame, b, r3, c, r4, apart):
        """The one person, but for those apart, who is in r3 with b and in r4 with c."""
        others = [track for track in self.counting(frame) if track not in apart]
        both = {d: [self.related(frame, b, r3, d), self.related(frame, c, r4, d)] for d in others}
        return self.only(both)

    def fork_program(self, conditions, labels, t, answer):
        r1, r2, r3, r4 = labels
        a = self.fits(conditions, t)
        if a in NOWHERE:
            return None if a == MAYBE else a
        b, c = self.step(t, a, r1), self.step(t, a, r2)
        if {b, c} & {EMPTY, SEVERAL} or b == c != MAYBE:
            return EMPTY
        if MAYBE in (b, c):
            return None
        return self.action_there(t, self.joined(t, b, r3, c, r4, (a, b, c)), answer)

    def action_there(self, t, end, answer):
        """What is read of whoever stands at an end, if anybody does; None where it is unknown."""
        return None if end == MAYBE else end if end in NOWHERE else self.action_at(t, end, answer)

    def fork_join(self, track, t0):
        found = set()
        for conditions in self.descriptions(track, t0) if {"2d", "actions"} <= self.layers else ():
            found |= self._fork_join(track, t0, conditions)
        return found

    def _fork_join(self, track, t0, conditions):
        found = set()
        reached = {label: self.step(t0, track, label) for label in RELATIONS}
        reached = {label: other for label, other in reached.items() if other not in NOWHERE}
        for r1, r2 in itertools.product(reached, repeat=2):
            b, c = reached[r1], reached[r2]
            if r1 >= r2 or b == c or not all(self.clear(t0, person) for person in (b, c)):
                continue
            rest = [person for person in self.counting(t0) if person not in (track, b, c)]
            for r3, r4 in itertools.product(self.several(t0, b, rest), self.several(t0, c, rest)):
                d = self.joined(t0, b, r3, c, r4, (track, b, c))
                if d in NOWHERE or not self.clear(t0, d) or self.ahead(t0, d):
                    continue
                for answer in true_choices(self, t0, d):
                    if self.joins_prove(conditions, (r1, r2, r3, r4), t0, (track, b, c, d), answer):
                        edges = (("a", r1, "b"), ("a", r2, "c"), ("b", r3, "d"), ("c", r4, "d"))
                        plan = self.graph_plan(conditions, {"t0": t0}, {**CHOICE, "at": "t0"}, edges)
                        found.add(("fork_join", d, plan, answer))
        return found

    def joins_prove(self, conditions, labels, t0, people, answer):
        (_, _, r3, r4), (a, b, c, d) = labels, people
        if not self.has_choices(t0, d, answer, conditions, labels):
            return False
        stops = [self.action_at(t0, person, answer) for person in (a, b, c)]
        without_b = self.action_there(t0, self.joined(t0, a, r3, c, r4, (a, c)), answer)
        without_c = self.action_there(t0, self.joined(t0, b, r3, a, r4, (a, b)), answer)
        if {stops[0], without_b, without_c} & {None, answer} or not {*stops[1:]} - {None, answer}:
            return False
        return self.program_moves(lambda t: self.fork_program(conditions, labels, t, answer), t0, answer)

    def several(self, t0, source, rest):
        """The relations that certainly hold of two or more of the rest; who is first is one person only."""
        for label in (*RELATIONS, *WINDOWS):
            if label not in FIRST and [self.related(t0, source, label, d) for d in rest].count(YES) >= 2:
                yield label

    def later_action(self, track, t0):
        found = set()
        for conditions in self.descriptions(track, t0) if {"2d", "actions"} <= self.layers else ():
            found |= self._later_action(track, t0, conditions)
        return found

    def _later_action(self, track, t0, conditions):
        found = set()
        for labels, people in self.paths(t0, (track,), 2):
            last = people[-1]
            if not all(self.clear(t0, person) for person in people):
                continue
            for t1 in self.keyframes:
                if t1 < t0 + LONG or not self.clear(t1, last) or not self.shown(t1) or self.ahead(t1, last):
                    continue
                for answer in self.new_actions(t0, t1, last):
                    if not self.has_choices(t1, last, answer, conditions, labels):
                        continue

                    def read(end, t1=t1, answer=answer):
                        return self.action_at(t1, end, answer)

                    if not self.needs_hops(t0, labels, people, answer, read):
                        continue
                    if self.needs_time(t0, (t1,), answer, lambda t, last=last, a=answer: self.action_at(t[0], last, a)):
                        plan = self.plan(conditions, {"t0": t0, "t1": t1}, {**CHOICE, "at": "t1"}, labels)
                        found.add(("later_action", last, plan, answer))
        return found

    def action_search(self, track, t0):
        found = set()
        for conditions in self.descriptions(track, t0) if {"2d", "actions"} <= self.layers else ():
            found |= self._action_search(track, t0, conditions)
        return found

    def _action_search(self, track, t0, conditions):
        found = set()
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
        others = [other for other in self.counting(frame) if other != track]
        facts = {other: self.related(frame, track, label, other) for other in others}
        return {other: self.in_sight(fact, (frame, track), (frame, other)) for other, fact in facts.items()}

    def company_told(self, frame, track, label):
        """Whether nobody could be in the relation only because nothing is known."""
        people = [one for one in self.in_frame(frame) if one == track or not self.covered(frame, one)]
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


class World(Alone, Chains, Gaps):
    def wrong_sets(self, template, program, target, answer):
        """Every three wrong choices that an action of a question with this plan's text may have."""
        plan = json.loads(program)
        conditions = [condition for node in plan["nodes"] for condition in node["conditions"]]
        words = {condition.get(kind) for condition in conditions for kind in ("action", "interaction", "verb")}
        words |= {edge["relation"] for edge in plan["edges"]}
        frame = plan["times"][plan["answer"]["at"]].get("frame")
        if template == "consequence":
            return wrong_sets(self, self.next_pose(plan["times"]["t0"]["frame"], target), target, answer, words, POSES)
        return wrong_sets(self, frame, target, answer, words)

    def proven(self):
        return {found for t0 in self.keyframes for track in self.in_frame(t0) for found in self.of(track, t0)}

    def of(self, track, t0):
        """Every proven candidate that begins with this person described at this keyframe."""
        templates = (
            self.start_and_span,
            self.change,
            self.presence,
            self.distance,
            self.consequence,
            self.actions_of_chains,
            self.later_action,
            self.action_search,
            self.fork_join,
            self.gap_starts,
            self.gap_absence,
            self.gap_count,
        )
        return set().union(*(template(track, t0) for template in templates))


def proven(root, sequence, judged=JUDGED):
    return World(root, sequence, judged).proven()
