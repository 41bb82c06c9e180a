"""Attention: the next look, as the one that is expected to tell the most, in bits, about a plan's open slots.

As long as more looks are left than the read of the answer needs, the people of the plan are identified and verified;
then the target is followed, events are bracketed, absences shown, and the box that is submitted is read again.
"""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from jrdb_avr.agent.perceive.association import expected_place
from jrdb_avr.agent.perceive.geometry import CIRCLE, DERIVED, EDGE_DEG, Arc, around, covered, deciding_arc, gaps
from jrdb_avr.agent.look.moments import Bracket, brackets, presence
from jrdb_avr.agent.perceive.readings import USUAL, PersonReading
from jrdb_avr.agent.look.ranking import (
    PlanPart,
    RankedHypothesis,
    best_of_each,
    frames_of,
    parts_of,
    slot_supports,
)
from jrdb_avr.agent.perceive.votes import SETTLING, UNIT, Support, Tracks
from jrdb_avr.queries.compiler.beliefs import DISTANCE_CUT_M
from jrdb_avr.schema.labels import ROBOT_SECTORS
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
"""Looks that are kept for reading the answer once the target is known."""

SAME_FRAME_RESERVE: Final = 3
"""The same for an action or attribute at the frame of the description."""

_LAST: Final = 4
"""Looks that are kept for it where the target is not known."""

LEAST_BITS: Final = 0.05
"""A look that is expected to tell less is not made."""

MOST_READINGS: Final = 3
"""Of one person at one frame; more tell nothing new."""

_RIVALS: Final = 8
"""Hypotheses that are verified, each with another target."""

_ASIDE_DEG: Final = 12.0
"""Degrees by which a look may be turned aside from one person to show others as well."""

_BESIDE: Final = 0.3
"""The chance that whomever a relation leads to stands on one side, and near."""

_LEAST_NEW: Final = 0.2
"""Share of such a side that a look must show for the first time together with the person."""

_ANSWER_BITS: Final = 2.0
_OVERLAP_DEG: Final = 6.0
_APART_DEG: Final = 1.5
"""A repeated look is turned by this much, as the same one is refused."""

_PEOPLE: Final = 6.0
"""People expected all round before anybody was seen."""

_MISSED: Final = 0.3
"""People who were there and not read, in the same measure."""

_AWAY: Final = 0.05
"""The chance that somebody is not there at all."""

_CLOSE_FRAMES: Final = 28
"""Frames to which a moment is to be known: half of them is within a second."""
_CLOSER: Final = {"span": 14}
"""The same for reads that are scored by how well two spans overlap."""

_TRIES: Final = 3
"""Looks at one frame for somebody who is followed; then a later one is tried."""

_NEARBY: Final = 24
"""Frames after which somebody is still near the place where they were seen."""

_STEP: Final = round(2 * FPS)
"""Frames by which somebody is followed: what a question waits for lasts as long."""
_SHORTEST: Final = round(1.2 * FPS)
"""Frames between two looks in which something may have begun and ended unseen."""
_CLOSING: Final = 4
"""Looks that are kept for closing in on what was passed."""
_EARLY: Final = 0.75
"""Length of a step as a share of the even one: the events of questions come rather early."""
_SECTOR_REACH: Final = LoadRules().sector_false_deg


class NextLook(NamedTuple):
    """A look to make: frame, panorama angle, why, and the bits that it is expected to tell."""

    frame: int
    angle: float
    purpose: Purpose
    bits: float


def next_looks(
    plan: Plan, tracks: Tracks, hypotheses: Sequence[RankedHypothesis], left: int, frames: Sequence[int], most: int = 1
) -> tuple[NextLook, ...]:
    """At most so many different looks at the legal frames (ascending), the one that tells most first; none to stop.

    hypotheses: those of `rank`, the best first; left: looks that may still be made.
    """
    if left <= 0 or not frames:
        return ()
    view = _Attention(plan, tracks, hypotheses, left, frames)
    who, reading = [*view.identify(), *view.verify()], [*view.read(), *view.evidence()]
    order = (who, reading) if left > (view.reserve if view.identified else _LAST) else (reading, who)
    for looks in order:
        found: list[NextLook] = []
        for look in sorted(looks, key=lambda look: -look.bits):
            if len(found) < most and look.bits >= LEAST_BITS and not any(_alike(look, other) for other in found):
                found.append(look)
        if found:
            return tuple(look._replace(angle=_fresh(tracks, look.frame, look.angle)) for look in found)
    return ()


