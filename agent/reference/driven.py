"""The policies `driven` and `guided`: the harness finds where to look, the model reads one picture at a time.

Plan, then look where attention expects to learn the most, have the people of the picture read, and find out who they
are, until nothing more is worth a look or all looks are made; then commit to the best supported answer. Nothing but the
task and the model's replies decides what happens.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import msgspec

from jrdb_avr.agent.methods.attempt import Attempt, ParsedReply, stitched_evidence
from jrdb_avr.agent.look.answer import conclude
from jrdb_avr.agent.perceive.association import with_picture
from jrdb_avr.agent.look.attention import NextLook, next_looks
from jrdb_avr.agent.perceive.geometry import SeenColumns, joined_looks
from jrdb_avr.agent.perceive.readings import PersonReading
from jrdb_avr.agent.look.ranking import RankedHypothesis, rank
from jrdb_avr.agent.perceive.votes import SETTLING, Tracks
from jrdb_avr.agent.reference.guided import MOST_LOOKS, pick_look
from jrdb_avr.agent.perceive.fields import Perceiver, fields_of
from jrdb_avr.agent.reference.recognize import recognize
from jrdb_avr.schema.method import Observation, Prediction
from jrdb_avr.schema.panorama import CROP
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import KEYFRAME_STEP

if TYPE_CHECKING:
    from jrdb_avr.agent.reference.belief_writer import BeliefWriter

_TURN_DEG = 1.6
"""Degrees by which a look is turned aside if one at its angle was made before."""

_SEEKING = ("follow", "bracket", "absence")
"""Purposes of looks at other moments, at which somebody has to be known again."""


@dataclass
class DrivenEpisode:
    """The loop over one question.

    writer: of a world model; without one the newest reading of everybody counts, whatever the ones before it. seen: the
    pictures that were read, by name; tracks: all readings so far. guided: whether the model picks among the best looks.
    """

    attempt: Attempt
    plan: Plan
    looks: int
    writer: BeliefWriter | None = None
    guided: bool = False
    seen: dict[str, Observation] = field(default_factory=dict)
    tracks: Tracks = field(default_factory=lambda: Tracks({}, {}))

    def play(self) -> Prediction:
        """Look until nothing more is worth it, and commit."""
        frames = self.attempt.task.sequence.frames
        perceiver = Perceiver(self.attempt, fields_of(self.plan, self.attempt.task.question.choices))
        hypotheses = rank(self.plan, self.tracks)
        while (left := self.looks - len(self.attempt.made)) > 0:
            started = time.perf_counter()
            most = MOST_LOOKS if self.guided else 1
            looks = next_looks(self.plan, self.tracks, hypotheses, left, frames, most)
            self.attempt.record("solve", {"next look": left}, [look._asdict() for look in looks], started)
            if not looks:
                break
            best = hypotheses[0] if hypotheses else None
            look = pick_look(self.attempt, looks, best, left) if len(looks) > 1 else looks[0]
            self._look(look, perceiver, None if best is None else best.nodes.get(self.plan.target))
            hypotheses = rank(self.plan, self.tracks)
        return self._committed(hypotheses)

    def _look(self, look: NextLook, perceiver: Perceiver, target: str | None) -> None:
        angle = look.angle
        while self.attempt.duplicate(look.frame, angle):
            angle = (angle + _TURN_DEG) % 360.0
        seen = self.attempt.look(look.frame, angle)
        name = f"o{len(self.attempt.made)}"
        if self.writer is not None:
            name = self.writer.world.observed(seen, self.attempt.steps - 1)
        people = perceiver.people(seen, name)
        if people is None:
            return
        self.seen[name] = seen
        recognized = self._recognized(look, target, seen, people)
        self.tracks = with_picture(self.tracks, look.frame, SeenColumns(seen.left, CROP), people, recognized)
        if self.writer is not None:
            self.writer.picture(self.tracks, people, seen.left, self.attempt.steps - 1)

    def _recognized(
        self, look: NextLook, target: str | None, seen: Observation, people: Sequence[PersonReading]
    ) -> dict[str, int]:
        """Whether the target is among the people of a picture in which it was looked for, as far as the model tells."""
        if target is None or not people or look.purpose not in _SEEKING:
            return {}
        frames = {one.frame for one in self.tracks.people[target]}
        agreed = [one for one in (self.tracks.agreed(target, frame) for frame in frames) if one is not None]
        known = min(
            agreed, key=lambda one: (not one.whole, self._doubt(target, one.frame) + abs(one.frame - look.frame))
        )
        number = recognize(self.attempt, known, self.seen[known.observation], seen, people)
        return {} if number is None else {target: number}

    # -- the end ------------------------------------------------------------------------------------------------------

    def _committed(self, hypotheses: Sequence[RankedHypothesis]) -> Prediction:
        started = time.perf_counter()
        task = self.attempt.task
        tracks = self.tracks
        if self.writer is None:
            tracks = newest(tracks)
            hypotheses = rank(self.plan, tracks)
        found = conclude(self.plan, tracks, hypotheses, task.question.choices, task.sequence.frames)
        self.attempt.record("solve", {"conclude": self.plan.answer.read}, msgspec.to_builtins(found), started)
        if found is None:
            return self.attempt.prediction(ParsedReply(refusal="nobody was seen"))
        evidence = stitched_evidence(found.frame, found.box.box)
        step = self.attempt.steps - 1
        verdict = None if self.writer is None else self.writer.concluded(tracks, hypotheses, found, step)
        return self.attempt.prediction(ParsedReply(found.answer, evidence, verdict=verdict))

    def _doubt(self, who: str, frame: int) -> int:
        """Frames by which a single box of somebody counts as farther than one that two readings agree on."""
        box = self.tracks.box(who, frame)
        return 0 if box is not None and box.votes >= SETTLING else KEYFRAME_STEP * 2


def newest(tracks: Tracks) -> Tracks:
    """The same tracks with only the newest reading of everybody at each frame: nothing is voted on.

    What looks show is joined, so that nobody counts as missed by a look before the newest.
    """
    people = {who: tuple({one.frame: one for one in readings}.values()) for who, readings in tracks.people.items()}
    return Tracks(people, {frame: joined_looks(looks) for frame, looks in tracks.looks.items()})
