"""Candidates of a template in one scene, and which rule refuses each: all of it set-wise.

The generator query lists the candidates with what can be decided of each by itself; the necessity queries read what the
perturbed programs answer, and are joined on here. The rules are tried in the order of `RULES`; a candidate is refused
by the first that fails.

A presence template has millions of proven candidates, so plans are made from columns, and only for the rows wanted.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any, Final, Self

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.conditions import ANCHOR_TIME
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.relations import RELATIONS, STATED_POSES
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, coded, ints, masked, named
from jrdb_avr.engine.generate.templates import joined, plan_texts
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS
from jrdb_avr.schema.rules import FPS, Rules
from jrdb_avr.schema.templates import Template

MEANINGS: Final = {
    "anchor": "a condition of the description is not needed, or it may fit somebody else",
    "evidence": "a person who must be seen is hidden, cut off, too small or too wide",
    "image": "a needed frame has no image",
    "view.ahead": "answerable from the forward view alone",
    "view.single": "answerable from a single view",
    "stated": "the question's text states the answer",
    "hop.stop": "stopping one person early gives the same answer, or one not known to differ",
    "hop.skip": "skipping a hop gives the same answer, or one not known to differ",
    "time.shift": "three seconds earlier or later the answer is not known to differ",
    "time.drop": "every other time gives the same answer",
    "held_out": "a held-out question needs one of its people at the same time",
}
"""Rules that refuse a candidate set-wise, in the order in which they are tried, with why each refuses."""

RULES: Final = tuple(MEANINGS)

PASSED: Final = len(RULES)


class Effect(IntEnum):
    """How a perturbed program compares with the question's own."""

    SAME = 0
    DIFFERENT = 1
    AMBIGUOUS = 2
    EMPTY = 3
    UNKNOWN = 4
    OUTSIDE = 5


OUTCOMES: Final = tuple(outcome.name.lower() for outcome in Effect)

PROVING: Final = (Effect.DIFFERENT, Effect.AMBIGUOUS, Effect.EMPTY)
"""Outcomes of a perturbed program that fails to give the answer, and certainly so."""

VALUES: Final = POSES + PRESENCE_ANSWERS + DISTANCE_ANSWERS
"""Every choice answer; coded columns are indices into it, NOBODY for none."""

Codes = npt.NDArray[np.int8]


@dataclass(frozen=True)
class PerturbationResult:
    """Answers of a perturbed program: per candidate the outcome and, where it is a choice, the answer.

    any_of: among the programs of a kind that are marked so, it is enough that one proves.
    """

    kind: str
    variant: str
    outcome: Codes
    answer: Codes
    any_of: bool = False

    @classmethod
    def of_texts(cls, kind: str, variant: str, texts: pa.ChunkedArray, stored: Codes) -> Self:
        """The perturbed program by its answers, or the outcome where there is none; null is unknown."""
        answer, none = choice_codes(texts), coded(texts, OUTCOMES)
        outcome = np.where(none == NOBODY, compared(answer, stored), none).astype(np.int8)
        return cls(kind, variant, outcome, answer)

    @classmethod
    def of_shift(cls, by: int, outcome: Codes, answer: Codes, outside: Bools) -> Self:
        """The program with its times moved `by` frames. Where that is `outside`, the two arrays are overwritten."""
        outcome[outside], answer[outside] = Effect.OUTSIDE, NOBODY
        return cls("time.shift", f"{by / FPS:+g} s", outcome, answer, any_of=True)

    @classmethod
    def of_drop(cls, defined: Ints, answers: Ints) -> Self:
        """The program at any time: at how many keyframes it has an answer, and how many different ones there are."""
        single = np.where(defined > 1, Effect.SAME, Effect.EMPTY)
        outcome = np.where(answers > 1, Effect.DIFFERENT, single).astype(np.int8)
        return cls("time.drop", "all keyframes", outcome, np.broadcast_to(np.int8(NOBODY), outcome.shape))

    def proves(self) -> Bools:
        """Where the perturbed program fails to give the answer, and certainly so."""
        return np.isin(np.arange(len(Effect)), PROVING)[self.outcome]

    def at(self, rows: Ints, count: int) -> PerturbationResult:
        """The same as of `count` candidates, of which only these rows were examined; the others are unknown."""
        outcome, answer = np.full(count, Effect.UNKNOWN, dtype=np.int8), np.full(count, NOBODY, dtype=np.int8)
        outcome[rows], answer[rows] = self.outcome, self.answer
        return replace(self, outcome=outcome, answer=answer)