def _alike(one: NextLook, other: NextLook) -> bool:
    return one.frame == other.frame and bool(angle_error(one.angle, other.angle) < FOV_DEG / 2)


@dataclass(frozen=True)
class _Attention:
    """The candidates for the next look."""

    plan: Plan
    tracks: Tracks
    hypotheses: Sequence[RankedHypothesis]
    left: int
    frames: Sequence[int]

    @property
    def reserve(self) -> int:
        """Number of looks that are kept for reading the answer."""
        answer = self.plan.answer
        here = {self.legal(frame) for frame in frames_of(self.plan, answer.of)}
        if answer.read in ("action", "attribute") and self.legal(self.plan.times[answer.times[0]].frame or 0) in here:
            return SAME_FRAME_RESERVE
        return RESERVES[answer.read]

    @property
    def identified(self) -> bool:
        """Whether something speaks for every part of the plan, and the likeliest target is clearly the likeliest."""
        if not self.hypotheses or self.hypotheses[0].margin < UNIT / 2:
            return False
        return all(one.support.log_odds > 0 for one in slot_supports(self.plan, self.tracks, self.hypotheses[0]))

    @property
    def target(self) -> str | None:
        """Name of the likeliest target; None before anybody was seen."""
        return self.hypotheses[0].nodes.get(self.plan.target) if self.hypotheses else None

    def legal(self, frame: float) -> int:
        """The legal frame nearest to a frame."""
        place = bisect.bisect_left(self.frames, frame)
        return min(self.frames[max(place - 1, 0) : place + 1], key=lambda at: abs(at - frame))

    @property
    def _unseen(self) -> float:
        """How many people no look shows at the frame at which the plan first describes its root."""
        frame = self.legal(frames_of(self.plan, self.plan.root)[0])
        return self._crowd(frame)[1]

    def _crowd(self, frame: int) -> tuple[float, float]:
        """How many people are expected all round at a frame, and how many of them in what was not seen yet."""
        unseen = sum(gap.span for gap in gaps(self.tracks.looks.get(frame, ()), CIRCLE)) / 360.0
        here = sum(bool(self.tracks.at(who, frame)) for who in self.tracks.people)
        crowd = here / (1 - unseen) if here else _PEOPLE * max(unseen, 0.2)
        return crowd, crowd * unseen

    # -- who is meant ---------------------------------------------------------------------------------------------

    def identify(self) -> Iterator[NextLook]:
        """Looks at what was not seen yet of the frames at which the plan describes somebody."""
        for node in (one.id for one in self.plan.nodes):
            for frame in map(self.legal, frames_of(self.plan, node)):
                seen = self.tracks.looks.get(frame, ())
                crowd, unseen = self._crowd(frame)
                known = sum(math.exp(min(odds, 20.0)) for odds in self._odds(node).values())
                arc = self._arc(node, frame)
                for gap in gaps(seen, arc):
                    span = min(gap.span, FOV_DEG - _OVERLAP_DEG / 2)
                    share = crowd * span / arc.span
                    bits = _learned(share / (share + known + _MISSED + unseen - crowd * span / 360.0))
                    yield NextLook(frame, gap.start - _OVERLAP_DEG / 2 + FOV_DEG / 2, "identify", 2 * bits)

    def _odds(self, node: str) -> dict[str, float]:
        """The log-odds of each entity that may be a node: by its conditions and the edges that lead to it.

        Not by those that lead on: somebody is the first to the left of everybody.
        """
        parts = [part for part in parts_of(self.plan) if part.nodes[-1] == node]
        best: dict[str, float] = {}
        for one in self.hypotheses:
            if node in one.nodes:
                ends = [(part, [one.nodes.get(end, "") for end in part.nodes]) for part in parts]
                odds = sum(part.evidence(self.tracks, people) for part, people in ends)
                best[one.nodes[node]] = max(odds, best.get(one.nodes[node], odds))
        return best

    def _arc(self, node: str, frame: int) -> Arc:
        """The part of the circle in which the person of a node can stand: the smallest that the plan gives."""
        arcs = [CIRCLE]
        sectors = [
            c.value for one in self.plan.nodes if one.id == node for c in one.conditions if c.attribute == "sector"
        ]
        arcs += [around(ROBOT_SECTORS[str(value)], _SECTOR_REACH) for value in sectors]
        for edge in self.plan.edges if self.hypotheses else ():
            source = self.tracks.box(self.hypotheses[0].nodes.get(edge.source, ""), frame)
            if edge.target == node and source is not None:
                arcs.append(deciding_arc(edge.relation, source.box))
        return min(arcs, key=lambda arc: arc.span)

    def verify(self) -> Iterator[NextLook]:
        """More readings of the people of the likeliest hypotheses with different targets, as readings may be wrong."""
        best = [*best_of_each(self.hypotheses, self.plan.target).values()][:_RIVALS]
        odds = [math.exp(min(one.log_odds, 20.0)) for one in best]
        others = _MISSED + self._unseen
        bits: dict[tuple[str, int], float] = {}
        for one, chance in zip(best, (each / (sum(odds) + others) for each in odds), strict=True):
            for part, support in slot_supports(self.plan, self.tracks, one):
                if support.settled or self._silent(part, support, one):
                    continue
                told = max(_learned(chance), chance * _learned(1 / (1 + math.exp(-support.log_odds))))
                for who in (one.nodes[node] for node in part.nodes if node in one.nodes):
                    frame = frames_of(self.plan, part.nodes[0])[0] if part.frame is None else part.frame
                    bits[who, self.legal(frame)] = bits.get((who, self.legal(frame)), 0.0) + told
        for frame in dict.fromkeys(frame for _, frame in bits):
            yield from self._views(frame, {who: told for (who, at), told in bits.items() if at == frame})
        yield from self._together()

    def _silent(self, part: PlanPart, support: Support, one: RankedHypothesis) -> bool:
        """Whether two readings of a person leave a condition open: a third will hardly tell it."""
        if len(part.nodes) > 1 or support.votes or support.against:
            return False
        who, frame = one.nodes.get(part.nodes[0], ""), frames_of(self.plan, part.nodes[0])[0]
        return len(self.tracks.at(who, self.legal(frame if part.frame is None else part.frame))) >= SETTLING

    def _views(self, frame: int, bits: Mapping[str, float]) -> Iterator[NextLook]:
        """Looks at people who are worth these bits: one may show several of them."""
        places = {}
        for who, told in bits.items():
            if not self.tracks.at(who, frame):
                if (found := self._search(who, frame, told, "verify")) is not None:
                    yield found
            elif max(self.tracks.looks_at(who, frame), len(self.tracks.at(who, frame))) < MOST_READINGS:
                places[who] = self._angle(who, frame)
        for angle in [place + turn for turn in (0.0, -_ASIDE_DEG, _ASIDE_DEG) for place in places.values()]:
            shown = [who for who, place in places.items() if angle_error(angle, place) < FOV_DEG / 2 - EDGE_DEG]
            yield NextLook(frame, angle % 360.0, "verify", sum(bits[who] for who in shown))

    def _together(self) -> Iterator[NextLook]:
        """Looks that show whoever a relation leads from in one picture with those beside them, who may be its end."""
        for part, support in slot_supports(self.plan, self.tracks, self.hypotheses[0]) if self.hypotheses else ():
            if len(part.nodes) < 2 or part.name in DERIVED or support.log_odds > 0:
                continue
            who, frame = self.hypotheses[0].nodes.get(part.nodes[0], ""), self.legal(part.frame or 0)
            if not self.tracks.at(who, frame):
                continue
            angle, half = self._angle(who, frame), FOV_DEG / 2 - EDGE_DEG
            shown = [one for one in self.tracks.looks.get(frame, ()) if covered([one], around(angle, EDGE_DEG))]
            for turn in (half, -half):
                side = Arc((angle + min(0.0, 2 * turn)) % 360.0, 2 * half)
                new = sum(gap.span for gap in gaps(shown, side)) / side.span
                if new > _LEAST_NEW:
                    yield NextLook(frame, (angle + turn) % 360.0, "verify", new * _ANSWER_BITS * _learned(_BESIDE))

    # -- what is read of the target -------------------------------------------------------------------------------

    def read(self) -> Iterator[NextLook]:
        """Looks that read the answer of the likeliest target."""
        answer, who = self.plan.answer, self.target
        if who is None:
            return
        stated = [self.plan.times[name].frame for name in answer.times]
        for frame in (self.legal(one) for one in stated if one is not None):
            yield from self._read_at(who, frame)
        if answer.read == "count" and len(stated) == 2 and None not in stated:
            yield from self._count(who, self.legal(stated[0] or 0), self.legal(stated[1] or 0))
        for bracket in brackets(self.plan, self.tracks, who).values():
            yield from self._bracket(who, bracket)

    def _read_at(self, who: str, frame: int) -> Iterator[NextLook]:
        """Find the target at a stated frame and read it until two readings agree; else show that it is absent."""
        readings = self.tracks.at(who, frame)
        if readings:
            name = {"action": "action", "attribute": self.plan.answer.attribute}.get(self.plan.answer.read)
            read = [label for one in readings for label in one.labels if label.name == name]
            told = bool(read) and all(self.tracks.statement(who, *label[:2], frame).settled for label in read)
            most = MOST_READINGS if name or self._unlike(readings) else SETTLING
            if not told and len(readings) < most:
                yield NextLook(frame, self._angle(who, frame), "verify", _ANSWER_BITS * _learned(USUAL))
            return
        if (found := self._search(who, frame, _ANSWER_BITS, "follow")) is not None:
            yield found
            return
        for beside in (frame + KEYFRAME_STEP, frame - KEYFRAME_STEP):
            at = self.legal(beside)
            near = 0 < abs(at - frame) <= KEYFRAME_STEP and not self._beside_known(who, frame)
            if near and (found := self._search(who, at, _ANSWER_BITS / 2, "absence")) is not None:
                yield found

    def _unlike(self, readings: Sequence[PersonReading]) -> bool:
        """Whether distances that were read for one answer are too far apart for both to be right."""
        read = [one.metres for one in readings if one.metres is not None]
        return self.plan.answer.read == "distance_change" and bool(read) and max(read) - min(read) >= DISTANCE_CUT_M / 2

    def _beside_known(self, who: str, frame: int) -> bool:
        near = [at for at in self.tracks.looks if 0 < abs(at - frame) <= KEYFRAME_STEP]
        return any(presence(self.tracks, who, at) is not None for at in near)

    def _count(self, who: str, first: int, last: int) -> Iterator[NextLook]:
        """Looks all round at frames spread over a stretch of time."""
        for part in range(3):
            frame = self.legal(first + part * (last - first) / 2)
            for gap in gaps(self.tracks.looks.get(frame, ()), CIRCLE):
                off = angle_error(gap.middle, expected_place(self.tracks.people[who], frame).angle)
                yield NextLook(frame, gap.start - _OVERLAP_DEG / 2 + FOV_DEG / 2, "follow", 0.5 - float(off) / 1000)

    def _bracket(self, who: str, event: Bracket) -> Iterator[NextLook]:
        """Step on until the change was passed, halve the bracket, then read its two ends again."""
        low, high = event.low, event.high
        close = _CLOSER.get(self.plan.answer.read, _CLOSE_FRAMES)
        tried = self.tracks.looks
        if high is None:
            yield from self._step(who, event, self.frames[-1])
            return
        if high - low > close:
            inside = [self.legal(low + share * (high - low)) for share in (0.5, 0.35, 0.65)]
            for at in inside:
                if low < at < high and at not in tried and (found := self._search(who, at, 1.0, "bracket")) is not None:
                    yield found
                    return
        for end in (low, high):
            if 0 < len(self.tracks.at(who, end)) < 2:
                yield NextLook(end, self._angle(who, end), "verify", _ANSWER_BITS * _learned(USUAL))

    def _step(self, who: str, event: Bracket, last: int) -> Iterator[NextLook]:
        """Follow somebody on from a frame; at the end, look where the change may have been passed.

        Whoever is missed is looked for where the newest sighting leads, and halfway; after a sighting just before they
        are taken for hidden, after two misses for lost: they are then looked for to the sides.
        """
        seen = max(event.low, *(one.frame for one in self.tracks.people[who]))
        lost = sorted(at for at in self.tracks.looks if at > seen)
        newest = max([seen, *lost])
        even = round(_EARLY * (last - newest) / max(self.left - _CLOSING, 1))
        at = min(newest + min(max(_STEP, even), 2 * _STEP), last)
        if lost and not covered(self.tracks.looks[lost[0]], around(self._angle(who, lost[0]), EDGE_DEG)):
            at = lost[0]
        elif len(lost) == 1 and lost[0] - seen > _NEARBY:
            at = (seen + lost[0]) // 2
        elif len(lost) > 1 and len(self.tracks.looks[newest]) < _TRIES:
            at = newest
        at = self.legal(at)
        if at > event.low and (found := self._search(who, at, 1.0, "bracket")) is not None:
            yield found
        if newest >= last - KEYFRAME_STEP:
            yield from self._between(who, event.after)

    def _between(self, who: str, after: int) -> Iterator[NextLook]:
        """A look into the longest time without a look from a frame on, the earliest of equal ones."""
        frames = sorted({after, *(at for at in self.tracks.looks if at > after)})
        before, then = max(itertools.pairwise(frames), key=lambda both: (both[1] - both[0], -both[0]), default=(0, 0))
        # More bits than of whoever is looked for beside the last place.
        found = self._search(who, self.legal((before + then) / 2), 1.5, "bracket")
        if found is not None and then - before > _SHORTEST:
            yield found

    # -- the box --------------------------------------------------------------------------------------------------

    def evidence(self) -> Iterator[NextLook]:
        """Looks for a second box of the target that agrees with the first, at the frame with the most agreement."""
        who = self.target
        if who is None:
            return
        boxes = {one.frame: fused for one in self.tracks.people[who] if (fused := self.tracks.box(who, one.frame))}
        frame = max(boxes, key=lambda at: (boxes[at].votes, len(self.tracks.at(who, at)) < MOST_READINGS, at))
        if boxes[frame].votes < 2 and len(self.tracks.at(who, frame)) < MOST_READINGS:
            # The last looks are for the box: without it nothing else counts.
            bits = _ANSWER_BITS * _learned(USUAL) * (10.0 if self.left <= 2 else 0.8)
            yield NextLook(frame, self._angle(who, frame), "evidence", bits)

    # -- where somebody is ----------------------------------------------------------------------------------------

    def _angle(self, who: str, frame: int) -> float:
        return expected_place(self.tracks.people[who], frame).angle

    def _search(self, who: str, frame: int, bits: float, purpose: Purpose) -> NextLook | None:
        """The look at a frame that shows most of where somebody may be and was not looked for yet."""
        place = expected_place(self.tracks.people[who], frame)
        seen, best = self.tracks.looks.get(frame, ()), None
        left = _AWAY + sum(_chance(gap, place.angle, place.angle_spread) for gap in gaps(seen, CIRCLE))
        for turn in (0.0, 40.0, -40.0, 80.0, -80.0, 120.0, -120.0, 160.0, -160.0):
            new = gaps(seen, around(place.angle + turn, FOV_DEG / 2))
            chance = sum(_chance(gap, place.angle, place.angle_spread) for gap in new) / left
            if new and (best is None or chance * bits > best.bits):
                best = NextLook(frame, (place.angle + turn) % 360.0, purpose, chance * bits)
        return best


