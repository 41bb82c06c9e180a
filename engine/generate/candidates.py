"""Candidates of a template in one scene, and which rule refuses each: all of it set-wise.

The generator query lists the candidates with what can be said of each by itself; the necessity queries read what the
perturbed programs answer, and are joined on here. The rules are tried in the order of `RULES`; a candidate is refused
by the first that fails.

Tables of candidates: their plans, keys and answers as text, put together set-wise.

A presence template has millions of proven candidates, so plans are made from columns, and only for the rows asked for.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.conditions import ANCHOR_TIME
from jrdb_avr.engine.generate.descriptions import Descriptions
from jrdb_avr.engine.generate.relations import RELATIONS
from jrdb_avr.engine.generate.scene import NOBODY, Ints, Scene, coded
from jrdb_avr.engine.generate.templates import joined, plan_texts, query_text, query_values
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.graph.parameters import parameters
from jrdb_avr.schema.arrays import Bools, Floats
from jrdb_avr.schema.labels import DISTANCE_ANSWERS, POSES, PRESENCE_ANSWERS
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import Template
from jrdb_avr.schema.wording import stated_actions

RULES: Final = (
    "anchor",
    "evidence",
    "image",
    "view.ahead",
    "view.single",
    "stated",
    "hop.stop",
    "hop.skip",
    "time.shift",
    "time.drop",
)
"""Rules that refuse a candidate set-wise, in the order in which they are tried."""

PASSED: Final = len(RULES)

OUTCOMES: Final = ("same", "different", "ambiguous", "empty", "unknown", "outside")
SAME, DIFFERENT, AMBIGUOUS, EMPTY, UNKNOWN, OUTSIDE = range(len(OUTCOMES))

PROVING: Final = (DIFFERENT, AMBIGUOUS, EMPTY)
"""Outcomes of a perturbed program that fails to give the answer, and certainly so."""

_PROVES: Final = np.isin(np.arange(len(OUTCOMES)), PROVING)

VALUES: Final = POSES + PRESENCE_ANSWERS + DISTANCE_ANSWERS
"""Every choice answer; coded columns are indices into it, NOBODY for none."""

Codes = npt.NDArray[np.int8]


@dataclass(frozen=True)
class Perturbed:
    """What a perturbed program answers: per candidate the outcome and, where it is a choice, the answer.

    either: among the programs of a kind that are marked so, it is enough that one proves.
    """

    kind: str
    variant: str
    outcome: Codes
    answer: Codes
    either: bool = False

    def proves(self) -> Bools:
        """Where the perturbed program fails to give the answer, and certainly so."""
        return _PROVES[self.outcome]


@dataclass(frozen=True)
class Counted:
    """Whom each candidate counts.

    number: per candidate its company; company, person, met, seen: per person met, by company and person, the frames
    from which on: at all, and both in clear view.
    """

    number: Ints
    company: Ints
    person: Ints
    met: Ints
    seen: Ints

    def people(self, row: int, until: int) -> Iterator[tuple[int, int]]:
        """Everybody whom a candidate counts up to a frame: the person's number, and the frame that shows both."""
        number = int(self.number[row])
        for place in range(*np.searchsorted(self.company, [number, number + 1]).tolist()):
            if self.met[place] <= until:
                yield int(self.person[place]), int(self.seen[place])


@dataclass(frozen=True)
class Candidates:
    """All candidates of a template, one per entry of each column, in the generator's order.

    name: number of the description given; people: by node, the moment at t0; relations: `r1`, ... as indices into
    RELATIONS; frames: by name, `t0`, the stated times and of events `start`, `end`, `first`, `last`; segment: row in
    the scene's segments or NOBODY, segment2: that of the second action; answer: index into VALUES, or NOBODY for
    events; value: a number's value, else NaN; rule: index into RULES of the first that refuses, else PASSED;
    perturbed: what was found by the proofs; counted: where people are counted, whom.
    """

    template: Template
    name: Ints
    people: Mapping[str, Ints]
    relations: Mapping[str, Ints]
    segment: Ints
    segment2: Ints
    frames: Mapping[str, Ints]
    answer: Codes
    value: Floats
    rule: Codes
    perturbed: tuple[Perturbed, ...] = field(default=())
    counted: Counted | None = None

    def __len__(self) -> int:
        return len(self.name)

    def refusals(self) -> dict[str, int]:
        """Candidates refused, by rule."""
        counts = np.bincount(self.rule, minlength=PASSED + 1)
        return {rule: int(count) for rule, count in zip(RULES, counts, strict=False) if count}


def ask(graph: Graph, folder: str, name: str, rules: Rules, **more: int) -> pa.Table:
    """The result of a packaged query, with those of the rules' values that it uses."""
    text = query_text(folder, name)
    values = query_values(rules) | more
    return graph.query(text, {key: values[key] for key in parameters(text)})


def first_refusing(holds: Mapping[str, Bools], count: int) -> Codes:
    """Per candidate the first of RULES that does not hold, else PASSED; a rule that is not given holds."""
    rule = np.full(count, PASSED, dtype=np.int8)
    for number in reversed(range(len(RULES))):
        if RULES[number] in holds:
            rule[~holds[RULES[number]]] = number
    return rule


def proven_rules(perturbed: tuple[Perturbed, ...]) -> dict[str, Bools]:
    """Per rule, where its perturbed programs prove what they must: all of them, of those marked so at least one."""
    holds: dict[str, Bools] = {}
    enough: dict[str, Bools] = {}
    for proof in perturbed:
        if proof.either:
            enough[proof.kind] = enough.get(proof.kind, np.zeros(len(proof.outcome), dtype=bool)) | proof.proves()
        else:
            holds[proof.kind] = holds.get(proof.kind, np.ones(len(proof.outcome), dtype=bool)) & proof.proves()
    return holds | {kind: holds.get(kind, True) & proves for kind, proves in enough.items()}


