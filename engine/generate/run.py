"""Generation: search every sequence, select across them, publish the questions with their proofs."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.blind import blind_check, posed
from jrdb_avr.engine.generate.diagnostics import REFUSALS, shortfalls, tallies
from jrdb_avr.engine.generate.publish import Heads, publish, question_tables, read_heads
from jrdb_avr.engine.generate.scene import weight
from jrdb_avr.engine.generate.selection import CANDIDATE_COLUMNS, Selection, select
from jrdb_avr.engine.generate.sequence import EXAMPLES, Found, Job, search_sequence
from jrdb_avr.queries.display import Displayed, Progress, Tables, step_counter
from jrdb_avr.queries.store import Manifest, Store, write_atomic
from jrdb_avr.queries.workers import map_shards
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import Rules, rules_hash
from jrdb_avr.schema.tables import CANDIDATES, QUESTIONS
from jrdb_avr.schema.templates import FAMILIES

Advance = Callable[[int], None]

_NOT_SELECTED: Final = "balance"

_NOTHING: Final = pa.schema([(name, pa.string()) for name in CANDIDATE_COLUMNS]).empty_table()
"""No candidate at all."""


@dataclass(frozen=True, repr=False)
class Generation(Displayed):
    """The result of a generation; the questions are in the store.

    templates: a row per template: candidates, refusals by rule, questions; shortfalls: likewise, why they are so few.
    selection: likewise, how many were aimed at and kept. blind: the blind check. faults: candidates on which the second
    path disagreed.
    """

    templates: tuple[dict[str, Any], ...]
    shortfalls: tuple[dict[str, Any], ...]
    selection: tuple[dict[str, Any], ...]
    blind: tuple[dict[str, Any], ...]
    faults: tuple[str, ...]

    def _summary(self) -> str:
        questions = sum(row["kept"] for row in self.selection)
        return f"{questions} questions of {len(self.selection)} templates, {len(self.faults)} faults"

    def _tables(self) -> Tables:
        return {"Candidates, refusals by rule, and questions": self.templates, "Blind guessers": self.blind}


def generate(
    store: Store | str | Path,
    rules: Rules | None = None,
    *,
    profile: str = "all",
    seed: int = 0,
    workers: int = 2,
    candidates: Path | None = None,
    excluded: frozenset[str] = frozenset(),
    progress: Progress | None = None,
) -> Generation:
    """Generate the questions of a store; the result depends on its tables, the rules, the profile and the seed, and on
    the ids of `excluded` questions alone, whose places others take.

    `candidates`: a Parquet file for every proven candidate before near-duplicates and selection. Raises StoreError
    where nothing is loaded, or under other load rules, and LockedError where another process writes the store.
    """
    store, rules = Store.of(store), rules or Rules()
    manifest = checked_manifest(store, rules)
    sequences = sorted(manifest.sequences)
    # A first look reads the manifest only, so that a wrong store is refused before it is locked (and thereby made).
    with store.writing("generate"), tempfile.TemporaryDirectory(prefix="jrdb-avr-") as scratch:
        checked_manifest(store, rules)
        advance = step_counter(progress, "searching", len(sequences))
        found = _search(store, sequences, rules, workers, Path(scratch) if candidates else None, advance)
        if candidates is not None:
            _gather([Path(scratch) / f"{sequence}.parquet" for sequence in sequences], candidates)
        return _publish(store, found, rules, profile, seed, excluded)


def checked_manifest(store: Store, rules: Rules) -> Manifest:
    """The store's manifest. Raises StoreError where it was loaded under other load rules."""
    manifest = store.manifest()
    if manifest.load_rules_hash != rules_hash(rules.load):
        raise StoreError(
            f"{store.path} was loaded under other load rules: run 'jrdb-avr load --rebuild --store {store.path}' with "
            "the same --rule, or give them to generate as --rule load.NAME=VALUE"
        )
    return manifest


def _search(
    store: Store, sequences: Sequence[str], rules: Rules, workers: int, scratch: Path | None, advance: Advance
) -> list[Found]:
    """Every sequence's candidates, in the order of their names."""
    jobs = [
        Job(store.path, sequence, rules, scratch / f"{sequence}.parquet" if scratch else None) for sequence in sequences
    ]
    found: dict[int, Found] = {}
    for index, result in map_shards(search_sequence, jobs, workers, lambda job: weight(store, job.sequence)):
        found[index] = result
        advance(1)
    return [found[index] for index in range(len(jobs))]


def _gather(parts: Sequence[Path], place: Path) -> None:
    """Join the sequences' candidate files, in order, into one."""

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(temporary, CANDIDATES) as writer:
            for part in parts:
                with pq.ParquetFile(part) as file:
                    for batch in file.iter_batches():
                        writer.write_batch(batch)

    write_atomic(place, write)


