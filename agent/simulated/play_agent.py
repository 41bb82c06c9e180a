"""Play the reference agent: write what the marks show into its graph, and read back what the graph holds.

With looks: the model searches for the described person look by look. Where hops lead on, or a group is counted,
everybody matters: it looks all round the frame in one turn, because people who are not written down are forgotten with
their pictures. From then on it reads the answer by the policy of the other methods, over looks restored from the graph
in the order in which they were made. Events that the policy leaves too far apart for the solver are closed in on with
the looks that remain.

Without looks: it writes down what the panoramas show. Where none shows the time of the description, it takes the
likeliest person of the nearest one; what it writes is true of that panorama alone, so the solver lacks the rest.

Without a graph: all pictures so far are in the chat.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any, Final

from jrdb_avr.agent.policy.enclosing import NEAR, BoundedEvent, between, bounded_events
from jrdb_avr.agent.policy.explorer import AROUND, FixedExplorer, Look, NeedObservation, RestoredExplorer, Sighting
from jrdb_avr.agent.policy.finding import FoundPerson, among, counts_group, find, holds, likely, possible
from jrdb_avr.agent.policy.hops import path, related
from jrdb_avr.agent.policy.policy import answer_of_moments, find_answer, find_target
from jrdb_avr.agent.policy.state import EpisodeState
from jrdb_avr.agent.simulated.notes import Draft, entity_name, placed, read_notes
from jrdb_avr.agent.simulated.requests import Request, StageReply
from jrdb_avr.schema.plan import Condition

_MOST_CALLS: Final = 32
_REFUSED: Final = re.compile(r"\d+\. final_answer: refused")

_NOBODY: Final = "nobody"
"""The entity of an answer that is a guess."""

_CANDIDATES: Final = 2
"""Most people who may fit the description that are written down: with two it is not known which one it is."""

_COUNTED: Final = AROUND[:5]
"""Turns from a person at which the people related to that person are looked for."""


def agent_turn(request: Request) -> StageReply:
    """A turn with the graph, or with the chat in its place; with looks, or with panoramas in theirs.

    Raises DecodeError for a prompt that lacks a line.
    """
    passive = any(look.panorama for look in request.looks)
    if request.line("Plan: ") is None:
        return _chat(request, passive)
    return _remember_shown(request) if passive else _remember(request)


def _remember(request: Request) -> StageReply:
    player = _Player(request)
    looks: list[dict[str, Any]] = []
    answer: dict[str, Any] | None = None
    try:
        answer = player.play()
    except NeedObservation as need:
        looks = player.look(need.frame, need.angles)
    return _hand_in(request, player.draft, looks, answer, player.state)


def _hand_in(
    request: Request, draft: Draft, looks: Sequence[dict[str, Any]], answer: dict[str, Any] | None, state: EpisodeState
) -> StageReply:
    """The calls that write, and then the looks or the final answer; a guess of nobody where there is none.

    An answer that was refused is sent again as it was, as all that was read has been written by then.
    """
    left = request.left("Tool calls made: ")
    last = list(looks)
    if not looks or len(draft.calls) + len(looks) >= left:
        answer = answer or {"answer": find_answer(state, None), "entity": _NOBODY}
        last = [{"tool": "final_answer", **answer}]
    calls = [*draft.calls[: left - len(last)], *last]
    if len(calls) > _MOST_CALLS:
        calls = draft.calls[:_MOST_CALLS]
    return _ending(request, calls, state.missing)


def _ending(request: Request, calls: Sequence[dict[str, Any]], missing: list[str]) -> StageReply:
    """The calls, with what was missing where they hold the question's first final answer."""
    refused = any(_REFUSED.match(line) for line in request.lines)
    return StageReply({"calls": calls}, missing if calls[-1]["tool"] == "final_answer" and not refused else None)


def _write_plan(
    state: EpisodeState, draft: Draft, person: Sighting, conditions: Sequence[Condition], people: Sequence[Sighting]
) -> Sighting | None:
    """Write the people of the plan that the described person leads to; returns the plan's target."""
    nodes = path(state.plan, person, people)
    draft.people(state.plan, nodes)
    draft.conditions(person, conditions)
    if state.plan.target not in nodes:
        state.note("mark unreadable: a hop leads to nobody, or to several")
    return nodes.get(state.plan.target)


# -- with looks -------------------------------------------------------------------------------------------------------


