"""The answer of a plan, read from the readings of a person by votes. A person who was seen always has an answer.

Each offered choice is a question of its own: the choice with the highest log-odds is the answer. If the model read a
posture that is not offered, the nearest offered posture is the answer. If no reading supports a choice, the answer is a
guess by a hash of the choices.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from jrdb_avr.agent.look.moments import Bracket, absence, brackets, postures
from jrdb_avr.agent.look.ranking import RankedHypothesis, SlotSupport, best_of_each, frames_of, slot_supports
from jrdb_avr.agent.perceive.expectation import expected_place
from jrdb_avr.agent.perceive.geometry import FIRST
from jrdb_avr.agent.perceive.votes import CERTAIN, UNIT, SlotState, Tracks
from jrdb_avr.schema.answer_modes import MODES
from jrdb_avr.schema.answers import Answer, AnswerMode, Choice, Number
from jrdb_avr.schema.beliefs import free_value
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, PRESENCE_ANSWERS, answer_of_choice, choice_of
from jrdb_avr.schema.method import Verdict
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import FPS

CLEAR_ODDS: Final = 1.0
"""Minimum log-odds of the binding of a certain target."""

CLEAR_SHARE: Final = 0.65
"""Minimum probability of a certain target among all people who were read, if one of them is meant."""

CLEAR_HEIGHT: Final = 80.0
"""Minimum height in pixels of a certain target, because readings of smaller people are often wrong."""

DISTANCE_CUT_M: Final = 1.0
"""Change of distance in metres below which a person stays at the same distance."""

_LIKELY_S: Final = 10.0
"""Seconds between two events if one of them was not seen."""

CHANGES: Final = (
    *(("walking", "standing", 1215), ("walking", "going upstairs", 222), ("standing", "bending", 125)),
    *(("walking", "going downstairs", 54), ("walking", "bending", 43), ("sitting", "bending", 27)),
    *(("standing", "sitting", 22), ("standing", "going upstairs", 13), ("walking", "running", 7)),
    *(("standing", "going downstairs", 6), ("walking", "sitting", 5), ("standing", "cycling", 4)),
    *(("walking", "cycling", 3), ("sitting", "lying", 2), ("going upstairs", "going downstairs", 2)),
    *(("standing", "running", 1), ("bending", "running", 1), ("bending", "cycling", 1)),
)
"""Pairs of postures, and how often a person's label changes from either to the other, the most frequent first.

