"""The marker plays the reference agent: what it reads goes into the graph, and what the graph holds it knows again.

The person of the description is sought look by look; where hops lead on, or a group is counted, everybody matters and
the frame is looked at all round in one turn, as people who are not written down are forgotten with their pictures.
From then on the read is the policy of the other methods, over looks put together from the graph, in the order in which
they were made. Events that the policy leaves too far apart for the solver are closed in on with the looks that remain.

The marker plays the reference agent that is shown panoramas and cannot look: it writes down what they show.

Where no panorama shows the time of the description, the person is taken for whom the nearest one shows; what is written
is true of that panorama alone, so the solver lacks what the question names.

The marker plays the reference agent without a world model: all pictures so far are in the chat.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from jrdb_avr.agent.policy.enclosing import NEAR, Event, between, events
from jrdb_avr.agent.policy.explorer import AROUND, Eyes, Spent, Want, same
from jrdb_avr.agent.policy.finding import ALONE_SIZE, Found, among, find, holds, likely, possible
from jrdb_avr.agent.policy.game import Game
from jrdb_avr.agent.policy.hops import path, related
from jrdb_avr.agent.policy.policy import find_target, read_answer
from jrdb_avr.agent.simulated.memory import Memory, Round
from jrdb_avr.agent.simulated.notes import Notes, entity_name, read_notes
from jrdb_avr.agent.simulated.requests import Look, Request, Sighting, Turn
from jrdb_avr.agent.simulated.shown import Shown
from jrdb_avr.agent.simulated.writing import Draft, placed
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.rules import FPS

LEFT: Final = r"\d+, left: (\d{1,9})$"

_MOST_CALLS: Final = 32
_REFUSED: Final = re.compile(r"\d+\. final_answer: refused")
_ENDED: Final = re.compile(r'Your last turn was malformed.*"calls" must be a list of 1 to ')

_KEPT: Final = 2
"""Of those who could be the one described so many are written down: with two it is not known who it is."""

_COUNTED: Final = AROUND[:5]
"""Turns from somebody at which those who belong to that person are looked for."""


def remember(request: Request) -> Turn:
    """A turn of the reference agent that looks. Raises DecodeError for a prompt that lacks a line."""
    player = Player(request, read_notes(request))
    looks: list[dict[str, Any]] = []
    answer: dict[str, Any] | None = None
    try:
        answer = player.play()
    except Want as want:
        looks = player.look(want.frame, (want.angle,))
    except Round as wanted:
        looks = player.look(wanted.frame, wanted.angles)
    return hand_in(request, player.draft, looks, answer, player.game.missing)


def hand_in(
    request: Request, draft: Draft, looks: Sequence[dict[str, Any]], answer: dict[str, Any] | None, missing: list[str]
) -> Turn:
    """What is written, and then the looks or the final answer.

    The turn ends the question where an answer was refused, as all that was read has been written by then, and where
    there is nothing to answer: a turn without a call, said twice, is the end of an episode.
    """
    left = request.number("Tool calls made: ", LEFT)
    if refused(request):
        return Turn({"calls": []}, [*missing, "the answer was refused"])
    room = min(_MOST_CALLS, left)
    last = list(looks)
    if not looks or len(draft.calls) + len(looks) >= left:
        last = [] if answer is None else [{"tool": "final_answer", **answer}]
    calls = [*draft.calls, *last] if len(draft.calls) + len(last) <= room else draft.calls[:room]
    ended = not calls or calls[-1]["tool"] == "final_answer"
    return Turn({"calls": calls}, missing if ended else None)


def refused(request: Request) -> bool:
    """Whether the last turn's final answer was refused, or the end of the episode has been asked for already."""
    return any(_REFUSED.match(line) or _ENDED.match(line) for line in request.lines)