class _Player:
    """One turn: what the graph holds, what to write, and the read of the answer as far as it has come."""

    def __init__(self, request: Request) -> None:
        self.notes = read_notes(request)
        self.draft = Draft(self.notes)
        self._plan = request.plan
        self._left = request.left("Looks made: ")
        self._legal = request.legal()
        self.state = EpisodeState(request.plan, request.choices, self._explorer(0), close=NEAR)
        self._then = self.state.explorer.legal(self.state.t0)

    def _explorer(self, known: int) -> RestoredExplorer:
        return RestoredExplorer(self._legal, self.notes.looks, self._left, known, len(self._plan.answer.times))

    def _at(self, frame: int) -> list[Sighting]:
        """Everybody whom any look shows at a frame."""
        return self._explorer(len(self.notes.looks)).at(frame)

    def look(self, frame: int, angles: Sequence[float]) -> list[dict[str, Any]]:
        """The calls that look; none where no look is left, or all have been made already."""
        due = [angle for angle in angles if not self._made(frame, angle)]
        return [_observe(frame, angle) for angle in due[: self._left]]

    def _made(self, frame: int, angle: float) -> bool:
        return any(look.shows(frame, angle) for look in self.notes.looks)

    def play(self) -> dict[str, Any] | None:
        """The final answer without its tool's name, or None where nobody was found. Raises NeedObservation."""
        person = self._target()
        if person is None:
            return None
        identity = person.identity
        for frame in sorted({look.frame for look in self.notes.newest} | {self._then}):
            if (seen := self.notes.of(identity, frame)) is not None:
                self.draft.read(self._plan, seen, self.state.offered)
        # The first looks were made to find the person, all at the time of the description.
        survey = list(itertools.takewhile(lambda look: look.frame == self._then, self.notes.looks))
        self.state.explorer = self._explorer(len(survey))
        counts = self._plan.answer.read == "count"
        answer = {"value": str(self._count(person))} if counts else find_answer(self.state, person)
        frames = sorted({look.frame for look in self.notes.looks})
        all_seen = {frame: s for frame in frames if (s := self.notes.of(identity, frame)) is not None}
        known = bounded_events(self._plan, self._then, all_seen)
        self._close_in(known, all_seen)
        self._show_whole(known, all_seen)
        return {"answer": self._bounded(answer, known), "entity": entity_name(identity)}

    def _target(self) -> Sighting | None:
        """The question's person at the time of the description; writes down the people of the plan that are found."""
        holder = self.notes.holders.get(self._plan.target)
        if holder is not None:
            return self.notes.of(holder, self._then)
        conditions, people = self.state.description, self._at(self._then)
        if self._plan.edges or counts_group(conditions) or self._plan.answer.read == "count":
            if not self.notes.looks:
                raise NeedObservation(self._then, *(180.0 + turn for turn in AROUND))
            found = among(conditions, people)
        else:
            found = self._seek(conditions, people)
        self.state.note(found.missing)
        return found.sighting and _write_plan(self.state, self.draft, found.sighting, conditions, people)

    def _seek(self, conditions: Sequence[Condition], people: Sequence[Sighting]) -> FoundPerson:
        """The described person, look by look; writes down who may fit before the next look."""
        try:
            return find(conditions, self._then, self.state.explorer)
        except NeedObservation:
            newest = [seen for look in self.notes.newest for seen in look.sightings]
            written = self.notes.people
            for seen in possible(conditions, people):
                name = entity_name(seen.identity)
                if name not in written and len(written) < _CANDIDATES and any(seen is other for other in newest):
                    written.add(name)
                    self.draft.person(seen)
                    self.draft.conditions(seen, [c for c in conditions if holds(c, seen, people)])
            raise

    def _count(self, person: Sighting) -> int:
        """How many are seen to have the relation: all round at the first time, then near the person until the last."""
        begin, end = (self.state.explorer.legal(self.state.frame_of(name)) for name in self._plan.answer.times)
        relation = self._plan.answer.relation
        assert relation is not None, "a count names its relation"
        for frame in sorted({look.frame for look in self.notes.newest}):
            people, seen = self._at(frame), self.notes.of(person.identity, frame)
            for other in people:
                if seen is not None and other is not seen and related(relation, seen, other, people):
                    self.draft.member(seen, relation, other)
        for third in (1, 2, 3):
            then = self.state.explorer.legal(begin + (end - begin) * third / 3)
            if self._left >= len(_COUNTED) and all(look.frame != then for look in self.notes.looks):
                last = [s for look in self.notes.looks if (s := look.of(person.identity)) is not None][-1]
                raise NeedObservation(then, *(last.angle + turn for turn in _COUNTED))
        return max(len(self.draft.partners(person, relation)), 1)

    def _close_in(self, known: dict[str, BoundedEvent], seen: dict[int, Sighting]) -> None:
        """Look inside an event that is not bounded nearly enough, while there are looks."""
        for name in sorted(known):
            frame = between(known[name], self._legal, [look.frame for look in self.notes.looks])
            if not known[name].known and frame is not None and self._left:
                nearest = min(seen, key=lambda other: (abs(other - frame), other))
                raise NeedObservation(frame, seen[nearest].angle)

    def _show_whole(self, known: dict[str, BoundedEvent], seen: dict[int, Sighting]) -> None:
        """Look once more where the box that becomes the evidence was cut off by its picture's edge."""
        frames = [
            known[name].high if name in known else self._plan.times[name].frame for name in self._plan.answer.times
        ]
        evidence = next((seen[frame] for frame in reversed(frames) if frame in seen), seen[self._then])
        if not evidence.whole and self._left and not self._made(evidence.frame, evidence.angle):
            raise NeedObservation(evidence.frame, evidence.angle)

    def _bounded(self, answer: Any, known: dict[str, BoundedEvent]) -> Any:
        """The answer by the middles of the events, where all of them have been seen."""
        times = self._plan.answer.times
        if set(known) != set(times):
            return answer
        return answer | answer_of_moments(self.state, *(known[name].middle for name in times))


