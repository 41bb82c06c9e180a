"""Generation in one sequence: from its interval tables to its proven candidates, near-duplicates removed.

A pure function of the sequence's tables and the rules, so sequences can be shared among processes or machines.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.candidates import OUTCOMES, PASSED, RULES, Candidates, frame_lists, to_table
from jrdb_avr.engine.generate.context import LayerJob, SearchContext
from jrdb_avr.engine.generate.diagnostics import refusal_row
from jrdb_avr.engine.generate.held_out import Extent, refuse_held_out
from jrdb_avr.engine.generate.near_duplicates import KEPT, thin_out
from jrdb_avr.engine.generate.records import choice_sets, make_record
from jrdb_avr.engine.generate.scene import Ints, Scene
from jrdb_avr.engine.generate.search import find_candidates
from jrdb_avr.engine.generate.selection import POOL
from jrdb_avr.queries.workers import without_collector
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.tables import CANDIDATES
from jrdb_avr.schema.templates import FORMS
from jrdb_avr.schema.wording.text import stated_actions

EXAMPLES: Final = 100
"""Example rows stored per sequence, template and rule."""

_BLOCK: Final = 200_000
"""Candidates whose plans are held in memory at once."""


@dataclass(frozen=True)
class SequenceJob(LayerJob):
    """A sequence to search. `candidates` is where to write every proven candidate, or None; `held_out` are the
    questions that none may touch."""

    candidates: Path | None = None
    held_out: tuple[Extent, ...] = ()


@dataclass
class SequenceResult:
    """Result of one sequence: its row of `sequences`, the records of candidates that may become questions, refusals.

    counts: (template, what) -> number, where what is "candidates", "proven" or a rule that refuses.
    lacking: the missing layers of templates that were not searched.
    """

    head: dict[str, Any]
    pool: pa.Table
    examples: list[dict[str, Any]] = field(default_factory=list)
    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    lacking: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def sequence(self) -> str:
        """The sequence's name."""
        return str(self.head["sequence"])


@without_collector()
def search_sequence(job: SequenceJob) -> SequenceResult:
    """Find, prove and thin out the candidates of one sequence."""
    writing = contextlib.nullcontext() if job.candidates is None else pq.ParquetWriter(job.candidates, CANDIDATES)
    with job.searching() as context, writing as writer:
        scene = context.scene
        search = _Search(context, writer, SequenceResult(_head(scene), POOL.empty_table()))
        for name, forms in FORMS.items():
            missing = [tuple(layer for layer in form.layers if layer not in scene.layers) for form in forms]
            if least := min(missing, key=len):
                search.result.lacking[name] = least
                continue
            searched = [form for form, layers in zip(forms, missing, strict=True) if not layers]
            found = (find_candidates(context, form) for form in searched)
            search.judge([refuse_held_out(context, candidates, job.held_out) for candidates in found])
    search.result.pool = pa.Table.from_pylist(search.rows, schema=POOL)
    return search.result


def _head(scene: Scene) -> dict[str, Any]:
    """The row of `sequences`: frames with an image or, where there is none at all, annotated ones."""
    frames = scene.images if "images" in scene.layers else scene.annotated
    head = {"sequence": scene.sequence, "fps": scene.fps, "frame_count": scene.frame_count}
    return {**head, "frames": frames.tolist()}