class Player:
    """One turn: what is known, what is to be written, and the read of the answer as far as it has come."""

    def __init__(self, request: Request, notes: Notes) -> None:
        self.notes = notes
        self.draft = Draft(notes)
        self._plan = request.plan
        self._left = request.number("Looks made: ", LEFT)
        self._legal = request.legal()
        self.game = Game(request.plan, request.choices, self._memory(0), close=NEAR)
        self._then = self.game.eyes.legal(self.game.t0)

    def _memory(self, known: int) -> Memory:
        return Memory(self._legal, self.notes.looks, self._left, known, len(self._plan.answer.times))

    def look(self, frame: int, angles: Sequence[float]) -> list[dict[str, Any]]:
        """The calls that look; none where nothing is left to look with, or where it has been looked already."""
        made = [look.angle for look in self.notes.looks if look.frame == frame]
        angles = [round(angle % 360.0, 3) for angle in angles if not any(same(angle, other) for other in made)]
        return [{"tool": "observe", "frame_id": f"{frame:06d}", "angle_deg": angle} for angle in angles[: self._left]]

    def play(self) -> dict[str, Any] | None:
        """The final answer without its tool's name, or None where nobody was found. Raises Want and Round."""
        person = self._target()
        if person is None:
            return None
        identity = person.mark.identity
        for frame in sorted({look.frame for look in self.notes.newest} | {self._then}):
            if (seen := self.notes.of(identity, frame)) is not None:
                self.draft.read(self._plan, seen)
        self.game.eyes = self._memory(self._survey())
        if self._plan.answer.read == "count":
            answer = {"value": str(self._count(person))}
        else:
            answer = read_answer(self.game, person)
        frames = sorted({look.frame for look in self.notes.looks})
        all_seen = {frame: s for frame in frames if (s := self.notes.of(identity, frame)) is not None}
        known = events(self._plan, self._then, all_seen)
        self._close_in(known, all_seen)
        self._show_whole(known, all_seen)
        return {"answer": self._enclosed(answer, known), "entity": entity_name(identity)}

    # -- who it is ----------------------------------------------------------------------------------------------------

    def _survey(self) -> int:
        """How many looks were made to find the person: the first ones, all at the time of the description."""
        frames = [look.frame for look in self.notes.looks]
        return next((place for place, frame in enumerate(frames) if frame != self._then), len(frames))

    def _target(self) -> Sighting | None:
        """Whom the question asks about, at the time of the description; writes down who of the plan is found."""
        held = self.notes.holders.get(self._plan.target)
        if held is not None:
            return self.notes.of(held, self._then)
        root = next(node for node in self._plan.nodes if node.id == self._plan.root)
        people = self._memory(len(self.notes.looks)).at(self._then)
        sized = any(c.attribute == "group_size" and c.value != ALONE_SIZE for c in root.conditions)
        if self._plan.edges or sized or self._plan.answer.read == "count":
            if not self.notes.looks:
                raise Round(self._then, [180.0 + turn for turn in AROUND])
            found = among(root.conditions, people)
        else:
            found = self._seek(root.conditions, people)
        if found.missing:
            self.game.note(found.missing)
        if found.sighting is None:
            return None
        nodes = path(self._plan, found.sighting, people)
        self.draft.people(self._plan, nodes)
        self.draft.conditions(found.sighting, root.conditions)
        if self._plan.target not in nodes:
            self.game.note("mark unreadable: a hop leads to nobody, or to several")
        return nodes.get(self._plan.target)

    def _seek(self, conditions: Sequence[Condition], people: Sequence[Sighting]) -> Found:
        """The person described, look by look; who could be it is written down before the next look."""
        try:
            return find(conditions, self._then, self.game.eyes)
        except Want:
            newest = [seen for look in self.notes.newest for seen in look.sightings]
            written = {name for name, _ in self.notes.sighted}
            for seen in possible(conditions, people):
                name = entity_name(seen.mark.identity)
                if name not in written and len(written) < _KEPT and any(seen is other for other in newest):
                    written.add(name)
                    self.draft.person(seen)
                    self.draft.conditions(seen, [c for c in conditions if holds(c, seen, people)])
            raise
        except Spent:
            return Found(None, "budget: the person was not found")

    # -- what is read of that person ----------------------------------------------------------------------------------

    def _count(self, person: Sighting) -> int:
        """How many are seen to have the relation: all round at the first time, then near the person until the last."""
        begin, end = (self.game.eyes.legal(self.game.frame_of(name)) for name in self._plan.answer.times)
        relation = self._plan.answer.relation
        assert relation is not None, "a count names its relation"
        own = entity_name(person.mark.identity)
        for frame in sorted({look.frame for look in self.notes.newest}):
            people = self._memory(len(self.notes.looks)).at(frame)
            seen = self.notes.of(person.mark.identity, frame)
            for other in people:
                if seen is not None and other is not seen and related(relation, seen, other, people):
                    self.draft.member(seen, relation, other)
        for third in (1, 2, 3):
            then = self.game.eyes.legal(begin + (end - begin) * third / 3)
            if self._left >= len(_COUNTED) and not any(look.frame == then for look in self.notes.looks):
                last = [s for look in self.notes.looks if (s := look.of(person.mark.identity)) is not None][-1]
                raise Round(then, [last.angle + turn for turn in _COUNTED])
        return max(len(self.draft.partners(own, relation)), 1)

    # -- what the solver asks for -------------------------------------------------------------------------------------

    def _close_in(self, known: dict[str, Event], seen: dict[int, Sighting]) -> None:
        """Look inside an event that is not enclosed nearly enough, while there are looks."""
        for name in sorted(known):
            frame = between(known[name], self._legal, [look.frame for look in self.notes.looks])
            if not known[name].known and frame is not None and self._left:
                nearest = min(seen, key=lambda other: (abs(other - frame), other))
                raise Want(frame, seen[nearest].angle)

    def _show_whole(self, known: dict[str, Event], seen: dict[int, Sighting]) -> None:
        """Look once more where the box that will be shown was cut off by its picture's edge."""
        asked = [
            known[name].high if name in known else self._plan.times[name].frame for name in self._plan.answer.times
        ]
        shown = next((seen[frame] for frame in reversed(asked) if frame in seen), seen[self._then])
        if not shown.whole and self._left:
            made = [look.angle for look in self.notes.looks if look.frame == shown.frame]
            if not any(same(angle, shown.angle) for angle in made):
                raise Want(shown.frame, shown.angle)

    def _enclosed(self, answer: Any, known: dict[str, Event]) -> Any:
        """The answer by the middles of the events, where all of them have been seen."""
        if set(known) != set(self._plan.answer.times):
            return answer
        moments = [known[name].middle for name in self._plan.answer.times]
        ids = [f"{round(moment):06d}" for moment in moments]
        match self._plan.answer.read:
            case "start":
                return {"frame_id": ids[0]}
            case "span":
                return {"start_frame": ids[0], "end_frame": ids[1]}
            case "start_view":
                return {**answer, "frame_id": ids[0]}
            case _:
                return {"value": f"{max((moments[1] - moments[0]) / FPS, 1.0):.1f}"}