def _publish(
    store: Store, found: Sequence[Found], rules: Rules, profile: str, seed: int, excluded: frozenset[str]
) -> Generation:
    heads = read_heads(store, [one.sequence for one in found])
    kept = [one.kept for one in found if one.kept is not None]
    pool = pa.concat_tables(kept) if kept else _NOTHING
    selection, questions, answers = _selected(pool, heads, rules, profile, seed, excluded)
    unselected = pool.filter(pc.invert(pc.is_in(pool["key"], value_set=selection.table["key"].combine_chunks())))
    rejected = _rejected(found, _counts(found), unselected)
    tables = {
        "questions": questions,
        "answers": answers,
        "rejected": rejected,
        "sequences": pa.Table.from_pylist(list(heads.rows), schema=QUESTIONS["sequences"]),
    }
    publish(store, tables)
    rows = tallies(rejected, questions)
    aims = {row["template"]: row["aim"] for row in selection.report}
    return Generation(
        templates=tuple(rows),
        shortfalls=tuple(shortfalls(rows, _lacking(found), len(found), aims)),
        selection=selection.report,
        blind=tuple(blind_check(posed(questions, answers))),
        faults=tuple(fault for one in found for fault in one.faults),
    )


def _selected(
    pool: pa.Table, heads: Heads, rules: Rules, profile: str, seed: int, excluded: frozenset[str]
) -> tuple[Selection, pa.Table, pa.Table]:
    """The selection with its questions and answers, none of which is excluded.

    A question's id follows from its words, so what is excluded shows only when it has been chosen; it is taken out of
    the pool, and the choice made anew.
    """
    while True:
        selection = select(pool, rules, profile, seed)
        questions, answers = question_tables(selection.table, heads, rules)
        unwanted = pc.is_in(questions["question_id"], value_set=pa.array(sorted(excluded), pa.string()))
        if not pc.any(unwanted).as_py():
            return selection, questions, answers
        gone = _identities(questions["sequence"], answers["target_track"], answers["plan"]).filter(unwanted)
        own = _identities(pool["sequence"], pool["target_track"], pool["plan"])
        pool = pool.filter(pc.invert(pc.is_in(own, value_set=gone.combine_chunks())))


def _identities(sequence: pa.ChunkedArray, track: pa.ChunkedArray, plan: pa.ChunkedArray) -> pa.ChunkedArray:
    """A text that only one candidate has."""
    return pc.binary_join_element_wise(sequence, pc.cast(track, pa.string()), plan, " ")


def _counts(found: Sequence[Found]) -> dict[tuple[str, str, str], int]:
    """(sequence, template, what) -> number."""
    return {(one.sequence, *where): count for one in found for where, count in one.counts.items()}


def _rejected(found: Sequence[Found], counts: Mapping[tuple[str, str, str], int], unselected: pa.Table) -> pa.Table:
    """Refusals per sequence, template and rule, each with its examples."""
    rows: list[dict[str, Any]] = [
        _count_row(sequence, FAMILIES[template], template, rule, count)
        for (sequence, template, rule), count in counts.items()
        if rule in REFUSALS and count
    ]
    dropped: dict[tuple[str, str], int] = {}
    for line in unselected.sort_by("key").select(["sequence", "template", "target_track", "plan"]).to_pylist():
        where = (line["sequence"], line["template"])
        dropped[where] = dropped.get(where, 0) + 1
        if dropped[where] <= EXAMPLES:
            example = _count_row(line["sequence"], FAMILIES[line["template"]], line["template"], _NOT_SELECTED, 1)
            rows.append(example | {"kind": "example", "target_track": line["target_track"], "plan": line["plan"]})
    rows += [
        _count_row(sequence, FAMILIES[template], template, _NOT_SELECTED, count)
        for (sequence, template), count in dropped.items()
    ]
    schema = QUESTIONS["rejected"]
    table = pa.concat_tables([pa.Table.from_pylist(rows, schema=schema), *(one.rejected.cast(schema) for one in found)])
    return table.sort_by([(name, "ascending") for name in ("kind", "sequence", "template", "rule", "plan")])


def _count_row(sequence: str, family: str, template: str, rule: str, count: int) -> dict[str, Any]:
    return {
        "kind": "count",
        "sequence": sequence,
        "family": family,
        "template": template,
        "rule": rule,
        "candidates": count,
        "target_track": None,
        "plan": None,
        "detail": None,
    }


def _lacking(found: Sequence[Found]) -> dict[tuple[str, str], int]:
    missing: dict[tuple[str, str], int] = {}
    for one in found:
        for template, layers in one.lacking.items():
            for layer in layers:
                missing[template, layer] = missing.get((template, layer), 0) + 1
    return dict(sorted(missing.items()))
