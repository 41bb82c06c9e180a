"""Programs: plans that can be run over facts.

A source of facts returns facts by key. The same code therefore proves a question from the sets of `Facts` and from
statements over the stored graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Protocol, cast

import msgspec

from jrdb_avr.engine.generate.choices import outcome
from jrdb_avr.engine.generate.facts import Fit, Key
from jrdb_avr.queries.compiler.solve import CHANGES
from jrdb_avr.schema.answer_modes import decode_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.plan import Condition, Edge, Plan
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Template, TimeProof

_WORST: Final = ("empty", "ambiguous", "unknown")
"""Outcomes of a program without an answer. If several branches fail, the first of these is the program's outcome."""

Answer = str | FrameViewpoint


def parse_answer(mode: str, text: str) -> Answer:
    """Return a stored answer as programs return it: a start is decoded, a choice stays a text."""
    return cast(FrameViewpoint, decode_answer(mode, text)) if mode == "frame_viewpoint" else text


class NoAnswerError(Exception):
    """Reason why a program has no answer: empty, ambiguous or unknown."""


class MissingFactsError(Exception):
    """Signal that a source of facts was asked for facts that it must look up first."""


class FactSource(Protocol):
    """Source of facts."""

    def ask(self, keys: Sequence[Key]) -> list[Any]:
        """Return facts by key.

        Args:
            keys: Keys of one of these forms, with people by track:
                ("people_at", sequence, frame), ("match", sequence, condition, frame) and
                ("follow", sequence, relation, track, frame) give the people as a `Fit`;
                ("labels", sequence, track, frame) gives `ListedActions`, or None if nothing can be read;
                ("seen", sequence, track, frame) gives a `Seen`;
                ("start", sequence, track, action, after) gives a `FrameViewpoint` or None;
                ("onsets", sequence, track, action, frame) gives rows (frame, angle, could, certain).

        Returns:
            The facts in the order of the keys.

        Raises:
            MissingFactsError: If a fact must be looked up first. The source has noted all missing keys.
        """


class Program(msgspec.Struct, frozen=True):
    """A plan that can be run.

    Attributes:
        sequence: Name of the sequence.
        conditions: Conditions of person a.
        frame: Frame at which conditions and relations hold.
        edges: Relations between the people.
        target: Name of the target.
        read: What is read, as in `AnswerSpec`.
        times: Stated frames at which the answer is read.
        action: Action, if its start is the answer, or None.
        join: Name of the person at the end of two branches, or "".
        moves: What the proofs about time move.
        held: Track of person a, or None if the conditions find the person.
    """

    sequence: str
    conditions: tuple[Condition, ...]
    frame: int
    edges: tuple[Edge, ...]
    target: str
    read: str
    times: tuple[int, ...]
    action: str | None
    join: str
    moves: TimeProof
    held: int | None = None

    @property
    def nodes(self) -> list[str]:
        """Names of the people in the order in which the relations reach them."""
        return list(dict.fromkeys(("a", *(edge.target for edge in self.edges))))


def make_program(sequence: str, plan: Plan, template: Template) -> Program:
    """Make the program of a plan.

    Args:
        sequence: Name of the sequence.
        plan: Plan of a question.
        template: Template of the plan, in the form that the plan has.

    Returns:
        The program.
    """
    root = next(node for node in plan.nodes if node.id == plan.root)
    stated = {name: time.frame for name, time in plan.times.items() if time.frame is not None}
    actions = [time.action for name, time in plan.times.items() if name in plan.answer.times and time.event == "start"]
    return Program(
        sequence=sequence,
        conditions=root.conditions,
        frame=stated[template.described],
        edges=plan.edges,
        target=plan.target,
        read=plan.answer.read,
        times=tuple(stated[name] for name in plan.answer.times if name in stated),
        action=actions[0] if actions else None,
        join=plan.target if template.joins else "",
        moves=template.time_proof,
    )


