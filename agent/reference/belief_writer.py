"""What the policy `driven` writes into its world model: readings and their votes, and who fits the plan.

Each reading is an edge. The one that all readings of its place come to is current; where that is an older one, it is
stated again, as derived, so that what is current always bears the newest count of votes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING, Final

import msgspec

from jrdb_avr.agent.beliefs.world_model import Backing
from jrdb_avr.agent.look.answer import Conclusion, conclude
from jrdb_avr.agent.perceive.geometry import DERIVED
from jrdb_avr.agent.perceive.readings import PersonReading, ReadLabel
from jrdb_avr.agent.look.ranking import RankedHypothesis, best_of_each, frames_of, parts_of
from jrdb_avr.agent.perceive.votes import Tracks
from jrdb_avr.schema.answers import encode_answer
from jrdb_avr.schema.beliefs import HypothesisRow
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.method import Task, Verdict
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.solver import BeliefSolver
    from jrdb_avr.agent.beliefs.world_model import BeliefEpisode

_FROM_BOXES: Final = frozenset({"sector", "distance", "group_size"})
"""Attributes that boxes, distances and ties tell as well as a reading."""

_MOST_RANKED: Final = 5
"""Hypotheses that are written down, each of another target."""


@dataclass(frozen=True)
class BeliefWriter:
    """Writes what was read and concluded in an episode into its world model.

    asked: the plan that is proved; plan: the same as pictures are read for it; lefts: the first column of each picture
    that was read, by name, which grows with them.
    """

    world: BeliefEpisode
    solver: BeliefSolver
    asked: Plan
    plan: Plan
    task: Task
    lefts: dict[str, int]

    # -- a picture ----------------------------------------------------------------------------------------------------

    def picture(self, tracks: Tracks, people: Sequence[PersonReading], left: int, step: int) -> None:
        """Write down what was read of the people of a picture, once they are among the tracks."""
        if not people:
            return
        self.lefts[people[0].observation] = left
        names = {
            one.number: who
            for who, readings in tracks.people.items()
            for one in readings
            if one.observation == people[0].observation
        }
        for one in people:
            self._sighting(tracks, names[one.number], one, step)
            self._labels(tracks, names[one.number], one, step)
            self._metres(tracks, names[one.number], one, step)
        for one in people:
            for tie in one.ties:
                ends = {"source": names[one.number], "target": names[tie.other]}
                support = tracks.relation(ends["source"], tie.relation, ends["target"], one.frame)
                call = {**ends, "name": tie.relation, "observation": one.observation}
                backing = Backing(max(support.votes, 1), support.against, wins=support.log_odds > 0)
                if not tie.holds:
                    # Stated again where others outvote it, and no longer believed where they do not.
                    backing = backing._replace(votes=backing.votes * backing.wins, origin="derived")
                self.world.add("add_relation", call, step, backing=backing)

    def _sighting(self, tracks: Tracks, who: str, one: PersonReading, step: int) -> None:
        best = tracks.agreed(who, one.frame)
        self._place(tracks, who, one, step, Backing(wins=best is one))
        if best is not None and best is not one:
            self._place(tracks, who, best, step, Backing(origin="derived"))

    def _place(self, tracks: Tracks, who: str, one: PersonReading, step: int, backing: Backing, node: str = "") -> None:
        """Write a sighting, with how many boxes of the person at its frame are the same as its own and how many not."""
        votes = tracks.agreeing(one, who)
        box = Box(one.box.x - self.lefts[one.observation], *one.box[1:])
        call = {"id": who, "kind": "person", "observation": one.observation, "box": [round(side) for side in box]}
        backing = backing._replace(votes=votes, against=len(tracks.at(who, one.frame)) - votes)
        self.world.add("add_entity", call | ({"node": node} if node else {}), step, box, backing)

    def _labels(self, tracks: Tracks, who: str, one: PersonReading, step: int) -> None:
        for topic in dict.fromkeys(label.topic for label in one.labels):
            tallies = tracks.values(who, topic, one.frame)
            best = tallies[0].value if tallies and tallies[0].weight > 0 else None
            said = [label for label in one.labels if label.topic == topic]
            for label in said:
                if label.holds:
                    self._attribute(tracks, who, label, one, step, Backing(wins=label.value == best))
            if best is None:
                # Nothing is believed of it any more.
                call = {"entity": who, "name": said[0].name, "value": said[0].value, "observation": one.observation}
                self.world.add("add_attribute", call, step, backing=Backing(votes=0))
            elif not any(label.holds and label.value == best for label in said):
                stated = ReadLabel(said[0].name, best)
                older = next(
                    o for o in reversed(tracks.people[who]) if any(_states(label, stated) for label in o.labels)
                )
                self._attribute(tracks, who, stated, older, step, Backing(origin="derived"))

    def _attribute(
        self, tracks: Tracks, who: str, label: ReadLabel, one: PersonReading, step: int, backing: Backing
    ) -> None:
        support = tracks.statement(who, label.name, label.value, one.frame)
        backing = backing._replace(votes=max(support.votes, 1), against=support.against)
        call = {"entity": who, "name": label.name, "value": label.value, "observation": one.observation}
        self.world.add("add_attribute", call, step, backing=backing)

    def _metres(self, tracks: Tracks, who: str, one: PersonReading, step: int) -> None:
        median = tracks.metres(who, one.frame)
        if one.metres is None or median is None:
            return
        votes = sum(other.metres is not None for other in tracks.at(who, one.frame))
        call = {"entity": who, "name": "distance_m", "observation": one.observation}
        alike = one.metres == median
        self.world.add(
            "add_attribute", {**call, "value": one.metres}, step, backing=Backing(votes if alike else 1, wins=alike)
        )
        if not alike:
            self.world.add("add_attribute", {**call, "value": median}, step, backing=Backing(votes, origin="derived"))

    # -- the end ------------------------------------------------------------------------------------------------------

    def concluded(
        self, tracks: Tracks, hypotheses: Sequence[RankedHypothesis], found: Conclusion, step: int
    ) -> Verdict:
        """Write down who the plan's people are, how they stand to each other, and the answer; returns its verdict.

        It is certain only where the compiled plan, which the engine runs, finds the same target.
        """
        self._derived(tracks, step)
        target = self.plan.target
        best = next((one for one in hypotheses if one.nodes.get(target) == found.entity), hypotheses[0])
        for node, who in best.nodes.items():
            described = [tracks.nearest_looked(frame) for frame in frames_of(self.plan, node)]
            for frame in [found.frame] if who == found.entity else described:
                if (seen := tracks.agreed(who, frame)) is not None:
                    self._place(tracks, who, seen, step, Backing(origin="derived"), node)
        verdict = found.verdict
        if verdict == "certain" and not self._proved(found.entity):
            verdict = "supported"
        answer = {"answer": msgspec.to_builtins(found.answer), "entity": found.entity}
        self.world.answered(answer, step, verdict, self._ranked(tracks, hypotheses, best, step))
        return verdict

    def _derived(self, tracks: Tracks, step: int) -> None:
        """What boxes and ties tell of the plan's parts, of everybody: who else fits is to be seen too."""
        for part in parts_of(self.plan):
            if part.name not in _FROM_BOXES | DERIVED:
                continue
            at = tracks.nearest_looked(part.frame or 0)
            seen = {who: one for who in tracks.people if (one := tracks.agreed(who, at)) is not None}
            for people in permutations(seen, len(part.nodes)):
                support = part.support(tracks, people)
                if support.log_odds <= 0:
                    continue
                backing = Backing(max(support.votes, 1), support.against, "derived")
                call: dict[str, str | int] = {"observation": seen[people[0]].observation}
                if len(people) == 2:
                    call |= {"source": people[0], "name": part.name, "target": people[1]}
                    self.world.add("add_relation", call, step, backing=backing)
                else:
                    value = int(part.value) if part.name == "group_size" else part.value
                    call |= {"entity": people[0], "name": part.name, "value": value}
                    self.world.add("add_attribute", call, step, backing=backing)

    def _proved(self, entity: str) -> bool:
        """Whether the compiled plan finds this target; False also where it takes too long."""
        self.world.settle()
        rows = self.world.rows()
        for plan in self.solver.placements(self.asked, rows, anywhere=False):
            if self.solver.weigh(plan, rows).people.get(plan.target) == entity:
                try:
                    return self.solver.solve(plan, rows).people.get(plan.target) == entity
                except QueryError:
                    return False
        return False

    def _ranked(
        self, tracks: Tracks, hypotheses: Sequence[RankedHypothesis], best: RankedHypothesis, step: int
    ) -> list[HypothesisRow]:
        """The likeliest hypotheses, first the one that is answered by, each of another target."""
        order = [best, *best_of_each(hypotheses, self.plan.target).values()]
        rows: dict[str, HypothesisRow] = {}
        for one in order:
            entity = one.nodes[self.plan.target]
            found = conclude(self.plan, tracks, [one], self.task.question.choices, self.task.sequence.frames)
            if found is None or entity in rows or len(rows) >= _MOST_RANKED:
                continue
            rank, key = len(rows) + 1, self.world.key
            nodes = ", ".join(f"{node}={who}" for node, who in one.nodes.items())
            answer = encode_answer(found.answer)
            rows[entity] = HypothesisRow(
                f"{key}/h{rank}", key, step, rank, entity, nodes, one.log_odds, answer, found.frame
            )
        return list(rows.values())


def _states(label: ReadLabel, stated: ReadLabel) -> bool:
    return label.holds and (label.name, label.value) == (stated.name, stated.value)