def _chance(arc: Arc, angle: float, spread: float) -> float:
    """How likely somebody expected at an angle with this spread is inside an arc."""
    begin = clockwise(angle + 180.0, arc.start) - 180.0
    below, above = (math.erf(turn / (spread * math.sqrt(2))) for turn in (begin, begin + arc.span))
    return 0.9 * (above - below) / 2 + 0.1 * arc.span / 360.0


def _learned(chance: float) -> float:
    """Bits that one reading of the usual confidence tells about something with this chance."""
    return _entropy(chance * USUAL + (1 - chance) * (1 - USUAL)) - _entropy(USUAL)


def _entropy(chance: float) -> float:
    if not 0 < chance < 1:
        return 0.0
    return -chance * math.log2(chance) - (1 - chance) * math.log2(1 - chance)


def _fresh(tracks: Tracks, frame: int, angle: float) -> float:
    """An angle near this one at which no look was made at the frame."""
    made = [(look.left + CROP / 2) * 360.0 / WIDTH for look in tracks.looks.get(frame, ()) if look.width == CROP]
    turn = 0.0
    while any(angle_error(angle + turn, other) < _APART_DEG for other in made):
        turn = -turn if turn > 0 else 1.05 * _APART_DEG - turn
    return (angle + turn) % 360.0
