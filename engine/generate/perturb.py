"""Perturbations of a plan, and the proofs that they give.

A perturbation is another program: a condition left out, another target, a hop left out, or other times.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

from msgspec.structs import replace

from jrdb_avr.engine.generate.programs import (
    Answer,
    FactSource,
    MissingFactsError,
    NoAnswerError,
    Program,
    find_tracks,
    judge_action,
    match,
    run,
)
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.plan import Edge
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, Rules, frames

PROVING: Final = ("different", "ambiguous", "empty")
"""Outcomes of a perturbed program that certainly does not give the question's answer."""

BY_CONSTRUCTION: Final = "by construction"
"""Variant of the proofs about time that are not run, because the answer is itself a time."""


def prove(program: Program, answer: Answer, keyframes: Sequence[int], rules: Rules, source: FactSource) -> list[Proof]:
    """Run all perturbations of a program.

    Args:
        program: Program of a question.
        answer: Answer of the question.
        keyframes: Keyframes of the sequence, in order.
        rules: Thresholds.
        source: Source of facts.

    Returns:
        The proofs about conditions, hops and times, in the order in which questions store them.

    Raises:
        NoAnswerError: If the program finds no single person.
        MissingFactsError: If facts are missing. All facts that can be asked for have been asked for.
    """
    return require_all(iterate_proofs(program, answer, keyframes, rules, source))


def require_all(proofs: Iterable[Proof | None]) -> list[Proof]:
    """Return all proofs. Raise MissingFactsError after the last proof if one of them lacks facts."""
    proofs = list(proofs)
    complete = [proof for proof in proofs if proof is not None]
    if len(complete) < len(proofs):
        raise MissingFactsError
    return complete


def iterate_proofs(
    program: Program, answer: Answer, keyframes: Sequence[int], rules: Rules, source: FactSource
) -> Iterator[Proof | None]:
    """Yield the proofs of a program one by one, None for one that lacks facts. Parameters are those of `prove`."""
    people = find_tracks(program, source)
    yield from prove_conditions(program, source)
    yield from prove_changes(program, people, answer, keyframes, rules, source)


def prove_conditions(program: Program, source: FactSource) -> Iterator[Proof | None]:
    """Yield a proof per condition that the condition is needed: without it, two people or more may be meant.

    Args:
        program: Program of a question.
        source: Source of facts.

    Yields: The proofs, None for one that lacks facts.
    """
    for condition in program.conditions:
        left = replace(program, conditions=tuple(one for one in program.conditions if one is not condition))
        try:
            several = len(match(left, source).could) >= 2
        except MissingFactsError:
            yield None
            continue
        yield Proof("anchor", f"without {condition.words}", several, "ambiguous" if several else "same")


def prove_changes(
    program: Program,
    people: Mapping[str, int],
    answer: Answer,
    keyframes: Sequence[int],
    rules: Rules,
    source: FactSource,
) -> Iterator[Proof | None]:
    """Yield the proofs about hops and times, None for one that lacks facts.

    Args:
        program: Program of a question.
        people: Tracks of its people by name.
        answer: Answer of the question.
        keyframes: Keyframes of the sequence, in order.
        rules: Thresholds.
        source: Source of facts.

    Yields: The proofs in the order in which questions store them.
    """
    for kind, variant, perturbed in hops(replace(program, held=people["a"])):
        yield _prove(kind, variant, perturbed, answer, keyframes, rules, source)
    if program.moves == "construction":
        yield from (Proof(kind, BY_CONSTRUCTION, None, "not_run") for kind in ("time.shift", "time.drop"))
        return
    moving, begin = program, keyframes[0]
    if program.moves == "times":
        # The target stays the same.
        moving = replace(program, edges=(), target="a", held=people[program.target])
        begin = program.frame + frames(rules.min_wait_s)
    for variant, shifted in shifts(moving, keyframes, rules):
        yield _prove("time.shift", variant, shifted, answer, keyframes, rules, source)
    moved = (_moved(moving, frame - min(_later(moving))) for frame in keyframes if frame >= begin)
    yield _prove_drop(moved, answer, keyframes, rules, source)