def compared(answer: Codes, stored: Codes) -> Codes:
    """Effect of reading these answers; NOBODY is unknown."""
    known = np.where(answer == stored, Effect.SAME, Effect.DIFFERENT)
    return np.where(answer == NOBODY, Effect.UNKNOWN, known).astype(np.int8)


@dataclass(frozen=True)
class Candidates:
    """All candidates of a template, one per entry of each column, in the generator's order.

    name: number of its description; people: by node, the moment at t0; relations: `r1`, ... as indices into RELATIONS;
    segments: of both actions, row in the scene's segments or NOBODY; frames: by name, `t0`, the stated times and of
    events `start`, `end`, `first`, `last`; answer: index into VALUES, or NOBODY for events; value: a number's value,
    else NaN; window: where people are counted, the encounter window; rule: index into RULES of the first that refuses,
    else PASSED; perturbed: the results of the proofs.
    """

    template: Template
    name: Ints
    people: Mapping[str, Ints]
    relations: Mapping[str, Ints]
    segments: tuple[Ints, Ints]
    frames: Mapping[str, Ints]
    answer: Codes
    value: Floats
    window: Ints
    rule: Codes
    perturbed: tuple[PerturbationResult, ...] = ()

    def __len__(self) -> int:
        return len(self.name)

    def take(self, rows: Ints) -> Candidates:
        """Only these rows, without the results of the proofs."""
        columns = {name: value for name, value in vars(self).items() if name not in ("template", "perturbed")}
        return Candidates(self.template, **{name: _taken(value, rows) for name, value in columns.items()})

    def refusals(self) -> dict[str, int]:
        """Candidates refused, by rule."""
        counts = np.bincount(self.rule, minlength=PASSED + 1)
        return {rule: int(count) for rule, count in zip(RULES, counts, strict=False) if count}

    def people_counted(self, context: SearchContext, row: int) -> list[tuple[int, int]]:
        """Everybody whom a candidate counts: the person's track, and the first frame that shows both."""
        if not self.template.counts:
            return []
        met, window = context.people_met, int(self.window[row])
        low, high = np.searchsorted(met["encounter"].to_numpy(), [window, window + 1])
        rows = met.slice(low, high - low).to_pylist()
        until = int(self.frames["t2"][row])
        return [(one["person"], one["clear_from"]) for one in rows if one["met"] <= until]


def _taken(columns: Any, rows: Ints) -> Any:
    """The rows of a column, or of each column of a mapping or tuple."""
    if isinstance(columns, Mapping):
        return {name: column[rows] for name, column in columns.items()}
    return tuple(column[rows] for column in columns) if isinstance(columns, tuple) else columns[rows]


def stated_poses(context: SearchContext, candidates: Candidates, rows: slice = slice(None)) -> Bools:
    """(candidates, poses): the poses that the words of the question name."""
    stated = [context.descriptions.stated_poses[candidates.name[rows]]]
    stated += [STATED_POSES[codes[rows]] for codes in candidates.relations.values()]
    return np.asarray(np.any(stated, axis=0))


def first_refusing(holds: Mapping[str, Bools], count: int) -> Codes:
    """Per candidate the first of RULES that does not hold, else PASSED; a rule that is not in `holds` does."""
    rule = np.full(count, PASSED, dtype=np.int8)
    for number in reversed(range(len(RULES))):
        if RULES[number] in holds:
            rule[~holds[RULES[number]]] = number
    return rule


