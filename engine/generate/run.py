"""Generation: search every sequence, select across them, publish the questions with their proofs."""

from __future__ import annotations

import contextlib
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.blind import blind_check, question_texts
from jrdb_avr.engine.generate.confirm import CONFIRMED, ConfirmJob, Fault, find_faults
from jrdb_avr.engine.generate.diagnostics import shortfalls, tallies
from jrdb_avr.engine.generate.found import (
    Found,
    Refusals,
    chosen_columns,
    chosen_rows,
    heads,
    scratch_folder,
    search_into,
    slim_pool,
)
from jrdb_avr.engine.generate.held_out import HeldOut, read_held_out
from jrdb_avr.engine.generate.keyframe_graph import ensure_layer
from jrdb_avr.engine.generate.publish import publish
from jrdb_avr.engine.generate.selection import TRAIN, Selection, select
from jrdb_avr.engine.generate.sequence import SequenceJob
from jrdb_avr.queries.display import Displayed, Progress, Tables, step_counter
from jrdb_avr.queries.files import file_hash, write_atomic
from jrdb_avr.queries.graph.handle import hold_graph
from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import Executor, map_sequences
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError
from jrdb_avr.schema.questions import DISJOINT_KEY, PROFILE_KEY
from jrdb_avr.schema.rules import Rules, rules_hash, training_rules
from jrdb_avr.schema.tables import CANDIDATES, QUESTIONS

Advance = Callable[[int], None]

REFUSALS_AT_ONCE: Final = 1 << 16
"""Rows of `rejected` in a row group: half a kilobyte each."""

HEADS_AT_ONCE: Final = 1 << 10
"""Rows of `sequences` in a row group: with the numbers of their frames they take some kilobytes each."""


