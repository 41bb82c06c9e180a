"""The answer of a plan, read from fused readings of a person: always one where the person was seen.

The choices are knowledge: a reading that is none of them is passed over for the next best that is. How far readings
bear an answer out is its state: certain, supported, or open where nothing tells it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from jrdb_avr.agent.perceive.association import expected_place
from jrdb_avr.agent.perceive.geometry import around, covered
from jrdb_avr.agent.look.moments import Bracket, absence, brackets, change, postures
from jrdb_avr.agent.perceive.readings import is_value
from jrdb_avr.agent.look.ranking import RankedHypothesis, best_of_each, frames_of, slot_supports
from jrdb_avr.agent.perceive.votes import SETTLING, UNIT, FusedBox, SlotState, Tracks, settled
from jrdb_avr.queries.compiler.beliefs import DISTANCE_CUT_M
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.answers import Answer, Choice, Number
from jrdb_avr.schema.beliefs import free_value
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS, answer_of_choice, choice_of
from jrdb_avr.schema.method import Verdict
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS

CLEAR_MARGIN: Final = 2.0
"""Log-odds by which the likeliest target is better than the next one where it is certain."""

_BESIDE_DEG: Final = 10.0
"""Degrees beside the expected place that a look must show for somebody who is not seen to be away."""

_LIKELY_S: Final = 10.0
"""Seconds that are answered for the time between two events when one of them was not seen."""


class ReadAnswer(NamedTuple):
    """An answer, the frame that it was read from, and how far readings bear it out; None where nothing tells it."""

    answer: Answer | None
    frame: int
    state: SlotState


@dataclass(frozen=True)
class Conclusion:
    """The result of an episode: the answer, the person whom it is about, and that person's box at a frame."""

    answer: Answer
    entity: str
    frame: int
    box: FusedBox
    verdict: Verdict


def conclude(
    plan: Plan, tracks: Tracks, hypotheses: Sequence[RankedHypothesis], choices: Sequence[str], frames: Sequence[int]
) -> Conclusion | None:
    """Answer for the most likely target, or for a nearly as likely one if its answer is known; None if nobody fits.

    hypotheses: the best first; frames: the legal ones.
    """
    best = best_of_each(hypotheses, plan.target)
    if not best:
        return None
    order = [*best]
    reads = {who: _Reader(plan, tracks, who, choices, frames).read() for who in order}
    near = (who for who in order if best[who].log_odds >= best[order[0]].log_odds - UNIT)
    who = next((who for who in near if reads[who].answer is not None), order[0])
    answer, frame, state = reads[who]
    described = [tracks.nearest_looked(at) for at in frames_of(plan, plan.target)]
    box_frame, box = _evidence(tracks, who, frame, described)
    if answer is None:
        angle = expected_place(tracks.people[who], frame).angle
        answer = MODES[plan.answer.mode].make((frame, frame), angle)
    return Conclusion(answer, who, box_frame, box, _verdict(plan, tracks, best[who], state, box))


def _evidence(tracks: Tracks, who: str, frame: int, described: Collection[int]) -> tuple[int, FusedBox]:
    """Choose the frame and box that are submitted as evidence: preferably a box on which two readings agree.

    Evidence may be of any frame. Of several, a frame at which the plan describes the person comes first, as the person
    had to be followed to all others; then the one nearest to the answer's frame.
    """
    boxes = {one.frame: fused for one in tracks.people[who] if (fused := tracks.box(who, one.frame))}

    def doubt(at: int) -> tuple[bool, bool, int, int]:
        return boxes[at].votes < SETTLING, at not in described, abs(at - frame), at

    at = min(boxes, key=doubt)
    return at, boxes[at]


def _verdict(plan: Plan, tracks: Tracks, best: RankedHypothesis, state: SlotState, box: FusedBox) -> Verdict:
    states = [slot.state for slot in slot_supports(plan, tracks, best)]
    if state == "open" or not states or best.log_odds <= 0:
        return "guess"
    sure = box.votes >= SETTLING and best.margin >= CLEAR_MARGIN and {state, *states} == {"certain"}
    return "certain" if sure else "supported"