# -- running a program ------------------------------------------------------------------------------------------------


def find_tracks(program: Program, source: FactSource) -> dict[str, int]:
    """Find the people of a program, one after another.

    Args:
        program: Program.
        source: Source of facts.

    Returns:
        Tracks by name.

    Raises:
        NoAnswerError: If the conditions or a relation lead to no single person.
        MissingFactsError: If facts are missing.
    """
    people = {"a": _only(match(program, source)) if program.held is None else program.held}
    failures, missing = [], False
    for node in program.nodes[1:] if program.edges else ():
        edges = [edge for edge in program.edges if edge.target == node]
        if not all(edge.source in people for edge in edges):
            continue
        try:
            people[node] = _step(program, source, people, edges)
        except NoAnswerError as reason:
            failures.append(str(reason))
        except MissingFactsError:
            missing = True
    if missing:
        raise MissingFactsError
    if failures:
        raise NoAnswerError(min(failures, key=_WORST.index))
    return people


def match(program: Program, source: FactSource) -> Fit:
    """Find the people who may meet all conditions of a program, and who certainly meet all."""
    keys = [("match", program.sequence, condition, program.frame) for condition in program.conditions]
    return _overlap(source.ask([("people_at", program.sequence, program.frame), *keys]))


def _step(program: Program, source: FactSource, people: dict[str, int], edges: Sequence[Edge]) -> int:
    """Find the person at the end of all of some edges, who is not one of the people before."""
    keys = [("follow", program.sequence, edge.relation, people[edge.source], program.frame) for edge in edges]
    fit = _overlap(source.ask(keys))
    if edges[0].target == program.join:
        apart = set(people.values())
        return _only(Fit(fit.could - apart, fit.certain - apart))
    who = _only(fit)
    if who in people.values():
        raise NoAnswerError("empty")
    return who


def _overlap(fits: Sequence[Fit]) -> Fit:
    could, certain = fits[0]
    for fit in fits[1:]:
        could, certain = could & fit.could, certain & fit.certain
    return Fit(could, certain)


def _only(fit: Fit) -> int:
    """Return the only person of a fact. Raises NoAnswerError if there are several or none, or it is unknown."""
    if len(fit.certain) > 1:
        raise NoAnswerError("ambiguous")
    if not fit.could:
        raise NoAnswerError("empty")
    if len(fit.could) > 1 or not fit.certain:
        raise NoAnswerError("unknown")
    return next(iter(fit.certain))


def run(program: Program, source: FactSource, rules: Rules) -> Answer:
    """Run a program.

    Args:
        program: Program that reads presence, a change of distance, or a start with its direction.
        source: Source of facts.
        rules: Thresholds of distances.

    Returns:
        The answer.

    Raises:
        NoAnswerError: If the program has no answer.
        MissingFactsError: If facts are missing.
    """
    who = find_tracks(program, source)[program.target]
    if program.read == "start_view":
        (start,) = source.ask([("start", program.sequence, who, program.action, program.frame)])
        return cast(FrameViewpoint, _known(start))
    seen = [("seen", program.sequence, who, frame) for frame in program.times]
    first, second = source.ask(seen)
    return str(_known(CHANGES[program.read](first, second, rules)))


def judge_action(program: Program, label: str, source: FactSource) -> str:
    """Read whether the target of a program does an action.

    Args:
        program: Program that reads an action.
        label: The action.
        source: Source of facts.

    Returns:
        The outcome: "same", "different", "unknown", or "empty" if the person is absent.

    Raises:
        NoAnswerError: If the program finds no single person.
        MissingFactsError: If facts are missing.
    """
    about = program.sequence, find_tracks(program, source)[program.target], program.times[0]
    seen, labels = source.ask([("seen", *about), ("labels", *about)])
    return "empty" if seen.present is False else outcome(labels, label)


def _known(value: Any) -> Any:
    if value is None:
        raise NoAnswerError("unknown")
    return value