def rows_of(read: pa.Table, keys: Mapping[str, Ints], limit: int) -> Ints:
    """For each entry of `keys`, the row of `read` with the same values in the columns they share, else NOBODY.

    All values are below `limit`, and no two rows of `read` are alike in these columns.
    """
    count = len(next(iter(keys.values())))
    given, wanted = np.zeros(len(read), dtype=np.int64), np.zeros(count, dtype=np.int64)
    for name, values in keys.items():
        if name in read.column_names:
            given = given * limit + ints(read, name)
            wanted = wanted * limit + values
    if len(read) == 0:
        return np.full(count, NOBODY)
    order = np.argsort(given, kind="stable")
    place = np.minimum(np.searchsorted(given[order], wanted), len(read) - 1)
    row = order[place]
    return np.where(given[row] == wanted, row, NOBODY)


def ints(table: pa.Table, name: str) -> Ints:
    """A column of whole numbers; null is NOBODY."""
    return np.asarray(pc.fill_null(table[name], NOBODY).to_numpy(), dtype=np.int64)


def codes(column: pa.ChunkedArray) -> Codes:
    """Choice answers as indices into VALUES."""
    return coded(column.cast(pa.string()), VALUES).astype(np.int8)


BLOCK: Final = 200_000
"""Rows whose plans are held in memory at once."""


def candidate_table(
    scene: Scene, descriptions: Descriptions, candidates: Candidates, rows: Ints, *, keyed: bool = True
) -> pa.Table:
    """The given candidates as rows for selection: sequence, family, template, target_track, plan, answer, key.

    `keyed=False` leaves the key out. `row` is the candidate's number.
    """
    template = candidates.template
    track = pa.array(scene.tracks[scene.persons(candidates.people[template.target][rows])], pa.int32())
    plan = _plans(scene, descriptions, candidates, rows)
    if template.answer is None:
        answer = pc.take(pa.array(VALUES, pa.string()), pa.array(candidates.answer[rows]))
    else:
        columns = {name: pa.array(numbers[rows]) for name, numbers in candidates.frames.items()}
        if "value" in template.answer:
            columns["value"] = _json_numbers(candidates.value[rows])
        if "angle" in template.answer:
            columns["angle"] = _angles(scene, candidates.segment[rows])
        answer = joined([columns.get(part, part) for part in template.answer])
    table = {
        "sequence": _constant(scene.sequence, len(rows)),
        "family": _constant(template.family, len(rows)),
        "template": _constant(template.name, len(rows)),
        "target_track": track,
        "plan": plan,
        "answer": answer,
        "row": pa.array(rows),
    }
    if keyed:
        table["key"] = hashed(joined([table["sequence"], "\n", track, "\n", plan]))
    return pa.table(table)


def with_selection_columns(table: pa.Table, candidates: Candidates) -> pa.Table:
    """Add what selection goes by: `read_frames`, the `stated` action words and the stated `times`."""
    rows = table["row"].to_numpy()
    template = candidates.template
    stated = [list(stated_actions(parse_plan(plan))) for plan in table["plan"].to_pylist()]
    table = table.append_column("read_frames", frame_lists(candidates, template.read, rows))
    table = table.append_column("stated", pa.array(stated, pa.list_(pa.string())))
    return table.append_column("times", frame_lists(candidates, template.stated, rows))


def frame_lists(candidates: Candidates, names: tuple[str, ...], rows: Ints) -> pa.Array:
    """One list per row with the frames of these names."""
    values = np.stack([candidates.frames[name][rows] for name in names], axis=1)
    offsets = np.arange(len(rows) + 1, dtype=np.int32) * len(names)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel(), pa.int32()))


def hashed(texts: pa.Array) -> pa.Array:
    """sha256 of each text, in hex."""
    return pa.array([hashlib.sha256(text.encode()).hexdigest() for text in texts.to_pylist()], pa.string())


def _plans(scene: Scene, descriptions: Descriptions, candidates: Candidates, rows: Ints) -> pa.Array:
    texts, number = descriptions.texts
    at = f'"at":"{candidates.template.described}"'
    used, place = np.unique(number[candidates.name[rows]], return_inverse=True)
    texts = [texts[i].replace(f'"at":"{ANCHOR_TIME}"', at) for i in used.tolist()]
    columns = {"conditions": pc.take(pa.array(texts, pa.string()), pa.array(place))}
    columns |= {time: pa.array(candidates.frames[time][rows]) for time in candidates.template.stated}
    for name, codes in candidates.relations.items():
        columns[name] = pc.take(pa.array(RELATIONS, pa.string()), pa.array(codes[rows]))
    action = scene.segments["action"].combine_chunks()
    for name, segments in (("action", candidates.segment), ("action2", candidates.segment2)):
        columns[name] = pc.take(action, pa.array(segments[rows], mask=segments[rows] == NOBODY))
    return plan_texts(candidates.template, columns)


def _angles(scene: Scene, segments: Ints) -> pa.Array:
    """Direction in which a person is seen at the first frame of each segment, as JSON writes it."""
    persons = scene.person_of(scene.segments["track"].to_numpy()[segments])
    rows = scene.box_rows(persons, scene.segments["first"].to_numpy().astype(np.int64)[segments])
    return _json_numbers(scene.geometry["angle"][rows])


def _json_numbers(values: Floats) -> pa.Array:
    """Numbers as JSON writes them."""
    return pa.array([msgspec.json.encode(value).decode() for value in values.tolist()], pa.string())


def _constant(text: str, count: int) -> pa.Array:
    return pa.repeat(pa.scalar(text, pa.string()), count)