@dataclass(frozen=True)
class _Reader:
    """Reads a plan's answer of one person."""

    plan: Plan
    tracks: Tracks
    who: str
    choices: Sequence[str]
    frames: Sequence[int]

    def read(self) -> ReadAnswer:
        """The answer as the plan has it read, and how far readings bear it out."""
        match self.plan.answer.read:
            case "action" | "attribute":
                return self._value()
            case "next_action":
                return self._next_action()
            case "presence":
                return self._presence()
            case "distance_change":
                return self._distance_change()
            case "count":
                return self._count()
            case _:
                return self._moments()

    # -- choices ------------------------------------------------------------------------------------------------------

    def _value(self) -> ReadAnswer:
        """The choice that readings bear out best as the attribute's value, or as what the person does."""
        name, frame = self.plan.answer.attribute or "action", self._stated(0)
        values = {place: answer_of_choice(free_value(text)) for place, text in enumerate(self.choices, 1)}
        told = {
            place: self.tracks.statement(self.who, name, value, frame)
            for place, value in values.items()
            if is_value(name, value)
        }
        best = max(told, key=lambda place: told[place].log_odds, default=0)
        seen = min((one.frame for one in self.tracks.people[self.who]), key=lambda at: (abs(at - frame), at))
        if not best or told[best].log_odds <= 0:
            return ReadAnswer(None, seen, "open")
        return ReadAnswer(Choice(best), seen, told[best].state)

    def _next_action(self) -> ReadAnswer:
        """The first other posture that is one of the choices."""
        bracket = self._bracket(0)
        after = self._stated(0) if bracket is None else bracket.low
        course = postures(self.tracks, self.who, self._began(0))
        held = next(iter(course.values()), "")
        for at, posture in course.items():
            if at > after and posture != held and (choice := self._choice(posture)) is not None:
                state = settled(self.tracks.values(self.who, "pose", at))
                return ReadAnswer(choice, at, "certain" if state else "supported")
        return ReadAnswer(None, after, "open")

    def _presence(self) -> ReadAnswer:
        times = [self._stated(0), self._stated(1)]
        there = [bool(self.tracks.at(self.who, at)) for at in times]
        states = [self._present(at) for at in times]
        text = PRESENCE_ANSWERS[{(1, 1): 0, (1, 0): 1, (0, 1): 2, (0, 0): 3}[there[0], there[1]]]
        frame = next((at for at, seen in zip(times, there, strict=True) if seen), self._described())
        return ReadAnswer(self._choice(text), frame, _weakest(states))

    def _present(self, frame: int) -> SlotState:
        """How certain it is that somebody was seen at a frame, or was not there."""
        readings = len(self.tracks.at(self.who, frame))
        if readings:
            return "certain" if readings >= SETTLING else "supported"
        state = absence(self.tracks, self.who, frame)
        return "open" if state == "contradicted" else state

    def _distance_change(self) -> ReadAnswer:
        first, last = (self._stated(place) for place in (0, 1))
        if not self.tracks.at(self.who, last):
            return ReadAnswer(self._choice(DISTANCE_ANSWERS[3]), self._described(), self._present(last))
        before, after = (self.tracks.metres(self.who, at) for at in (first, last))
        if before is None or after is None:
            return ReadAnswer(None, last, "open")
        place = 2 if abs(after - before) < DISTANCE_CUT_M else 0 if after < before else 1
        return ReadAnswer(self._choice(DISTANCE_ANSWERS[place]), last, _weakest(map(self._present, (first, last))))

    def _choice(self, label: str) -> Choice | None:
        number = choice_of(label, self.choices)
        return None if number is None else Choice(number)

    # -- moments and numbers ------------------------------------------------------------------------------------------

    def _moments(self) -> ReadAnswer:
        found = [self._bracket(place) for place in range(len(self.plan.answer.times))]
        moments = [self._moment(place, one) for place, one in enumerate(found)]
        state = _weakest("open" if one is None else one.state for one in found)
        frame = next((one.high for one in found if one is not None and one.high is not None), self._described())
        first, last = round(moments[0]), round(moments[-1])
        seen = [one is not None and one.high is not None for one in found]
        passed = (moments[-1] - moments[0]) / FPS
        seconds = max(passed, 1.0 if seen[-1] else _LIKELY_S) if seen[0] else _LIKELY_S
        angle = expected_place(self.tracks.people[self.who], first).angle
        answer = MODES[self.plan.answer.mode].make((first, max(first, last)), angle, seconds)
        return ReadAnswer(answer, frame, state)

    def _moment(self, place: int, bracket: Bracket | None) -> float:
        """The moment of an event; where it was not seen, the middle of the time in which it may still lie."""
        if bracket is None:
            return (self._began(place) + self.frames[-1]) / 2
        return bracket.middle or (bracket.low + self.frames[-1]) / 2

    def _count(self) -> ReadAnswer:
        first, last = (self._stated(place) for place in (0, 1))
        looked = [at for at in self.tracks.looks if first <= at <= last]
        relation = self.plan.answer.relation or ""
        partners = {
            other
            for other in self.tracks.people
            for at in looked
            if other != self.who and self.tracks.relation(self.who, relation, other, at).log_odds > 0
        }
        seen = [at for at in looked if self.tracks.at(self.who, at)]
        frame = seen[0] if seen else first
        return ReadAnswer(Number(float(max(len(partners), 1))), frame, "supported" if partners else "open")

    # -- times --------------------------------------------------------------------------------------------------------

    def _stated(self, place: int) -> int:
        """The legal frame nearest to one of the answer's times; to the description's where that is an event."""
        time = self.plan.times[self.plan.answer.times[place]]
        frame, bracket = time.frame, self._bracket(place) if time.is_group_event else None
        if bracket is not None and bracket.high is not None:
            return bracket.high
        return self._described() if frame is None else self._legal(frame)

    def _described(self) -> int:
        """The nearest legal frame at which the target was seen to the first stated one."""
        stated = min(time.frame for time in self.plan.times.values() if time.frame is not None)
        return min((one.frame for one in self.tracks.people[self.who]), key=lambda at: (abs(at - stated), at))

    def _began(self, place: int) -> int:
        """The frame after which an event of the answer lies."""
        time = self.plan.times[self.plan.answer.times[place]]
        while time.after is not None:
            time = self.plan.times[time.after]
        return self._legal(time.frame or 0)

    def _legal(self, frame: int) -> int:
        return min(self.frames, key=lambda at: (abs(at - frame), at))

    def _bracket(self, place: int) -> Bracket | None:
        name = self.plan.answer.times[place]
        found = brackets(self.plan, self.tracks, self.who).get(name)
        return found if found is not None and found.high is not None else self._likely_absence().get(name, found)

    def _likely_absence(self) -> dict[str, Bracket]:
        """When somebody leaves and returns, if whoever is not where they are expected is away."""
        times = {self.plan.times[name].event: name for name in self.plan.answer.times}
        if "leaves" not in times or "returns" not in times:
            return {}
        leaves = change(self._there(), self._began(0), wanted=False)
        if leaves.high is None:
            return {times["leaves"]: leaves}
        return {times["leaves"]: leaves, times["returns"]: change(self._there(), leaves.high, wanted=True)}

    def _there(self) -> dict[int, bool]:
        """Whether somebody was seen, at the frames at which a look shows where they are expected."""
        readings, looks = self.tracks.people[self.who], self.tracks.looks
        arcs = {at: around(expected_place(readings, at).angle, _BESIDE_DEG) for at in looks}
        return {at: bool(self.tracks.at(self.who, at)) for at in looks if covered(looks[at], arcs[at])}


_ORDER: Final[tuple[SlotState, ...]] = ("open", "contradicted", "supported", "certain")


def _weakest(states: Iterable[SlotState]) -> SlotState:
    return min(states, key=_ORDER.index)
