"""What all questions of the oracle share: their plans, what is read of people, and the proofs of time.

Plain Python over the facts of `oracle_people.People`; nothing of the engine is used.
"""

from __future__ import annotations

import itertools
import math

from oracle_people import EMPTY, NO, People, condition_poses, poses_in, text
from oracle_words import ACTIONS

WAIT = SHIFT = 45
LONG = 150


class Asked(People):
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

    @staticmethod
    def stated(conditions, labels=()):
        """The poses that a question's words name."""
        named = [condition_poses(condition) for condition in conditions] + [poses_in(label) for label in labels]
        return set().union(*named)

    def pose_at(self, frame, track):
        """The pose read of a person, EMPTY of somebody absent, None where it is unknown."""
        return EMPTY if self.seen(frame, track) is False else self.pose(frame, track)

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
