"""Perturbations of a plan, and the proofs that they give.

A perturbation is another program: a condition or a hop left out, another target, or other times. A source returns facts
by key. So the same code proves a question from the sets of `Facts` and from statements over the stored graph.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from operator import and_
from typing import Any, Final, Protocol

from msgspec.structs import replace

from jrdb_avr.engine.generate.facts import Fit, Key
from jrdb_avr.engine.generate.programs import Answer, Program, hops, later_times, move, shifts
from jrdb_avr.queries.compiler.reads import outcome_of_action
from jrdb_avr.queries.compiler.solve import CHANGES
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.answers import FrameViewpoint
from jrdb_avr.schema.plan import Condition, Edge
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, frames

PROVING: Final = ("different", "ambiguous", "empty")
"""Outcomes of a perturbed program that certainly does not give the question's answer."""

BY_CONSTRUCTION: Final = "by construction"
"""Variant of the proofs about time that are not run, because the answer is itself a time."""

_WORST: Final = ("empty", "ambiguous", "unknown")
"""Outcomes of a program without an answer. If several branches fail, the first of these is the program's outcome."""


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


@dataclass(frozen=True)
class Setting:
    """Conditions under which programs run.

    Attributes:
        source: Source of facts.
        keyframes: Keyframes of the sequence, in order.
        rules: Thresholds.
        drops: Complete proofs of the kind "time.drop". Programs that are equal but for the time share one.
        described: People who fit the conditions of programs, by conditions and frame.
    """

    source: FactSource
    keyframes: Sequence[int]
    rules: Rules
    drops: dict[tuple[Program, Answer], Proof] = field(default_factory=dict)
    described: dict[tuple[tuple[Condition, ...], int], Fit] = field(default_factory=dict)

    @cached_property
    def keyframe_set(self) -> frozenset[int]:
        """Keyframes without their order."""
        return frozenset(self.keyframes)


# -- running a program ------------------------------------------------------------------------------------------------


def find_tracks(program: Program, setting: Setting) -> dict[str, int]:
    """Find the people of a program, one after another.

    Args:
        program: Program.
        setting: Source of facts.

    Returns:
        Tracks by name.

    Raises:
        NoAnswerError: If the conditions or a relation lead to no single person.
        MissingFactsError: If facts are missing.
    """
    people = {"a": _only(match(program, setting)) if program.held is None else program.held}
    failures, missing = [], False
    for node in program.nodes[1:] if program.edges else ():
        edges = [edge for edge in program.edges if edge.target == node]
        if not all(edge.source in people for edge in edges):
            continue
        try:
            people[node] = _step(program, setting.source, people, edges)
        except NoAnswerError as reason:
            failures.append(str(reason))
        except MissingFactsError:
            missing = True
    if missing:
        raise MissingFactsError
    if failures:
        raise NoAnswerError(min(failures, key=_WORST.index))
    return people


def match(program: Program, setting: Setting) -> Fit:
    """Find the people who may fit all conditions of a program, and those who certainly fit."""
    if (known := (program.conditions, program.frame)) not in setting.described:
        keys = [("match", program.sequence, condition, program.frame) for condition in program.conditions]
        fits = setting.source.ask([("people_at", program.sequence, program.frame), *keys])
        setting.described[known] = _overlap(fits)
    return setting.described[known]


def _step(program: Program, source: FactSource, people: dict[str, int], edges: Sequence[Edge]) -> int:
    """Find the person at the end of some edges. The person differs from all earlier people."""
    keys = [("follow", program.sequence, edge.relation, people[edge.source], program.frame) for edge in edges]
    fit = _overlap(source.ask(keys))
    if edges[0].target == program.join:
        apart = set(people.values())
        return _only(Fit(fit.could - apart, fit.certain - apart))
    track = _only(fit)
    if track in people.values():
        raise NoAnswerError("empty")
    return track


def _overlap(fits: Sequence[Fit]) -> Fit:
    return Fit(*(reduce(and_, tracks) for tracks in zip(*fits, strict=True)))


def _only(fit: Fit) -> int:
    """Return the only person that a fact fits. Raise NoAnswerError if several, none, or unknown people fit."""
    if len(fit.certain) > 1:
        raise NoAnswerError("ambiguous")
    if not fit.could:
        raise NoAnswerError("empty")
    if len(fit.could) > 1 or not fit.certain:
        raise NoAnswerError("unknown")
    return next(iter(fit.certain))


# -- perturbations ----------------------------------------------------------------------------------------------------


def prove(program: Program, answer: Answer, setting: Setting) -> list[Proof]:
    """Run all perturbations of a program.

    Args:
        program: Program of a question.
        answer: Answer of the question.
        setting: Source of facts, keyframes and thresholds.

    Returns:
        The proofs about conditions, hops and times, in the order in which questions store them.

    Raises:
        NoAnswerError: If the program finds no single person.
        MissingFactsError: If facts are missing. All facts that can be asked for have been asked for.
    """
    return require_all(iterate_proofs(program, answer, setting))


def require_all(proofs: Iterable[Proof | None]) -> list[Proof]:
    """Return all proofs, or raise MissingFactsError if one is None.

    All proofs are tried first, so that the facts that any of them lacks are looked up together.
    """
    proofs = list(proofs)
    complete = [proof for proof in proofs if proof is not None]
    if len(complete) < len(proofs):
        raise MissingFactsError
    return complete


