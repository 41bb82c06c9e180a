"""The next looks: the ones that are expected to yield most, in bits, about the open parts of a plan.

While more looks are left than the answer needs, looks identify the people of the plan. Then looks follow the target,
bracket events and show absences. No look is made only to agree with an earlier one, because errors of a model repeat. A
look is repeated if an edge of the picture cut the person, if a field could not be read, or if the value is not offered.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from jrdb_avr.agent.look.moments import Bracket, brackets, presence
from jrdb_avr.agent.look.ranking import RankedHypothesis, best_of_each, frames_of, slot_supports
from jrdb_avr.agent.perceive.expectation import expected_place
from jrdb_avr.agent.perceive.geometry import CIRCLE, EDGE_DEG, Arc, around, covered, deciding_arc, gaps
from jrdb_avr.agent.perceive.readings import CONFIDENCE
from jrdb_avr.agent.perceive.votes import UNIT, Tracks
from jrdb_avr.schema.labels import ROBOT_SECTORS, answer_of_choice
from jrdb_avr.schema.panorama import CROP, FOV_DEG, WIDTH, angle_error, clockwise
from jrdb_avr.schema.plan import Plan, Read
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, LoadRules

Purpose = Literal["identify", "verify", "follow", "bracket", "absence", "evidence"]

RESERVES: Final[dict[Read, int]] = {
    "presence": 18,
    "span": 18,
    "seconds_between": 18,
    "start": 17,
    "start_view": 17,
    "next_action": 16,
    "count": 12,
    "distance_change": 10,
    "action": 5,
    "attribute": 5,
}
"""Number of looks that are kept for the answer once the target is known."""

SAME_FRAME_RESERVE: Final = 3
"""Number of looks that are kept for an action or attribute at the frame of the description."""

_LAST: Final = 4
"""Number of looks that are kept for the answer if the target is not known."""

LEAST_BITS: Final = 0.05
"""Minimum expected bits of a look."""

_AXIS_BITS: Final = 9.0
"""Bits of the look along the axis of a stated sector, which comes first."""

_MOST_READINGS: Final = 2
"""Maximum number of readings of a person in a frame."""

_RIVALS: Final = 8
"""Maximum number of bindings with different targets that looks verify."""

_ASIDE_DEG: Final = 12.0
"""Angle in degrees by which a look may be turned aside from one person to show other people too."""

_ANSWER_BITS: Final = 2.0
_OVERLAP_DEG: Final = 6.0
_APART_DEG: Final = 1.5
"""Minimum angle in degrees between two looks at a frame."""

_PEOPLE: Final = 6.0
"""Expected number of people in the whole panorama before any person was seen."""

_MISSED: Final = 0.3
"""Expected number of people who were present and not read."""

_AWAY: Final = 0.05
"""Probability that a person is not present at all."""

_CLOSE_FRAMES: Final = 28
"""Length in frames to which the bracket of an event is narrowed."""

_CLOSER: Final = {"span": 14}
"""Length in frames to which brackets are narrowed for reads that are scored by the overlap of spans."""

_TRIES: Final = 3
"""Maximum number of looks at one frame for a person who is followed."""

_NEARBY: Final = 24
"""Number of frames for which a person stays near the last place."""

_STEP: Final = round(2 * FPS)
"""Minimum step in frames when following a person: events of questions last at least this long."""

_SHORTEST: Final = round(1.2 * FPS)
"""Minimum gap in frames between two looks that may hide an event."""

_CLOSING: Final = 4
"""Number of looks that are kept to narrow a bracket."""

_EARLY: Final = 0.75
"""Length of a step as a share of an even step, because the events of questions are early."""

_SECTOR_REACH: Final = LoadRules().sector_false_deg


class NextLook(NamedTuple):
    """A look to make: frame, panorama angle in degrees, purpose, the expected bits, and a reason."""

    frame: int
    angle: float
    purpose: Purpose
    bits: float
    reason: str = ""


def next_looks(
    plan: Plan,
    tracks: Tracks,
    hypotheses: Sequence[RankedHypothesis],
    left: int,
    frames: Sequence[int],
    most: int = 1,
    choices: Sequence[str] = (),
) -> tuple[NextLook, ...]:
    """Return the looks that are expected to yield most.

    Args:
        plan: The plan.
        tracks: All readings and looks so far.
        hypotheses: The bindings, the best first.
        left: Number of looks that may still be made.
        frames: Frames at which looks can be made, ascending.
        most: Maximum number of looks.
        choices: Choices of the question. If no reading of the target supports a choice, the target is read again.

    Returns:
        Different looks, the best first. Empty if no look is worth making.
    """
    if left <= 0 or not frames:
        return ()
    attention = _Attention(plan, tracks, hypotheses, left, frames, choices)
    people, answer = [*attention.identify(), *attention.verify()], [*attention.read(), *attention.evidence()]
    kept = attention.reserve if attention.identified else _LAST
    for looks in (people, answer) if left > kept else (answer, people):
        best: list[NextLook] = []
        for look in sorted(looks, key=lambda look: -look.bits):
            if len(best) < most and look.bits >= LEAST_BITS and not any(_are_alike(look, second) for second in best):
                best.append(look)
        if best:
            return tuple(look._replace(angle=_turn_aside(tracks, look.frame, look.angle)) for look in best)
    return ()


def _are_alike(look: NextLook, second: NextLook) -> bool:
    return look.frame == second.frame and bool(angle_error(look.angle, second.angle) < FOV_DEG / 2)


@dataclass(frozen=True)
class _Attention:
    """The candidates for the next look."""

    plan: Plan
    tracks: Tracks
    hypotheses: Sequence[RankedHypothesis]
    left: int
    frames: Sequence[int]
    choices: Sequence[str]

    @property
    def reserve(self) -> int:
        """Number of looks that are kept for the answer."""
        answer = self.plan.answer
        described = {self.legal(frame) for frame in frames_of(self.plan, answer.of)}
        stated = self.plan.times[answer.times[0]].frame or 0
        if answer.read in ("action", "attribute") and self.legal(stated) in described:
            return SAME_FRAME_RESERVE
        return RESERVES[answer.read]

    @property
    def identified(self) -> bool:
        """Whether readings support each part of the plan, and the best target has a margin over the others."""
        if not self.hypotheses or self.hypotheses[0].margin < UNIT / 2:
            return False
        return all(support.log_odds > 0 for _, support in slot_supports(self.plan, self.tracks, self.hypotheses[0]))

    @property
    def target(self) -> str | None:
        """Name of the likeliest target, None before any person was seen."""
        return self.hypotheses[0].nodes.get(self.plan.target) if self.hypotheses else None

    def legal(self, frame: float) -> int:
        """Return the legal frame that is nearest to a frame."""
        index = bisect.bisect_left(self.frames, frame)
        return min(self.frames[max(index - 1, 0) : index + 1], key=lambda at: abs(at - frame))

    def _crowd(self, frame: int) -> tuple[float, float]:
        """Return the expected number of people at a frame, and how many of them no look shows."""
        unseen = sum(gap.span for gap in gaps(self.tracks.looks.get(frame, ()), CIRCLE)) / 360.0
        present = sum(bool(self.tracks.readings_at(entity, frame)) for entity in self.tracks.people)
        crowd = present / (1 - unseen) if present else _PEOPLE * max(unseen, 0.2)
        return crowd, crowd * unseen

    # -- the people of the plan -----------------------------------------------------------------------------------

    def identify(self) -> Iterator[NextLook]:
        """Yield looks at unseen arcs, in the frames for which the plan describes a person."""
        for node in self.plan.nodes:
            axes = [ROBOT_SECTORS[str(part.value)] for part in node.conditions if part.attribute == "sector"]
            fitting = sum(math.exp(min(odds, 20.0)) for odds in self._odds(node.id).values())
            for frame in map(self.legal, frames_of(self.plan, node.id)):
                looks = self.tracks.looks.get(frame, ())
                if axes and not looks:
                    yield NextLook(frame, axes[0], "identify", _AXIS_BITS, f"the plan states the sector of {node.id}")
                crowd, unseen = self._crowd(frame)
                arc = self._arc(node.id, frame)
                for gap in gaps(looks, arc):
                    share = crowd * min(gap.span, FOV_DEG - _OVERLAP_DEG / 2) / arc.span
                    rest = unseen - crowd * min(gap.span, FOV_DEG - _OVERLAP_DEG / 2) / 360.0
                    bits = 2 * _learned(share / (share + fitting + _MISSED + rest))
                    angle = gap.start - _OVERLAP_DEG / 2 + FOV_DEG / 2
                    yield NextLook(frame, angle, "identify", bits, f"{node.id} may be where no look shows")

    def _odds(self, node: str) -> dict[str, float]:
        """Return the log-odds of each entity that may be a node, by its conditions and the edges that lead to it."""
        best: dict[str, float] = {}
        for hypothesis in self.hypotheses:
            if node in hypothesis.nodes:
                supports = slot_supports(self.plan, self.tracks, hypothesis)
                odds = sum(part.evidence(support.log_odds) for part, support in supports if part.nodes[-1] == node)
                entity = hypothesis.nodes[node]
                best[entity] = max(odds, best.get(entity, odds))
        return best

    def _arc(self, node: str, frame: int) -> Arc:
        """Return the smallest arc in which the plan permits the person of a node."""
        arcs = [CIRCLE]
        for condition in next(item for item in self.plan.nodes if item.id == node).conditions:
            if condition.attribute == "sector":
                arcs.append(around(ROBOT_SECTORS[str(condition.value)], _SECTOR_REACH))
        for edge in self.plan.edges if self.hypotheses else ():
            source = self.tracks.box(self.hypotheses[0].nodes.get(edge.source, ""), frame)
            if edge.target == node and source is not None:
                arcs.append(deciding_arc(edge.relation, source))
        return min(arcs, key=lambda arc: arc.span)

    def verify(self) -> Iterator[NextLook]:
        """Yield looks at the people of the best bindings with open parts."""
        best = [*best_of_each(self.hypotheses, self.plan.target).values()][:_RIVALS]
        odds = [math.exp(min(hypothesis.log_odds, 20.0)) for hypothesis in best]
        others = _MISSED + self._crowd(self.legal(frames_of(self.plan, self.plan.root)[0]))[1]
        bits: dict[tuple[str, int], float] = {}
        for hypothesis, chance in zip(best, (value / (sum(odds) + others) for value in odds), strict=True):
            for part, support in slot_supports(self.plan, self.tracks, hypothesis):
                if support.log_odds != 0:
                    continue
                stated = frames_of(self.plan, part.nodes[0])[0] if part.frame is None else part.frame
                for entity in (hypothesis.nodes[node] for node in part.nodes if node in hypothesis.nodes):
                    key = entity, self.legal(stated)
                    bits[key] = bits.get(key, 0.0) + max(_learned(chance), chance * _learned(0.5))
        for frame in dict.fromkeys(frame for _, frame in bits):
            yield from self._views(frame, {entity: gain for (entity, at), gain in bits.items() if at == frame})

    def _views(self, frame: int, bits: Mapping[str, float]) -> Iterator[NextLook]:
        """Yield looks at people, with the bits of each. One look may show several people."""
        angles = {}
        for entity, gain in bits.items():
            if not self.tracks.readings_at(entity, frame):
                reason = f"{entity} may fit the plan and was not seen at this frame"
                if (look := self._search(entity, frame, gain, "verify", reason)) is not None:
                    yield look
            elif len(self.tracks.readings_at(entity, frame)) < _MOST_READINGS:
                angles[entity] = self._angle(entity, frame)
        for angle in [base + turn for turn in (0.0, -_ASIDE_DEG, _ASIDE_DEG) for base in angles.values()]:
            shown = [name for name, at in angles.items() if angle_error(angle, at) < FOV_DEG / 2 - EDGE_DEG]
            reason = f"parts of the plan are open for {', '.join(shown)}"
            yield NextLook(frame, angle % 360.0, "verify", sum(bits[name] for name in shown), reason)

    # -- the answer -----------------------------------------------------------------------------------------------

    def read(self) -> Iterator[NextLook]:
        """Yield looks that read the answer of the likeliest target."""
        answer, entity = self.plan.answer, self.target
        if entity is None:
            return
        stated = [frame for name in answer.times if (frame := self.plan.times[name].frame) is not None]
        for frame in map(self.legal, stated):
            yield from self._read_at(entity, frame)
        if answer.read == "count" and len(stated) == 2:
            yield from self._count(entity, self.legal(stated[0]), self.legal(stated[1]))
        for bracket in brackets(self.plan, self.tracks, entity).values():
            yield from self._bracket(entity, bracket)

    def _read_at(self, entity: str, frame: int) -> Iterator[NextLook]:
        """Yield a look at the target at a stated frame, or looks that show its absence."""
        readings = self.tracks.readings_at(entity, frame)
        if readings:
            if len(readings) < _MOST_READINGS and not self._answered(entity, frame):
                reason = f"no reading of {entity} at this frame gives an answer"
                yield NextLook(frame, self._angle(entity, frame), "verify", _ANSWER_BITS * _learned(CONFIDENCE), reason)
            return
        reason = f"the answer is about {entity} at this frame"
        if (look := self._search(entity, frame, _ANSWER_BITS, "follow", reason)) is not None:
            yield look
            return
        for beside in (frame + KEYFRAME_STEP, frame - KEYFRAME_STEP):
            at = self.legal(beside)
            if 0 < abs(at - frame) <= KEYFRAME_STEP and not self._is_known_beside(entity, frame):
                reason = f"{entity} was not seen at {frame:06d}, a second away"
                if (look := self._search(entity, at, _ANSWER_BITS / 2, "absence", reason)) is not None:
                    yield look

    def _answered(self, entity: str, frame: int) -> bool:
        """Return whether a reading of the target at a frame gives an answer that is offered."""
        read = self.plan.answer.read
        if read == "distance_change":
            return self.tracks.metres(entity, frame) is not None
        if read not in ("action", "attribute"):
            return any(reading.whole for reading in self.tracks.readings_at(entity, frame))
        name = self.plan.answer.attribute or "action"
        if not self.choices:
            return any(label.name == name for item in self.tracks.readings_at(entity, frame) for label in item.labels)
        values = map(answer_of_choice, self.choices)
        return any(self.tracks.statement(entity, name, value, frame).log_odds > 0 for value in values)

    def _is_known_beside(self, entity: str, frame: int) -> bool:
        near = [at for at in self.tracks.looks if 0 < abs(at - frame) <= KEYFRAME_STEP]
        return any(presence(self.tracks, entity, at) is not None for at in near)

    def _count(self, entity: str, first: int, last: int) -> Iterator[NextLook]:
        """Yield looks in all directions at frames between two frames."""
        for part in range(3):
            frame = self.legal(first + part * (last - first) / 2)
            for gap in gaps(self.tracks.looks.get(frame, ()), CIRCLE):
                off = float(angle_error(gap.middle, self._angle(entity, frame)))
                angle = gap.start - _OVERLAP_DEG / 2 + FOV_DEG / 2
                yield NextLook(frame, angle, "follow", 0.5 - off / 1000, f"people beside {entity} are counted")

    def _bracket(self, entity: str, event: Bracket) -> Iterator[NextLook]:
        """Yield looks beyond an open bracket, or one inside a bracket that is too long."""
        low, high = event.low, event.high
        if high is None:
            yield from self._step(entity, event, self.frames[-1])
        elif high - low > _CLOSER.get(self.plan.answer.read, _CLOSE_FRAMES):
            reason = f"the event of {entity} lies between {low:06d} and {high:06d}"
            for at in [self.legal(low + share * (high - low)) for share in (0.5, 0.35, 0.65)]:
                inside = low < at < high and at not in self.tracks.looks
                if inside and (look := self._search(entity, at, 1.0, "bracket", reason)) is not None:
                    yield look
                    return

    def _step(self, entity: str, event: Bracket, last: int) -> Iterator[NextLook]:
        """Yield looks that follow a person on from a frame. At the end, look where the change may have been passed.

        A person who is missed once is looked for at the place to which the newest sighting leads, and at half of the
        time. After two misses the person is looked for on the sides.
        """
        sighted = max(event.low, *(reading.frame for reading in self.tracks.people[entity]))
        lost = sorted(at for at in self.tracks.looks if at > sighted)
        newest = max([sighted, *lost])
        even = round(_EARLY * (last - newest) / max(self.left - _CLOSING, 1))
        at = min(newest + min(max(_STEP, even), 2 * _STEP), last)
        if lost and not covered(self.tracks.looks[lost[0]], around(self._angle(entity, lost[0]), EDGE_DEG)):
            at = lost[0]
        elif len(lost) == 1 and lost[0] - sighted > _NEARBY:
            at = (sighted + lost[0]) // 2
        elif len(lost) > 1 and len(self.tracks.looks[newest]) < _TRIES:
            at = newest
        at = self.legal(at)
        reason = f"the event of {entity} was not seen up to {newest:06d}"
        if at > event.low and (look := self._search(entity, at, 1.0, "bracket", reason)) is not None:
            yield look
        if newest >= last - KEYFRAME_STEP:
            yield from self._between(entity, event.after)

    def _between(self, entity: str, after: int) -> Iterator[NextLook]:
        """Yield a look into the longest time without a look after a frame, the earliest of equal ones."""
        frames = sorted({after, *(at for at in self.tracks.looks if at > after)})
        before, then = max(itertools.pairwise(frames), key=lambda both: (both[1] - both[0], -both[0]), default=(0, 0))
        # This look has more bits than a search on the sides of the last place.
        reason = f"the event may lie between {before:06d} and {then:06d}"
        look = self._search(entity, self.legal((before + then) / 2), 1.5, "bracket", reason)
        if look is not None and then - before > _SHORTEST:
            yield look

    def evidence(self) -> Iterator[NextLook]:
        """Yield a look that shows the whole target, if an edge of the picture cuts all its boxes."""
        entity = self.target
        if entity is None:
            return
        readings = self.tracks.people[entity]
        if any(reading.whole for reading in readings):
            return
        frame = readings[-1].frame
        if len(self.tracks.readings_at(entity, frame)) < _MOST_READINGS:
            # The last looks are for the box, because without a box the answer does not count.
            bits = _ANSWER_BITS * _learned(CONFIDENCE) * (10.0 if self.left <= 2 else 0.8)
            yield NextLook(frame, self._angle(entity, frame), "evidence", bits, f"an edge cuts the box of {entity}")

    # -- the place of a person --------------------------------------------------------------------------------------

    def _angle(self, entity: str, frame: int) -> float:
        return expected_place(self.tracks.people[entity], frame).angle

    def _search(self, entity: str, frame: int, bits: float, purpose: Purpose, reason: str) -> NextLook | None:
        """Return the look at a frame that shows most of where a person may be and no look shows yet."""
        angle, spread = expected_place(self.tracks.people[entity], frame)
        looks, best = self.tracks.looks.get(frame, ()), None
        left = _AWAY + sum(_chance(gap, angle, spread) for gap in gaps(looks, CIRCLE))
        for turn in (0.0, 40.0, -40.0, 80.0, -80.0, 120.0, -120.0, 160.0, -160.0):
            new = gaps(looks, around(angle + turn, FOV_DEG / 2))
            chance = sum(_chance(gap, angle, spread) for gap in new) / left
            if new and (best is None or chance * bits > best.bits):
                best = NextLook(frame, (angle + turn) % 360.0, purpose, chance * bits, reason)
        return best


def _chance(arc: Arc, angle: float, spread: float) -> float:
    """Return the probability that a person expected at an angle with this spread is inside an arc."""
    begin = clockwise(angle + 180.0, arc.start) - 180.0
    below, above = (math.erf(turn / (spread * math.sqrt(2))) for turn in (begin, begin + arc.span))
    return 0.9 * (above - below) / 2 + 0.1 * arc.span / 360.0


def _learned(chance: float) -> float:
    """Return the bits that one reading of the usual confidence yields about a statement of this probability."""
    return _entropy(chance * CONFIDENCE + (1 - chance) * (1 - CONFIDENCE)) - _entropy(CONFIDENCE)


def _entropy(chance: float) -> float:
    if not 0 < chance < 1:
        return 0.0
    return -chance * math.log2(chance) - (1 - chance) * math.log2(1 - chance)


def _turn_aside(tracks: Tracks, frame: int, angle: float) -> float:
    """Return an angle near this one at which no look was made at the frame."""
    made = [(look.left + CROP / 2) * 360.0 / WIDTH for look in tracks.looks.get(frame, ()) if look.width == CROP]
    turn = 0.0
    while any(angle_error(angle + turn, second) < _APART_DEG for second in made):
        turn = -turn if turn > 0 else 1.05 * _APART_DEG - turn
    return (angle + turn) % 360.0
