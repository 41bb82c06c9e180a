"""What the searches of all sequences found, in a scratch folder of the store.

Of many sequences it would not fit into memory. The workers write it, a file per sequence; selection reads a few columns
of all of them, and the rest is read one sequence at a time.
"""

from __future__ import annotations

import contextlib
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.confirm import Fault
from jrdb_avr.engine.generate.diagnostics import REFUSALS, refusal_row
from jrdb_avr.engine.generate.selection import POOL, Selection, with_choices
from jrdb_avr.engine.generate.sequence import EXAMPLES, SequenceJob, search_sequence
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import FAMILIES

SLIM: Final = [
    *("sequence", "family", "template", "target_track", "key", "form"),
    *("answer_text", "stated", "times", "read_frames", "event", "sets"),
]
"""Columns of the pool by which selection goes: a fifth of its bytes."""


@dataclass(frozen=True)
class Found:
    """What the search of one sequence returns to whoever selects; lacking as of `SequenceResult`."""

    sequence: str
    lacking: dict[str, tuple[str, ...]]


@contextlib.contextmanager
def scratch_folder(store: Store) -> Iterator[Path]:
    """Make a scratch folder in the store for what the workers' searches find, and remove it when the block ends."""
    place = store.path / ".candidates"
    # What a killed run left behind.
    shutil.rmtree(place, ignore_errors=True)
    try:
        place.mkdir()
    except OSError as error:
        raise StoreError(f"cannot write to {store.path}: {error.strerror}") from None
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def search_into(folder: Path, job: SequenceJob) -> Found:
    """Search one sequence, and write its head, its pool and its refusals into the folder."""
    result = search_sequence(job)
    counts = [
        refusal_row({"sequence": result.sequence, "template": name}, rule, count=count)
        for (name, rule), count in result.counts.items()
        if rule in REFUSALS and count
    ]
    rejected = pa.Table.from_pylist(counts + result.examples, schema=QUESTIONS["rejected"])
    head = pa.Table.from_pylist([result.head], schema=QUESTIONS["sequences"])
    for name, table in (("sequences", head), ("rejected", rejected), ("pool", result.pool)):
        path = _place(folder, name, job.sequence)
        try:
            path.parent.mkdir(exist_ok=True)
            pq.write_table(table, path)
        except OSError as error:
            raise StoreError(f"cannot write {path}: {str(error).splitlines()[0]}; free some space") from None
    return Found(job.sequence, result.lacking)


def _place(folder: Path, what: str, sequence: str) -> Path:
    return folder / what / f"{sequence}.parquet"


def slim_pool(folder: Path, sequences: Iterable[str]) -> pa.Table:
    """The candidates of all sequences that may become questions: the columns of SLIM, and `row`, the place in the
    sequence's own pool."""
    parts = [pa.schema([POOL.field(name) for name in SLIM] + [("row", pa.int64())]).empty_table()]
    for sequence in sequences:
        part = read_table(_place(folder, "pool", sequence), SLIM)
        parts.append(part.append_column("row", pa.array(np.arange(len(part)))))
    return pa.concat_tables(parts)


def chosen_rows(folder: Path, chosen: pa.Table) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """The whole rows of a selection, a sequence at a time, each with its set of choices."""
    for sequence, part in _by_sequence(chosen):
        yield sequence, with_choices(read_table(_place(folder, "pool", sequence)), part)


def chosen_columns(folder: Path, chosen: pa.Table, columns: Sequence[str]) -> Iterator[tuple[str, pa.Table]]:
    """Some columns of the rows of a selection, a sequence at a time."""
    for sequence, part in _by_sequence(chosen):
        yield sequence, read_table(_place(folder, "pool", sequence), columns).take(part["row"])


def _by_sequence(chosen: pa.Table) -> Iterator[tuple[str, pa.Table]]:
    """The rows of each sequence of a selection, which is sorted by sequence."""
    first = 0
    for count in pc.value_counts(chosen["sequence"]).to_pylist():
        yield count["values"], chosen.slice(first, count["counts"])
        first += count["counts"]