@dataclass(frozen=True, repr=False)
class Generation(Displayed):
    """Result of a generation, as rows of counts. The questions are in the store.

    Attributes:
        templates: Candidates, refusals by rule and questions of each template.
        shortfalls: Reason for few questions of each template.
        selection: Requested and selected questions of each template.
        blind: Scores of blind guessers for each form of a template.
        faults: Selected candidates that the second program refused.
    """

    templates: tuple[dict[str, Any], ...]
    shortfalls: tuple[dict[str, Any], ...]
    selection: tuple[dict[str, Any], ...]
    blind: tuple[dict[str, Any], ...]
    faults: tuple[str, ...]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per template: counts, reason if few, requested number, and its rows of the blind check."""
        aims = {row["template"]: row["aim"] for row in self.selection}
        blind: dict[str, list[dict[str, Any]]] = {name: [] for name in aims}
        for row in self.blind:
            blind[row["template"]].append(row)
        return [
            {**row, **short, "aim": aims[row["template"]], "blind": blind[row["template"]]}
            for row, short in zip(self.templates, self.shortfalls, strict=True)
        ]

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
    workers: Executor = 2,
    n: int | None = None,
    disjoint_from: str | Path | None = None,
    candidates: Path | None = None,
    excluded: frozenset[str] = frozenset(),
    require_occlusion: bool = False,
    progress: Progress | None = None,
) -> Generation:
    """Generate the questions of a store.

    The result depends only on the tables of the store, the rules, the profile, the seed and the excluded questions. An
    AvrWarning gives the number of sequences without occlusion attributes.

    Args:
        store: The store, or its folder.
        rules: The rules; None for the defaults.
        profile: "all", as many questions as balance allows; "paper", the numbers of the paper; or "train", a training
            set under `training_rules`.
        seed: Seed that decides among equal selections.
        workers: Number of processes, or a Ray cluster.
        n: Maximum number of questions of a training set; None for all.
        disjoint_from: A store. No question of the training set needs a person of its questions at the same time.
        candidates: Parquet file to write with all proven candidates, before selection.
        excluded: Ids of questions to leave out. Other candidates take their places.
        require_occlusion: Whether to skip sequences without occlusion attributes.
        progress: Display of the progress.

    Returns:
        The counts of the generation. The questions are in the store.

    Raises:
        StoreError: Nothing is loaded, or the store was loaded under other rules.
        LockedError: Another process writes the store.
        InputError: An option needs another profile.
    """
    store, rules = Store.of(store), rules or Rules()
    held_out = _held_out(store, profile, n, disjoint_from)
    rules = training_rules(rules) if profile == TRAIN else rules
    check_load_rules(store, rules)
    # A first look reads the manifest only, so that a wrong store is refused before it is locked (and thereby made).
    with store.writing("generate"), scratch_folder(store) as scratch:
        manifest = check_load_rules(store, rules)
        check_intervals(store, manifest)
        sequences = _sequences(store, manifest, require_occlusion)
        parts = [scratch / f"{sequence}.parquet" if candidates else None for sequence in sequences]
        lows = ensure_layer(store, rules, workers, progress)
        jobs = [
            SequenceJob(store.path, name, lows[name], rules, part, tuple(held_out.extents.get(name, ())))
            for name, part in zip(sequences, parts, strict=True)
        ]
        advance = step_counter(progress, "searching", len(sequences))
        with hold_graph(store.graph_path, workers):
            found = _search(scratch, jobs, workers, advance)
        if candidates is not None:
            _gather([part for part in parts if part], candidates)
        pool = slim_pool(scratch, sequences)
        selection, faults = _select(
            scratch,
            pool,
            lambda pool: select(pool, rules, profile, seed, n),
            excluded,
            partial(_confirm, store.path, rules, scratch, workers, progress),
        )
        refusals = Refusals(scratch, sequences, pool, selection, faults)
        # The greatest part of what is in memory.
        del pool
        training = {PROFILE_KEY: TRAIN, DISJOINT_KEY: held_out.generation} if profile == TRAIN else None
        return _publish(store, scratch, found, selection, refusals, training)


def _held_out(store: Store, profile: str, n: int | None, disjoint_from: str | Path | None) -> HeldOut:
    """The questions to keep away from; none without a path."""
    if profile != TRAIN and (n is not None or disjoint_from is not None):
        raise InputError(f"a number of questions and held-out ones go with the profile {TRAIN!r}", field="profile")
    if n is not None and n < 1:
        raise InputError(f"{n} is no number of questions: give 1 or more", field="n")
    if disjoint_from is None:
        return HeldOut("", {})
    if Path(disjoint_from).resolve() == store.path.resolve():
        raise InputError(
            f"{store.path} holds the questions to keep away from, which new ones would replace: load the annotations "
            "into another store, and generate the training set there",
            field="disjoint_from",
        )
    return read_held_out(Path(disjoint_from))


def _sequences(store: Store, manifest: Manifest, require_occlusion: bool) -> list[str]:
    """The sequences to search. Raises StoreError where occlusion attributes are required and no sequence has them."""
    every, unclear = sorted(manifest.sequences), store.without_occlusion()
    if unclear:
        what = f"{len(unclear)} of {len(every)} sequences have no occlusion attributes"
        how = "there every box of legal size counts as a clear view, also one of somebody hidden"
        line = f"{what} and are skipped" if require_occlusion else f"{what}: {how}; --require-occlusion skips them"
        warnings.warn(line, AvrWarning, stacklevel=3)
    if not require_occlusion:
        return every
    if not (kept := [name for name in every if name not in unclear]):
        raise StoreError("no sequence has occlusion attributes: generate without --require-occlusion")
    return kept


def check_load_rules(store: Store, rules: Rules) -> Manifest:
    """The store's manifest. Raises StoreError where it was loaded under other load rules."""
    manifest = store.manifest()
    if manifest.load_rules_hash != rules_hash(rules.load):
        raise StoreError(
            f"{store.path} was loaded under other load rules: run 'jrdb-avr load --rebuild --store {store.path}' with "
            "the same --rule, or give them to generate as --rule load.NAME=VALUE"
        )
    return manifest


def check_intervals(store: Store, manifest: Manifest) -> None:
    """Raise StoreError where an interval file is not the one that was loaded."""
    for entry in manifest.sequences.values():
        for name, digest in entry.tables.items():
            path = store.path / name
            if name.startswith("intervals/") and (not path.is_file() or file_hash(path) != digest):
                raise StoreError(
                    f"{path} is not as it was loaded: run 'jrdb-avr load --verify --store {store.path}', which says "
                    "what else is damaged, then 'jrdb-avr load --rebuild' with the same --store"
                )


