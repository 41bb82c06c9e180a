"""The policy `driven`: the harness decides where to look, the model reads one picture at a time.

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
from jrdb_avr.agent.perception.answer import Conclusion, conclude
from jrdb_avr.agent.perception.association import with_picture
from jrdb_avr.agent.perception.attention import NextLook, next_look
from jrdb_avr.agent.perception.geometry import SeenColumns
from jrdb_avr.agent.perception.readings import PersonReading
from jrdb_avr.agent.perception.support import RankedHypothesis, rank
from jrdb_avr.agent.perception.votes import Tracks
from jrdb_avr.agent.reference.perceive import Perceiver, fields_of
from jrdb_avr.agent.reference.tool_calls import FINAL
from jrdb_avr.schema.method import Observation, Prediction
from jrdb_avr.schema.panorama import CROP, Box
from jrdb_avr.schema.plan import Plan

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.world_model import BeliefEpisode

_TURN_DEG = 1.6
"""A look that was made and could not be read is made again beside itself."""


@dataclass
class DrivenEpisode:
    """The loop over one question.

    world: what was read is written into it; without one the newest reading of everybody counts, whatever the ones
    before it. tracks: all readings so far.
    """

    attempt: Attempt
    plan: Plan
    looks: int
    world: BeliefEpisode | None = None
    tracks: Tracks = field(default_factory=lambda: Tracks({}, {}))

    def play(self) -> Prediction:
        """Look until nothing more is worth it, and commit."""
        frames = self.attempt.task.sequence.frames
        perceiver = Perceiver(self.attempt, fields_of(self.plan))
        hypotheses = rank(self.plan, self.tracks)
        while (left := self.looks - len(self.attempt.made)) > 0:
            started = time.perf_counter()
            look = next_look(self.plan, self.tracks, hypotheses, left, frames)
            self.attempt.record("solve", {"next look": left}, look and look._asdict(), started)
            if look is None:
                break
            self._look(look, perceiver)
            hypotheses = rank(self.plan, self.tracks)
        return self._committed(hypotheses)

    def _look(self, look: NextLook, perceiver: Perceiver) -> None:
        angle = look.angle
        while self.attempt.duplicate(look.frame, angle):
            angle = (angle + _TURN_DEG) % 360.0
        seen = self.attempt.look(look.frame, angle)
        name = f"o{len(self.attempt.made)}"
        if self.world is not None:
            name = self.world.observed(seen, self.attempt.steps - 1)
        people = perceiver.people(seen, name)
        if people is None:
            return
        self.tracks = with_picture(self.tracks, look.frame, SeenColumns(seen.left, CROP), people)
        if self.world is not None:
            self._write(self.world, seen, people)

    # -- the world model ----------------------------------------------------------------------------------------------

    def _write(self, world: BeliefEpisode, seen: Observation, people: Sequence[PersonReading]) -> None:
        """Write down what was read in a picture; what was denied is a vote, and no belief."""
        step = self.attempt.steps - 1
        entities = {
            one.number: who
            for who, readings in self.tracks.people.items()
            for one in readings[-2:]
            if people and one.observation == people[0].observation
        }
        for one in people:
            place = {"entity": entities[one.number], "observation": one.observation}
            self._sighting(entities[one.number], one, seen.left, step)
            values: list[tuple[str, str | float]] = [(label.name, label.value) for label in one.labels if label.holds]
            values += [] if one.metres is None else [("distance_m", one.metres)]
            for name, value in values:
                world.add("add_attribute", {**place, "name": name, "value": value}, step)
        for one in people:
            for tie in one.ties:
                if tie.holds:
                    ends = {"source": entities[one.number], "target": entities[tie.other]}
                    call = {**ends, "name": tie.relation, "observation": one.observation}
                    world.add("add_relation", call, step)

    def _sighting(self, who: str, one: PersonReading, left: int, step: int, node: str = "") -> None:
        assert self.world is not None, "sightings are written into a world model"
        box = Box(one.box.x - left, *one.box[1:])
        call = {"id": who, "kind": "person", "observation": one.observation, "box": [round(side) for side in box]}
        self.world.add("add_entity", call | ({"node": node} if node else {}), step, box)

    # -- the end ------------------------------------------------------------------------------------------------------

    def _committed(self, hypotheses: Sequence[RankedHypothesis]) -> Prediction:
        started = time.perf_counter()
        task = self.attempt.task
        tracks = self.tracks
        if self.world is None:
            tracks = newest(tracks)
            hypotheses = rank(self.plan, tracks)
        found = conclude(self.plan, tracks, hypotheses, task.question.choices, task.sequence.frames)
        self.attempt.record("solve", {"conclude": self.plan.answer.read}, msgspec.to_builtins(found), started)
        if found is None:
            return self.attempt.prediction(ParsedReply(refusal="nobody was seen"))
        if self.world is not None:
            self._conclude(self.world, hypotheses, found)
        evidence = stitched_evidence(found.frame, found.box.box)
        verdict = None if self.world is None else found.verdict
        return self.attempt.prediction(ParsedReply(found.answer, evidence, verdict=verdict))

    def _conclude(self, world: BeliefEpisode, hypotheses: Sequence[RankedHypothesis], found: Conclusion) -> None:
        """Write down who the plan's people are, how they stand to each other, and the answer."""
        step = self.attempt.steps - 1
        answer = {"answer": msgspec.to_builtins(found.answer), "entity": found.entity}
        world.noted(FINAL, answer, step, True)


def newest(tracks: Tracks) -> Tracks:
    """The same tracks with only the newest reading of everybody at each frame: nothing is voted on."""
    people = {who: tuple({one.frame: one for one in readings}.values()) for who, readings in tracks.people.items()}
    return Tracks(people, tracks.looks)
