"""Programs: plans in the form that proofs run. A proof runs a changed program, without a hop or with other times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec
from msgspec.structs import replace

from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.plan import Condition, Edge, Plan
from jrdb_avr.schema.rules import FPS, Rules, frames
from jrdb_avr.schema.templates import Template, TimeProof

Answer = str | FrameViewpoint


class Program(msgspec.Struct, frozen=True):
    """A plan that can be run.

    Attributes:
        sequence: Name of the sequence.
        conditions: Conditions of person a.
        frame: Frame at which conditions and relations hold.
        edges: Relations between the people.
        target: Name of the person that the answer is about.
        read: What is read, as in `AnswerSpec`.
        times: Stated frames at which the answer is read.
        action: Action with a start that is the answer, or None.
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
        """Names of the people in the order of the relations."""
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


def hops(program: Program) -> Iterator[tuple[str, str, Program]]:
    """Yield the programs that stop at an earlier person, then those without a hop.

    Args:
        program: Program of a question.

    Yields:
        The kind and the variant of the proof, and the program.
    """
    for place, node in enumerate(program.nodes[:-1]):
        yield "hop.stop", str(place), replace(program, target=node)
    for number, edge in enumerate(program.edges, start=1):
        # To leave out the last hop of a path is to stop one person early. Of a join, each hop can be left out.
        if program.join or edge.target != program.target:
            yield "hop.skip", str(number), replace(program, edges=_without(program, edge))


def _without(program: Program, skipped: Edge) -> tuple[Edge, ...]:
    """Return the edges without a hop. The hops after it begin at the person before it."""
    edges = (edge for edge in program.edges if edge is not skipped)
    moves = skipped.target != program.target
    return tuple(replace(e, source=skipped.source) if moves and e.source == skipped.target else e for e in edges)


def shifts(moving: Program, keyframes: Sequence[int], rules: Rules) -> Iterator[tuple[str, Program | None]]:
    """Yield the programs with moved times.

    Args:
        moving: Program of a question.
        keyframes: Keyframes of the sequence, in order.
        rules: Thresholds.

    Yields:
        The variant of the proof, and the program, or None if a time is outside the sequence or before the description.
    """
    first = max(moving.frame + 1, keyframes[0]) if moving.moves == "times" else keyframes[0]
    later = later_times(moving)
    for by in (-frames(rules.shift_s), frames(rules.shift_s)):
        inside = min(later) + by >= first and max(later) + by <= keyframes[-1]
        yield f"{by / FPS:+g} s", move(moving, by) if inside else None


def later_times(program: Program) -> list[int]:
    """Return the frames that the proofs about time move."""
    return [time for time in program.times if program.moves == "program" or time != program.frame]


def move(program: Program, by: int) -> Program:
    """Return a program with the frames of the proofs about time moved by a number of frames."""
    if program.moves == "program":
        return replace(program, frame=program.frame + by, times=tuple(time + by for time in program.times))
    return replace(program, times=tuple(time if time == program.frame else time + by for time in program.times))