def _search(folder: Path, jobs: Sequence[SequenceJob], workers: Executor, advance: Advance) -> list[Found]:
    """Search every sequence into the folder; what each returns, in the order of the jobs."""
    results: dict[int, Found] = {}
    for index, result in map_sequences(partial(search_into, folder), jobs, workers, lambda job: job.weight):
        results[index] = result
        advance(1)
    return [results[index] for index in range(len(jobs))]


def _gather(parts: Sequence[Path], place: Path) -> None:
    """Join the sequences' candidate files, in order, into one."""

    def write(temporary: Path) -> None:
        with pq.ParquetWriter(temporary, CANDIDATES) as writer:
            for part in parts:
                with pq.ParquetFile(part) as file:
                    for batch in file.iter_batches():
                        writer.write_batch(batch)

    write_atomic(place, write)


def _select(
    folder: Path,
    pool: pa.Table,
    choose: Callable[[pa.Table], Selection],
    excluded: frozenset[str],
    confirm: Callable[[pa.Table], Mapping[str, Fault]],
) -> tuple[Selection, dict[str, Fault]]:
    """The selection, and the candidates that the second program refused, by key: these and excluded questions leave the
    pool, and the choice is made anew."""
    faults: dict[str, Fault] = {}
    confirmed: set[str] = set()
    while True:
        selection = choose(pool)
        gone: set[str] = set()
        if excluded:
            rows = chain.from_iterable(rows for _, rows in chosen_rows(folder, selection.table))
            gone = {row["key"] for row in rows if row["question_id"] in excluded}
        if not gone:
            added = _without(selection.table, confirmed)
            confirmed |= set(added["key"].to_pylist())
            found = confirm(added)
            faults |= found
            gone = set(found)
        if not gone:
            return selection, faults
        pool = _without(pool, gone)


def _without(rows: pa.Table, keys: Set[str]) -> pa.Table:
    """The rows of other keys."""
    return rows.filter(pc.invert(pc.is_in(rows["key"], value_set=pa.array(sorted(keys), pa.string()))))


def _confirm(
    store: Path, rules: Rules, folder: Path, workers: Executor, progress: Progress | None, chosen: pa.Table
) -> dict[str, Fault]:
    """The chosen candidates that the second program does not confirm, by key."""
    parts = chosen_columns(folder, chosen, CONFIRMED)
    jobs = [ConfirmJob(store, sequence, rules, rows) for sequence, rows in parts]
    advance = step_counter(progress, "confirming", len(jobs))
    faults: dict[str, Fault] = {}
    for _, found in map_sequences(find_faults, jobs, workers, lambda job: job.weight):
        faults |= found
        advance(1)
    return faults


def _publish(
    store: Store,
    folder: Path,
    found: Sequence[Found],
    selection: Selection,
    refusals: Refusals,
    training: Mapping[str, str] | None,
) -> Generation:
    sequences = [one.sequence for one in found]
    tables = {"rejected": refusals.groups(REFUSALS_AT_ONCE), "sequences": heads(folder, sequences, HEADS_AT_ONCE)}
    with contextlib.closing(
        publish(store, folder / "chosen", chosen_rows(folder, selection.table), tables, training)
    ) as chosen:
        known = chosen.by_template(["question_id", "answer"])
        blind = [row for texts in known for row in blind_check(question_texts(*texts))]
    counts = [
        {"kind": "count", "template": name, "rule": rule, "candidates": count}
        for (name, rule), count in refusals.totals.items()
    ]
    rows = tallies(pa.Table.from_pylist(counts, schema=QUESTIONS["rejected"]), selection.table)
    lacking = Counter((name, layer) for one in found for name, layers in one.lacking.items() for layer in layers)
    return Generation(
        templates=tuple(rows),
        shortfalls=tuple(shortfalls(rows, lacking, len(found), selection.report)),
        selection=selection.report,
        blind=tuple(blind),
        faults=tuple(sorted(map(str, refusals.faults.values()))),
    )
