"""The marker plays the reference agent that is shown panoramas and cannot look: it writes down what they show.

Where no panorama shows the time of the description, the person is taken for whom the nearest one shows; what is written
is true of that panorama alone, so the solver lacks what the question names.
"""

from __future__ import annotations

from .finding import among, holds, likely
from .game import Game
from .hops import path
from .notes import Notes, entity_name, read_notes
from .policy import read_answer
from .reading import Request, Sighting
from .remembering import hand_in
from .shown import Shown
from .turn import Turn
from .writing import Draft


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