def heads(folder: Path, sequences: Iterable[str], at_once: int) -> Iterator[pa.Table]:
    """The rows of the table `sequences`, in groups of so many sequences."""
    return _groups((read_table(_place(folder, "sequences", sequence)) for sequence in sequences), at_once)


class Refusals:
    """The rows of the table `rejected`: those of the searches, and the candidates of the pool that are not chosen.

    faults: by key, the candidates that the second program does not confirm.
    """

    def __init__(
        self, folder: Path, sequences: Iterable[str], pool: pa.Table, selection: Selection, faults: Mapping[str, Fault]
    ) -> None:
        self._folder = folder
        self._sequences = sorted(sequences)
        self.faults = faults
        self._chosen = {sequence: part["row"].to_numpy() for sequence, part in _by_sequence(selection.table)}
        faulty = pool.filter(pc.is_in(pool["key"], value_set=pa.array(list(faults), pa.string())))
        # Excluded questions are counted as dropped by balance.
        self._dropped = {"rederive": _count(faulty), "balance": _count(pool)}
        self._dropped["balance"].subtract(_count(selection.table) + self._dropped["rederive"])
        self.totals: Counter[tuple[str, str]] = Counter()
        """(template, rule) -> how many candidates of all sequences are refused."""
        for table in map(self._counts, self._sequences):
            for name, rule, count in zip(*(table[column].to_pylist() for column in _TOTALS), strict=True):
                self.totals[name, rule] += count

    def groups(self, at_once: int) -> Iterator[pa.Table]:
        """All rows in order, in groups of at least so many; the last one has the rest."""
        return _groups((make(name) for make in (self._counts, self._examples) for name in self._sequences), at_once)

    def _counts(self, sequence: str) -> pa.Table:
        rows = [
            refusal_row({"sequence": sequence, "template": name}, rule, count=count)
            for rule, dropped in self._dropped.items()
            for name in FAMILIES
            if (count := dropped[sequence, name])
        ]
        return self._of_kind("count", sequence, rows)

    def _examples(self, sequence: str) -> pa.Table:
        pool = read_table(
            _place(self._folder, "pool", sequence), ["sequence", "template", "target_track", "plan", "key"]
        )
        left = np.ones(len(pool), bool)
        left[self._chosen.get(sequence, [])] = False
        seen: Counter[tuple[str, str]] = Counter()
        rows = []
        for line in pool.filter(pa.array(left)).sort_by("key").to_pylist():
            fault = self.faults.get(line["key"])
            rule = "balance" if fault is None else "rederive"
            seen[line["template"], rule] += 1
            if seen[line["template"], rule] <= EXAMPLES:
                rows.append(refusal_row(line, rule, fault and fault.difference))
        return self._of_kind("example", sequence, rows)

    def _of_kind(self, kind: str, sequence: str, more: list[dict[str, Any]]) -> pa.Table:
        stored = read_table(_place(self._folder, "rejected", sequence))
        own = pa.Table.from_pylist(more, schema=stored.schema)
        rows = pa.concat_tables([stored.filter(pc.equal(stored["kind"], kind)), own])
        return rows.sort_by([(name, "ascending") for name in ("template", "rule", "plan")])


_TOTALS: Final = ("template", "rule", "candidates")


def _count(table: pa.Table) -> Counter[tuple[str, str]]:
    """How many rows each sequence has of each template."""
    counts = table.group_by(["sequence", "template"]).aggregate([([], "count_all")]).to_pylist()
    return Counter({(row["sequence"], row["template"]): row["count_all"] for row in counts})


def _groups(tables: Iterable[pa.Table], at_once: int) -> Iterator[pa.Table]:
    """The same rows in tables of at least so many, but for the last."""
    pending: list[pa.Table] = []
    for table in tables:
        pending.append(table)
        if sum(map(len, pending)) >= at_once:
            yield pa.concat_tables(pending).combine_chunks()
            pending = []
    if any(map(len, pending)):
        yield pa.concat_tables(pending).combine_chunks()