def _prove(
    kind: str,
    variant: str,
    perturbed: Program | None,
    answer: Answer,
    keyframes: Sequence[int],
    rules: Rules,
    source: FactSource,
) -> Proof | None:
    """Prove that a perturbed program does not give the answer. Return None if facts are missing."""
    if perturbed is None:
        return Proof(kind, variant, False, "outside")
    try:
        result, text = _compare(perturbed, answer, keyframes, rules, source)
    except MissingFactsError:
        return None
    return Proof(kind, variant, result in PROVING, result, text)


def _prove_drop(
    moved: Iterable[Program], answer: Answer, keyframes: Sequence[int], rules: Rules, source: FactSource
) -> Proof | None:
    """Prove that the time is needed: at different times there are different answers. None if facts are missing."""
    kind, variant, known, missing = "time.drop", "all keyframes", [], False
    for program in moved:
        try:
            result = _compare(program, answer, keyframes, rules, source)
        except MissingFactsError:
            missing = True
            continue
        known += [result] if result[0] in ("same", "different") else []
        if known and known[-1] != known[0]:
            return Proof(kind, variant, True, "different")
    end = "same" if len(known) > 1 else "empty"
    return None if missing else Proof(kind, variant, end in PROVING, end)


def _compare(
    perturbed: Program, answer: Answer, keyframes: Sequence[int], rules: Rules, source: FactSource
) -> tuple[str, str | None]:
    """Compare the answer of a perturbed program with the question's answer; return the outcome, and a choice's text.

    Of actions there is a text only if the outcome is "same", because a person may do several.
    """
    if not all(frame in keyframes for frame in (perturbed.frame, *perturbed.times)):
        return "unknown", None
    try:
        if isinstance(answer, FrameViewpoint):
            return _compare_starts(perturbed, answer, source), None
        if perturbed.read == "action":
            result = judge_action(perturbed, answer, source)
            return result, answer if result == "same" else None
        again = run(perturbed, source, rules)
    except NoAnswerError as reason:
        return str(reason), None
    return "same" if again == answer else "different", str(again)


def _compare_starts(perturbed: Program, answer: FrameViewpoint, source: FactSource) -> str:
    """Compare starts. If no start is certain, the outcome is unknown only if a start may be near enough to score."""
    who, action, sequence = find_tracks(perturbed, source)[perturbed.target], perturbed.action, perturbed.sequence
    (start,) = source.ask([("start", sequence, who, action, perturbed.frame)])
    if start is not None:
        return "same" if same_answer(start, answer) else "different"
    (rows,) = source.ask([("onsets", sequence, who, action, answer.frame)])
    certain = {frame for frame, _, _, sure in rows if sure}
    for frame, angle, could, _ in rows:
        near = frame >= answer.frame - KEYFRAME_STEP and same_answer(FrameViewpoint(answer.frame, angle), answer)
        if near and could and frame - KEYFRAME_STEP not in certain:
            return "unknown"
    return "empty"


def hops(program: Program) -> Iterator[tuple[str, str, Program]]:
    """Yield the programs that stop at an earlier person, then those without a hop.

    Args:
        program: Program of a question.

    Yields:
        The kind and the variant of the proof, and the program.
    """
    if not program.edges:
        return
    for place, node in enumerate(program.nodes[:-1]):
        yield "hop.stop", str(place), replace(program, target=node)
    for number, edge in enumerate(program.edges, start=1):
        # To leave out the last hop of a path is to stop one person early. Of a join, each hop can be left out.
        if program.join or edge.target != program.target:
            yield "hop.skip", str(number), replace(program, edges=_without(program, edge))


def _without(program: Program, skipped: Edge) -> tuple[Edge, ...]:
    """Return the edges without a hop. The hops after it begin at its source."""
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
    later = _later(moving)
    for by in (-frames(rules.shift_s), frames(rules.shift_s)):
        inside = min(later) + by >= first and max(later) + by <= keyframes[-1]
        yield f"{by / FPS:+g} s", _moved(moving, by) if inside else None


def _later(program: Program) -> list[int]:
    """Return the frames that the proofs about time move."""
    return [time for time in program.times if program.moves == "program" or time != program.frame]


def _moved(program: Program, by: int) -> Program:
    if program.moves == "program":
        return replace(program, frame=program.frame + by, times=tuple(time + by for time in program.times))
    return replace(program, times=tuple(time if time == program.frame else time + by for time in program.times))