def remember_shown(request: Request) -> Turn:
    """A turn of the reference agent without looks. Raises DecodeError for a prompt that lacks a line."""
    notes = read_notes(request)
    draft = Draft(notes)
    game = Game(request.plan, request.choices, Shown(notes.looks))
    person = _target(game, draft)
    answer = None
    if person is not None:
        _write_everywhere(game, notes, draft, person)
        answer = {"answer": read_answer(game, person), "entity": entity_name(person.mark.identity)}
    game.note_unseen()
    return hand_in(request, draft, (), answer, game.missing)


def _target(game: Game, draft: Draft) -> Sighting | None:
    """Whom the question asks about, in the panorama nearest to the description, and who of the plan is found there."""
    plan = game.plan
    root = next(node for node in plan.nodes if node.id == plan.root)
    frame = game.eyes.legal(game.t0)
    exact, people = frame == game.t0, game.eyes.at(frame)
    found = among(root.conditions, people)
    if found.missing:
        game.note(found.missing)
    person = found.sighting if exact else likely(root.conditions, people, exact=False)
    if person is None:
        return None
    nodes = path(plan, person, people)
    draft.people(plan, nodes)
    # At the time of the description who is left is held to be the one described; at another the likeliest is taken.
    draft.conditions(person, [c for c in root.conditions if exact or holds(c, person, people)])
    if plan.target not in nodes:
        game.note("mark unreadable: a hop leads to nobody, or to several")
    return nodes.get(plan.target)


def _write_everywhere(game: Game, notes: Notes, draft: Draft, person: Sighting) -> None:
    for frame in game.eyes.frames:
        if (seen := notes.of(person.mark.identity, frame)) is not None:
            draft.read(game.plan, seen)


def chat(request: Request) -> Turn:
    """A turn of the chat: the next look, or the final answer. Raises DecodeError for a prompt that lacks a line."""
    if refused(request):
        return Turn({"calls": []}, ["the answer was refused"])
    passive = any(look.panorama for look in request.looks)
    eyes = Shown(request.looks) if passive else _eyes(request)
    game = Game(request.plan, request.choices, eyes, beside=not passive)
    try:
        person = find_target(game)
        answer = read_answer(game, person)
        if passive:
            game.note_unseen()
        box = _evidence(game, person)
    except Want as want:
        call = {"tool": "observe", "frame_id": f"{want.frame:06d}", "angle_deg": round(want.angle % 360.0, 3)}
        return Turn({"calls": [call]})
    return Turn({"calls": [{"tool": "final_answer", "answer": answer, **box}]}, game.missing)


def _eyes(request: Request) -> Eyes:
    left = request.number("Looks made: ", LEFT)
    return Memory(request.legal(), request.looks, left, rounds=len(request.plan.answer.times))


def _evidence(game: Game, person: Sighting | None) -> dict[str, Any]:
    """Observation and box of a look that shows the person whole, the newest of them; looks once more for one.

    No box where the person was never found: the call is refused, and the question ends with an answer alone.
    """
    if person is None:
        return {"observation": game.eyes.looks[-1].name, "box": []}
    identity = person.mark.identity
    found = _newest(game.eyes.looks, identity)
    if not found[1].whole:
        try:
            again = game.eyes.again(found[1].frame, found[1].angle)
            seen = again.of(identity)
            found = (again, seen) if seen is not None else found
        except Spent:
            game.note("budget: no look was left to show the person again")
    return placed(*found)


def _newest(looks: list[Look], identity: int) -> tuple[Look, Sighting]:
    found = [(look, seen) for look in looks if (seen := look.of(identity)) is not None]
    return max(enumerate(found), key=lambda entry: (entry[1][1].whole, entry[0]))[1]