def iterate_proofs(program: Program, answer: Answer, setting: Setting) -> Iterator[Proof | None]:
    """Yield what `prove` returns, one proof at a time, with None for each proof that lacks facts.

    For the parameters see `prove`. NoAnswerError and MissingFactsError come before the first proof.
    """
    people = find_tracks(program, setting)
    yield from prove_conditions(program, setting)
    yield from prove_changes(program, people, answer, setting)


def prove_conditions(program: Program, setting: Setting) -> Iterator[Proof | None]:
    """Yield a proof per condition that the condition is needed: without it, two people or more may be meant.

    Args:
        program: Program of a question.
        setting: Source of facts.

    Yields:
        The proofs in the order of the conditions. None for each proof that lacks facts.
    """
    for condition in program.conditions:
        left = replace(program, conditions=tuple(one for one in program.conditions if one is not condition))
        try:
            several = len(match(left, setting).could) >= 2
        except MissingFactsError:
            yield None
            continue
        yield Proof("anchor", f"without {condition.words}", several, "ambiguous" if several else "same")


def prove_changes(
    program: Program, people: Mapping[str, int], answer: Answer, setting: Setting
) -> Iterator[Proof | None]:
    """Yield the proofs about hops and times.

    Args:
        program: Program of a question.
        people: Tracks of its people by name.
        answer: Answer of the question.
        setting: Source of facts, keyframes and thresholds.

    Yields:
        The proofs in the order in which questions store them. None for each proof that lacks facts.
    """
    for kind, variant, perturbed in hops(replace(program, held=people["a"])):
        yield _prove(kind, variant, perturbed, answer, setting)
    if program.moves == "construction":
        yield from (Proof(kind, BY_CONSTRUCTION, None, "not_run") for kind in ("time.shift", "time.drop"))
        return
    moving, begin = program, setting.keyframes[0]
    if program.moves == "times":
        # The person that the answer is about stays the same.
        moving = replace(program, conditions=(), edges=(), target="a", held=people[program.target])
        begin = program.frame + frames(setting.rules.min_wait_s)
    for variant, shifted in shifts(moving, setting.keyframes, setting.rules):
        yield _prove("time.shift", variant, shifted, answer, setting)
    time = min(later_times(moving))
    key = move(moving, begin - time), answer
    if key not in setting.drops:
        moved = (move(moving, frame - time) for frame in setting.keyframes if frame >= begin)
        if (proof := _prove_drop(moved, answer, setting)) is not None:
            setting.drops[key] = proof
    yield setting.drops.get(key)


def _prove(kind: str, variant: str, perturbed: Program | None, answer: Answer, setting: Setting) -> Proof | None:
    """Return the proof of one perturbed program, or None if facts are missing.

    The proof holds if the program does not give the answer. A time outside the sequence has None in place of a program.
    """
    if perturbed is None:
        return Proof(kind, variant, False, "outside")
    try:
        result, text = _compare(perturbed, answer, setting)
    except MissingFactsError:
        return None
    return Proof(kind, variant, result in PROVING, result, text)


def _prove_drop(moved: Iterable[Program], answer: Answer, setting: Setting) -> Proof | None:
    """Prove that the time is needed: at different times there are different answers. None if facts are missing."""
    kind, variant, known, missing = "time.drop", "all keyframes", [], False
    for program in moved:
        try:
            result = _compare(program, answer, setting)
        except MissingFactsError:
            missing = True
            continue
        known += [result] if result[0] in ("same", "different") else []
        if known and known[-1] != known[0]:
            return Proof(kind, variant, True, "different")
    end = "same" if len(known) > 1 else "empty"
    return None if missing else Proof(kind, variant, end in PROVING, end)


def _compare(perturbed: Program, answer: Answer, setting: Setting) -> tuple[str, str | None]:
    """Compare the answer of a perturbed program with the question's answer; return the outcome, and a choice's text.

    Of actions there is a text only if the outcome is "same", because a person may do several.
    """
    if not setting.keyframe_set.issuperset((perturbed.frame, *perturbed.times)):
        return "unknown", None
    source, sequence = setting.source, perturbed.sequence
    try:
        if isinstance(answer, FrameViewpoint):
            return _compare_starts(perturbed, answer, setting), None
        target = find_tracks(perturbed, setting)[perturbed.target]
        seen = [("seen", sequence, target, frame) for frame in perturbed.times]
        if perturbed.read == "action":
            first, labels = source.ask([*seen, ("labels", sequence, target, perturbed.times[0])])
            result = "empty" if first.present is False else outcome_of_action(labels, answer)
            return result, answer if result == "same" else None
        first, second = source.ask(seen)
    except NoAnswerError as reason:
        return str(reason), None
    if (again := CHANGES[perturbed.read](first, second, setting.rules)) is None:
        return "unknown", None
    return "same" if again == answer else "different", again


def _compare_starts(perturbed: Program, answer: FrameViewpoint, setting: Setting) -> str:
    """Compare starts. If no start is certain, the outcome is unknown only if a start may be near enough to score."""
    track, action, sequence = find_tracks(perturbed, setting)[perturbed.target], perturbed.action, perturbed.sequence
    (start,) = setting.source.ask([("start", sequence, track, action, perturbed.frame)])
    if start is not None:
        return "same" if same_answer(start, answer) else "different"
    (rows,) = setting.source.ask([("onsets", sequence, track, action, answer.frame)])
    certain = {frame for frame, _, _, sure in rows if sure}
    for frame, angle, could, _ in rows:
        near = frame >= answer.frame - KEYFRAME_STEP and same_answer(FrameViewpoint(answer.frame, angle), answer)
        if near and could and frame - KEYFRAME_STEP not in certain:
            return "unknown"
    return "empty"