@dataclass
class _Search:
    """Collects the results of the templates, one after the other; `writer` takes every proven candidate."""

    context: SearchContext
    writer: pq.ParquetWriter | None
    result: SequenceResult
    rows: list[dict[str, Any]] = field(default_factory=list)

    def judge(self, forms: Sequence[Candidates]) -> None:
        """Judge the candidates of a template, whose forms compete with each other."""
        name, counts = forms[0].template.name, self.result.counts
        parts = []
        for form, candidates in enumerate(forms):
            counts[name, "candidates"] += len(candidates)
            for rule, count in candidates.refusals().items():
                counts[name, rule] += count
                self._give_examples(candidates, rule, EXAMPLES // len(forms))
            proven = np.flatnonzero(candidates.rule == PASSED)
            counts[name, "proven"] += len(proven)
            parts += [self._slim(form, candidates, proven[i : i + _BLOCK]) for i in range(0, len(proven), _BLOCK)]
        if not parts:
            return
        slim = pa.concat_tables(parts).combine_chunks()
        verdicts = thin_out(slim, self.context.rules)
        for rule in ("near_duplicate", "max_per_person"):
            dropped = slim.filter(pa.array(verdicts == rule))
            counts[name, rule] += len(dropped)
            first = dropped.take(pc.sort_indices(dropped["key"])[:EXAMPLES])
            for candidates, rows in _by_form(forms, first):
                self._add_examples(candidates, rule, rows)
        for candidates, rows in _by_form(forms, slim.filter(pa.array(verdicts == KEPT))):
            self._record(candidates, np.sort(rows))

    def _slim(self, form: int, candidates: Candidates, rows: Ints) -> pa.Table:
        """Proven candidates without their plans, which are only hashed (and written out where that is wanted)."""
        table = to_table(self.context, candidates, rows)
        if self.writer is not None:
            self.writer.write_table(table.select(CANDIDATES.names).cast(CANDIDATES))
        table = table.select(["template", "target_track", "answer", "key", "row"]).append_column(
            "form", pa.array(np.full(len(rows), form))
        )
        return table.append_column("read_frames", frame_lists(candidates, candidates.template.read, rows))

    def _record(self, candidates: Candidates, rows: Ints) -> None:
        """Add the records of candidates to the pool, as the second program will confirm them if they are chosen."""
        for line in to_table(self.context, candidates, rows).to_pylist():
            plan = parse_plan(line["plan"])
            sets = choice_sets(self.context, candidates, line)
            if not sets:
                self._refuse(candidates, "choices", line, "fewer than three wrong answers")
                continue
            confirmed = Proof("rederive", "annotations", True, "same", line["answer"])
            record = make_record(self.context, candidates, line, plan, confirmed, sets[0])
            row, template = line["row"], candidates.template
            own: dict[str, Any] = {"key": line["key"], "form": template.query, "answer_text": line["answer"]}
            own["stated"] = list(stated_actions(plan))
            own["times"] = [int(candidates.frames[name][row]) for name in template.stated]
            own["read_frames"] = [int(candidates.frames[name][row]) for name in template.read]
            own["event"] = _event(candidates, row)
            own["sets"] = [msgspec.json.encode(choices).decode() for choices in sets if choices.texts]
            self.rows.append(record.columns() | own)

    # -- refusals ---------------------------------------------------------------------------------------------

    def _refuse(self, candidates: Candidates, rule: str, line: Mapping[str, Any], detail: str) -> None:
        name = candidates.template.name
        self.result.counts[name, rule] += 1
        if self.result.counts[name, rule] <= EXAMPLES:
            self.result.examples.append(refusal_row(line, rule, detail))

    def _give_examples(self, candidates: Candidates, rule: str, most: int) -> None:
        """The first refused candidates by a hash of who and when."""
        refused = np.flatnonzero(candidates.rule == RULES.index(rule))
        columns = [self.context.descriptions.moment[candidates.name[refused]]]
        columns += [candidates.frames[name][refused] for name in sorted(candidates.frames)]
        columns += [codes[refused] for _, codes in sorted(candidates.relations.items())]
        if candidates.template.time_proof == "construction":
            columns += [segments[refused] for segments in candidates.segments]
        hashes = mixed(columns)
        if len(hashes) > most:
            near = np.flatnonzero(hashes <= np.partition(hashes, most)[most])
            refused, hashes = refused[near], hashes[near]
        self._add_examples(candidates, rule, refused[np.lexsort((refused, hashes))[:most]])

    def _add_examples(self, candidates: Candidates, rule: str, rows: Ints) -> None:
        for line in to_table(self.context, candidates, rows, keyed=False).to_pylist():
            self.result.examples.append(refusal_row(line, rule, self._detail(candidates, rule, line["row"])))

    def _detail(self, candidates: Candidates, rule: str, row: int) -> str | None:
        if rule == "anchor":
            left = self.context.descriptions.left[candidates.name[row]]
            return "could match when one condition is dropped: " + ", ".join(str(n) for n in left if n)
        if rule in ("time.shift", "hop.stop", "hop.skip"):
            found = [result for result in candidates.perturbed if result.kind == rule]
            return ", ".join(f"{result.variant}: {OUTCOMES[result.outcome[row]]}" for result in found)
        return _DETAILS.get(rule)


def _event(candidates: Candidates, row: int) -> str | None:
    """The start of an action, or the count of people, that a candidate is about."""
    template = candidates.template
    if template.counts:
        return f"count {candidates.relations['r1'][row]} {candidates.frames['t1'][row]}"
    return f"start {candidates.segments[0][row]}" if template.spec.read in ("start", "span", "start_view") else None


_DETAILS: Final = {
    "time.drop": "every other keyframe with an answer gives the same",
    "stated": "the question's own words name the answer",
    "view.single": "one view shows everybody needed",
    "view.ahead": "all decisive boxes are seen straight ahead",
    "evidence": "a needed box is no clear view",
    "image": "a needed frame has no image",
}
"""The defect of an example, by rule."""


def _by_form(forms: Sequence[Candidates], table: pa.Table) -> list[tuple[Candidates, Ints]]:
    """The forms of a template, each with its rows of a table."""
    form, row = table["form"].to_numpy(), table["row"].to_numpy()
    return [(candidates, row[form == number]) for number, candidates in enumerate(forms)]


def mixed(columns: list[Ints]) -> npt.NDArray[np.uint64]:
    """A well-mixed number per row of the columns, the same on every machine."""
    state = np.full(len(columns[0]), 0x9E3779B97F4A7C15, dtype=np.uint64)
    for column in columns:
        state = state ^ column.astype(np.uint64)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            state = (state ^ (state >> np.uint64(shift))) * np.uint64(factor)
        state = state ^ (state >> np.uint64(31))
    return state