def _observe(frame: int, angle: float) -> dict[str, Any]:
    return {"tool": "observe", "frame_id": f"{frame:06d}", "angle_deg": round(angle % 360.0, 3)}


# -- without looks ----------------------------------------------------------------------------------------------------


def _remember_shown(request: Request) -> StageReply:
    notes = read_notes(request)
    draft = Draft(notes)
    state = EpisodeState(request.plan, request.choices, FixedExplorer(notes.looks))
    person = _shown_target(state, draft)
    answer = None
    if person is not None:
        for frame in state.explorer.frames:
            if (seen := notes.of(person.identity, frame)) is not None:
                draft.read(state.plan, seen, state.offered)
        answer = {"answer": find_answer(state, person), "entity": entity_name(person.identity)}
    state.note_unseen()
    return _hand_in(request, draft, (), answer, state)


def _shown_target(state: EpisodeState, draft: Draft) -> Sighting | None:
    """The question's person in the panorama nearest to the description; writes down the people of the plan there."""
    conditions, frame = state.description, state.explorer.legal(state.t0)
    exact, people = frame == state.t0, state.explorer.at(frame)
    found = among(conditions, people)
    state.note(found.missing)
    person = found.sighting if exact else likely(conditions, people, exact=False)
    if person is None:
        return None
    # At the time of the description the one who is left is held to fit all of it; at another the likeliest may not.
    held = [c for c in conditions if exact or holds(c, person, people)]
    return _write_plan(state, draft, person, held, people)


# -- without a graph --------------------------------------------------------------------------------------------------


def _chat(request: Request, passive: bool) -> StageReply:
    """The next look, or the final answer."""
    explorer: FixedExplorer | RestoredExplorer
    if passive:
        explorer = FixedExplorer(request.looks)
    else:
        left, rounds = request.left("Looks made: "), len(request.plan.answer.times)
        explorer = RestoredExplorer(request.legal(), request.looks, left, rounds=rounds)
    state = EpisodeState(request.plan, request.choices, explorer, beside=not passive)
    try:
        person = find_target(state)
        answer = find_answer(state, person)
        if passive:
            state.note_unseen()
        box = _evidence(state, person)
    except NeedObservation as need:
        return StageReply({"calls": [_observe(need.frame, need.angles[0])]})
    return _ending(request, [{"tool": "final_answer", "answer": answer, **box}], state.missing)


def _evidence(state: EpisodeState, person: Sighting | None) -> dict[str, Any]:
    """Observation and box of a look that shows the person whole, the newest of them; looks once more for one.

    No box where the person was never found: the call is refused, and the question ends with an answer alone.
    """
    if person is None:
        return {"observation": state.explorer.looks[-1].name, "box": []}
    look, seen = _newest(state.explorer.looks, person.identity)
    if not seen.whole:
        with state.budget("no look was left to show the person again"):
            again = state.explorer.again(seen.frame, seen.angle)
            look, seen = (again, better) if (better := again.of(person.identity)) else (look, seen)
    return placed(look, seen)


def _newest(looks: Sequence[Look], identity: int) -> tuple[Look, Sighting]:
    found = [(look, seen) for look in reversed(looks) if (seen := look.of(identity)) is not None]
    return max(found, key=lambda entry: entry[1].whole)