Counted in JRDB's action labels of 27 sequences, between keyframes that are 15 frames apart, if both frames have exactly
one posture of the person. Such postures are confused easily, also by annotators. Other pairs do not occur.
"""

_MOST_DIGITS: Final = 5
"""Maximum number of digits of a choice that is a number of people."""

_OFTEN: Final = 100
"""Minimum number of changes between two postures. From this number on, no reading of either posture is certain."""

_WEAKEST: Final[tuple[SlotState, ...]] = ("open", "contradicted", "supported", "certain")


class ReadAnswer(NamedTuple):
    """An answer, the frame of the readings that give it, and how well readings support it. The answer may be None."""

    answer: Answer | None
    frame: int
    state: SlotState


@dataclass(frozen=True)
class Conclusion:
    """The result of an episode.

    Attributes:
        answer: The answer.
        entity: The person of the answer.
        frame: Frame of the evidence.
        box: Box of the person at `frame`, in stitched pixels.
        verdict: How well readings support the answer.
    """

    answer: Answer
    entity: str
    frame: int
    box: Box
    verdict: Verdict


def conclude(
    plan: Plan,
    tracks: Tracks,
    hypotheses: Sequence[RankedHypothesis],
    choices: Sequence[str],
    frames: Sequence[int],
    slots: Callable[[RankedHypothesis], Sequence[SlotSupport]] | None = None,
) -> Conclusion | None:
    """Return the answer about the first readable person of `near_targets`, or a guess about the likeliest target.

    Args:
        plan: The plan.
        tracks: Readings and looks. The readings of `near_targets` are enough, unless `needs_everyone`.
        hypotheses: The bindings, the best first.
        choices: Choices of the question.
        frames: The legal frames of the sequence, ascending.
        slots: Function that returns the support of the plan's parts under a binding. Default: the support by `tracks`.

    Returns:
        The conclusion, or None if no person fits the plan.
    """
    best = best_of_each(hypotheses, plan.target)
    if not best:
        return None
    near = near_targets(plan, hypotheses)
    reads = {entity: _Reader(plan, tracks, entity, choices, frames).read() for entity in near}
    entity = next((entity for entity in near if reads[entity].answer is not None), near[0])
    answer, frame, state = reads[entity]
    described = [tracks.nearest_looked(at) for at in frames_of(plan, plan.target)]
    box_frame, box = _evidence(tracks, entity, frame, described)
    if answer is None:
        angle = expected_place(tracks.people[entity], frame).angle
        return Conclusion(guess_answer(plan.answer.mode, choices, frame, angle), entity, box_frame, box, "guess")
    hypothesis = best[entity]
    supports = slot_supports(plan, tracks, hypothesis) if slots is None else slots(hypothesis)
    states = [support.state for _, support in supports]
    verdict: Verdict = "guess"
    if states and hypothesis.log_odds > 0 and state != "open":
        share = math.exp(hypothesis.log_odds) / sum(math.exp(item.log_odds) for item in best.values())
        clear = hypothesis.log_odds >= CLEAR_ODDS and share >= CLEAR_SHARE and box.h >= CLEAR_HEIGHT
        # A person who is missed on the way moves all later ends of a chain. "At neither time" may mean missed, too.
        clear = clear and not any(edge.relation in FIRST for edge in plan.edges)
        clear = clear and answer != Choice(choice_of(PRESENCE_ANSWERS[3], choices) or 0)
        verdict = "certain" if clear and {state, *states} == {"certain"} else "supported"
    return Conclusion(answer, entity, box_frame, box, verdict)


def near_targets(plan: Plan, hypotheses: Sequence[RankedHypothesis]) -> list[str]:
    """Return the likeliest target, and the targets that are at most one reading less likely, the best first."""
    best = best_of_each(hypotheses, plan.target)
    least = max((row.log_odds for row in best.values()), default=0.0) - UNIT
    return [entity for entity in best if best[entity].log_odds >= least]


def needs_everyone(plan: Plan) -> bool:
    """Return whether the answer depends on readings of other people than the target."""
    grouped = plan.answer.attribute == "group_size" or any(time.is_group_event for time in plan.times.values())
    return grouped or plan.answer.read == "count"


def guess_answer(mode: AnswerMode, choices: Sequence[str], frame: int, angle: float) -> Answer:
    """Return a guess: the choice of `guess_choice`, or without choices a frame and an angle.

    Args:
        mode: Answer mode of the question.
        choices: Choices of the question.
        frame: The frame.
        angle: Panorama angle in degrees.

    Returns:
        The answer.
    """
    return guess_choice(choices) if choices else MODES[mode].make((frame, frame), angle)


def guess_choice(choices: Sequence[str]) -> Choice:
    """Return the choice that a hash of all choices picks, so that guesses favour no position.

    Args:
        choices: The choices.

    Returns:
        A choice.
    """
    digest = hashlib.sha256("\n".join(choices).encode()).digest()
    return Choice(int.from_bytes(digest[:8], "big") % len(choices) + 1)


def nearest_postures(posture: str) -> tuple[str, ...]:
    """Return the postures that change into a posture, the most frequent first.

    Args:
        posture: The posture.

    Returns:
        Other postures.
    """
    pairs = [{first, last} for first, last, _ in CHANGES if posture in (first, last)]
    return tuple((pair - {posture}).pop() for pair in pairs)


def is_doubted(label: str) -> bool:
    """Return whether a label is a posture that often changes into another one, so that no reading of it is certain."""
    return any(count >= _OFTEN and label in (first, last) for first, last, count in CHANGES)


def _evidence(tracks: Tracks, entity: str, frame: int, described: Collection[int]) -> tuple[int, Box]:
    """Return the frame and box to submit as evidence.

    A box that no edge cuts comes first. Then a frame of the person's description in the plan comes before other frames,
    because the agent must recognize the person again at other frames. Then the nearest frame to the answer's is best.
    """
    readings = {at: reading for at in {item.frame for item in tracks.people[entity]}
                if (reading := tracks.best_reading(entity, at)) is not None}  # fmt: skip
    at = min(readings, key=lambda at: (not readings[at].whole, at not in described, abs(at - frame), at))
    return at, readings[at].box


@dataclass(frozen=True)
class _Reader:
    """Reads a plan's answer of one person."""

    plan: Plan
    tracks: Tracks
    entity: str
    choices: Sequence[str]
    frames: Sequence[int]

    def read(self) -> ReadAnswer:
        """Return the answer as the plan asks for it."""
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
        """Return the choice with the highest log-odds as the attribute's value or the person's action."""
        name, frame = self.plan.answer.attribute or "action", self._stated(0)
        values = [answer_of_choice(free_value(text)) for text in self.choices]
        odds = {
            index: self.tracks.statement(self.entity, name, value, frame).log_odds
            for index, value in enumerate(values, 1)
            if name != "group_size" or (value.isdecimal() and len(value) <= _MOST_DIGITS)
        }
        order = sorted(odds, key=lambda index: (-odds[index], index))
        sighted = min(self._read_frames(), key=lambda at: (abs(at - frame), at))
        if order and odds[order[0]] > 0:
            ahead = odds[order[0]] - (odds[order[1]] if len(order) > 1 else 0.0)
            sure = odds[order[0]] >= CERTAIN and ahead >= CERTAIN and not is_doubted(values[order[0] - 1])
            return ReadAnswer(Choice(order[0]), sighted, "certain" if sure else "supported")
        near = self._nearest_posture(values, frame) if name == "action" else None
        return ReadAnswer(near, sighted, "open" if near is None else "supported")

    def _nearest_posture(self, values: Sequence[str], frame: int) -> Choice | None:
        """Return the offered posture that is nearest to the posture that was read, None without one."""
        likeliest, odds = next(iter(self.tracks.values(self.entity, "pose", frame).items()), ("", 0.0))
        near = (posture for posture in nearest_postures(likeliest) if odds > 0 and posture in values)
        return next((Choice(values.index(posture) + 1) for posture in near), None)

    def _next_action(self) -> ReadAnswer:
        """Return the first other posture that is one of the choices."""
        bracket = self._bracket(0)
        after = self._stated(0) if bracket is None else bracket.low
        course = postures(self.tracks, self.entity, self._began(0))
        first = next(iter(course.values()), "")
        for at, posture in course.items():
            if at > after and posture != first and (choice := self._choice(posture)) is not None:
                sure = max(self.tracks.values(self.entity, "pose", at).values()) >= CERTAIN and not is_doubted(posture)
                return ReadAnswer(choice, at, "certain" if sure else "supported")
        return ReadAnswer(None, after, "open")

    def _presence(self) -> ReadAnswer:
        times = [self._stated(0), self._stated(1)]
        present = [bool(self.tracks.readings_at(self.entity, at)) for at in times]
        text = PRESENCE_ANSWERS[{(1, 1): 0, (1, 0): 1, (0, 1): 2, (0, 0): 3}[present[0], present[1]]]
        frame = next((at for at, sighted in zip(times, present, strict=True) if sighted), self._described())
        return ReadAnswer(self._choice(text), frame, _weakest(map(self._present, times)))

    def _present(self, frame: int) -> SlotState:
        """Return how certain it is that the person was seen at a frame, or was absent."""
        if self.tracks.readings_at(self.entity, frame):
            return "certain"
        state = absence(self.tracks, self.entity, frame)
        return "open" if state == "contradicted" else state

    def _distance_change(self) -> ReadAnswer:
        first, last = (self._stated(index) for index in (0, 1))
        if not self.tracks.readings_at(self.entity, last):
            return ReadAnswer(self._choice(DISTANCE_ANSWERS[3]), self._described(), self._present(last))
        before, after = (self.tracks.metres(self.entity, at) for at in (first, last))
        if before is None or after is None:
            return ReadAnswer(None, last, "open")
        index = 2 if abs(after - before) < DISTANCE_CUT_M else 0 if after < before else 1
        return ReadAnswer(self._choice(DISTANCE_ANSWERS[index]), last, _weakest(map(self._present, (first, last))))

    def _choice(self, label: str) -> Choice | None:
        index = choice_of(label, self.choices)
        return None if index is None else Choice(index)

    # -- moments and numbers ------------------------------------------------------------------------------------------

    def _moments(self) -> ReadAnswer:
        indexes = range(len(self.plan.answer.times))
        events = [self._bracket(index) or Bracket(self._began(index), None) for index in indexes]
        # If no look shows an event, its moment is the middle of the time that is left for it.
        moments = [event.middle or (event.low + self.frames[-1]) / 2 for event in events]
        state = _weakest(event.state for event in events)
        frame = next((event.high for event in events if event.high is not None), None)
        first, last = round(moments[0]), round(moments[-1])
        sighted = [event.high is not None for event in events]
        passed = (moments[-1] - moments[0]) / FPS
        seconds = max(passed, 1.0 if sighted[-1] else _LIKELY_S) if sighted[0] else _LIKELY_S
        angle = expected_place(self.tracks.people[self.entity], first).angle
        answer = MODES[self.plan.answer.mode].make((first, max(first, last)), angle, seconds)
        return ReadAnswer(answer, self._described() if frame is None else frame, state)

    def _count(self) -> ReadAnswer:
        first, last = (self._stated(index) for index in (0, 1))
        looked = [at for at in self.tracks.looks if first <= at <= last]
        relation = self.plan.answer.relation or ""
        partners = {
            partner
            for partner in self.tracks.people
            for at in looked
            if partner != self.entity and self.tracks.relation(self.entity, relation, partner, at).log_odds > 0
        }
        sighted = [at for at in looked if self.tracks.readings_at(self.entity, at)]
        frame = sighted[0] if sighted else first
        return ReadAnswer(Number(float(max(len(partners), 1))), frame, "supported" if partners else "open")

    # -- times --------------------------------------------------------------------------------------------------------

    def _read_frames(self) -> set[int]:
        return {reading.frame for reading in self.tracks.people[self.entity]}

    def _stated(self, index: int) -> int:
        """Return the legal frame nearest to one of the answer's times, or the described frame if the time is open."""
        time = self.plan.times[self.plan.answer.times[index]]
        bracket = self._bracket(index) if time.is_group_event else None
        if bracket is not None and bracket.high is not None:
            return bracket.high
        return self._described() if time.frame is None else self._legal(time.frame)

    def _described(self) -> int:
        """Return the frame with a reading of the target that is nearest to the first stated frame."""
        stated = min(time.frame for time in self.plan.times.values() if time.frame is not None)
        return min(self._read_frames(), key=lambda at: (abs(at - stated), at))

    def _began(self, index: int) -> int:
        """Return the frame after which an event of the answer is expected."""
        time = self.plan.times[self.plan.answer.times[index]]
        while time.after is not None:
            time = self.plan.times[time.after]
        return self._legal(time.frame or 0)

    def _legal(self, frame: int) -> int:
        return min(self.frames, key=lambda at: (abs(at - frame), at))

    def _bracket(self, index: int) -> Bracket | None:
        return brackets(self.plan, self.tracks, self.entity).get(self.plan.answer.times[index])


def _weakest(states: Iterable[SlotState]) -> SlotState:
    return min(states, key=_WEAKEST.index)