def proven_rules(perturbed: Sequence[PerturbationResult], rules: Rules) -> dict[str, Bools]:
    """Per rule, where its perturbed programs prove what they must: all of them, of those marked so at least one.

    Where both shifts must change the answer, neither may leave it the same.
    """
    holds: dict[str, Bools] = {}
    for kind in dict.fromkeys(result.kind for result in perturbed):
        of_kind = [result for result in perturbed if result.kind == kind]
        needed = [result.proves() for result in of_kind if not result.any_of]
        enough = [result.proves() for result in of_kind if result.any_of]
        if kind == "time.shift" and rules.time_shift == "both":
            needed = [result.outcome != Effect.SAME for result in of_kind]
        holds[kind] = np.logical_and.reduce([*needed, np.logical_or.reduce(enough)] if enough else needed)
    return holds


def choice_codes(column: pa.ChunkedArray) -> Codes:
    """Choice answers as indices into VALUES."""
    return coded(column.cast(pa.string()), VALUES).astype(np.int8)


def to_table(context: SearchContext, candidates: Candidates, rows: Ints, *, keyed: bool = True) -> pa.Table:
    """Candidates as rows for selection: sequence, family, template, target_track, plan, answer, row, key.

    `keyed=False` leaves the key out. `row` is the candidate's number.
    """
    scene, template = context.scene, candidates.template
    track = pa.array(scene.tracks[scene.people(candidates.people[template.target][rows])], pa.int32())
    plan = _plans(context, candidates, rows)
    if template.answer is None:
        answer = pc.take(pa.array(VALUES, pa.string()), pa.array(candidates.answer[rows]))
    else:
        columns = {name: pa.array(numbers[rows]) for name, numbers in candidates.frames.items()}
        if "value" in template.answer:
            columns["value"] = _json_numbers(candidates.value[rows])
        if "angle" in template.answer:
            columns["angle"] = _angles(scene, candidates.segments[0][rows])
        answer = joined([columns.get(part, part) for part in template.answer])
    constants = {"sequence": scene.sequence, "family": template.family, "template": template.name}
    table = {name: pa.repeat(pa.scalar(text, pa.string()), len(rows)) for name, text in constants.items()}
    table |= {"target_track": track, "plan": plan, "answer": answer, "row": pa.array(rows)}
    if keyed:
        table["key"] = hashed(joined([table["sequence"], "\n", track, "\n", plan]))
    return pa.table(table)


def hashed(texts: pa.Array) -> pa.Array:
    """sha256 of each text, in hex."""
    return pa.array([hashlib.sha256(text.encode()).hexdigest() for text in texts.to_pylist()], pa.string())


def frame_lists(candidates: Candidates, names: tuple[str, ...], rows: Ints) -> pa.Array:
    """One list per row with the frames of these names."""
    values = np.stack([candidates.frames[name][rows] for name in names], axis=1)
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * len(names)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel(), pa.int32()))


def _plans(context: SearchContext, candidates: Candidates, rows: Ints) -> pa.Array:
    texts, number = context.descriptions.texts
    at = f'"at":"{candidates.template.described}"'
    used, place = np.unique(number[candidates.name[rows]], return_inverse=True)
    texts = [texts[i].replace(f'"at":"{ANCHOR_TIME}"', at) for i in used.tolist()]
    columns = {"conditions": pc.take(pa.array(texts, pa.string()), pa.array(place))}
    columns |= {time: pa.array(candidates.frames[time][rows]) for time in candidates.template.stated}
    columns |= {name: named(codes[rows], RELATIONS) for name, codes in candidates.relations.items()}
    action = context.scene.segments["action"].combine_chunks()
    for name, segments in zip(("action", "action2"), candidates.segments, strict=True):
        columns[name] = pc.take(action, masked(segments[rows]))
    return plan_texts(candidates.template, columns)


def _angles(scene: Scene, segments: Ints) -> pa.Array:
    """Direction in which a person is seen at the first frame of each segment, as JSON writes it."""
    persons, first = scene.person_of(ints(scene.segments, "track")), ints(scene.segments, "first")
    return _json_numbers(scene.geometry["angle"][scene.box_rows(persons[segments], first[segments])])


def _json_numbers(values: Floats) -> pa.Array:
    """Numbers as JSON writes them."""
    return pa.array([msgspec.json.encode(value).decode() for value in values.tolist()], pa.string())
