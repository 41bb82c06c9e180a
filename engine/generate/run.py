"""Generation: search every sequence, select across them, publish the questions with their proofs."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.blind import blind_check, question_texts
from jrdb_avr.engine.generate.confirm import CONFIRMED, ConfirmJob, Fault, find_faults, split_chosen
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.diagnostics import EXAMPLES, dropped_rows, refusal_rows, shortfalls, tallies
from jrdb_avr.engine.generate.held_out import Extent, HeldOut, read_held_out
from jrdb_avr.engine.generate.learned import learned_guesser
from jrdb_avr.engine.generate.pool import Prover, Refused, fill_pool
from jrdb_avr.engine.generate.propose import Search
from jrdb_avr.engine.generate.publish import Chosen, publish
from jrdb_avr.engine.generate.question import make_row
from jrdb_avr.engine.generate.selection import POOL, TRAIN, Selection, select, with_choices
from jrdb_avr.engine.generate.stored_layer import LayerJob, ensure_layer
from jrdb_avr.queries.display import Displayed, Progress, Tables, step_counter
from jrdb_avr.queries.files import file_hash
from jrdb_avr.queries.graph.handle import hold_graph, open_worker_graph
from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import Executor, map_sequences, without_collector
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError
from jrdb_avr.schema.plan import canonical
from jrdb_avr.schema.questions import DISJOINT_KEY, PROFILE_KEY
from jrdb_avr.schema.rules import Rules, rules_hash, training_rules
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import FORMS

SELECTED_BY: Final = [
    *("sequence", "family", "template", "target_track", "key", "form"),
    *("answer_text", "stated", "times", "read_frames", "event", "sets"),
]
"""Columns of the pool that selection reads."""


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
    excluded: frozenset[str] = frozenset(),
    require_occlusion: bool = False,
    learned: bool = False,
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
        excluded: Ids of questions to leave out. Other candidates take their places.
        require_occlusion: Whether to skip sequences without occlusion attributes.
        learned: Whether the blind check includes the guesser that learns from texts.
        progress: Display of the progress.

    Returns:
        The counts of the generation. The questions are in the store.

    Raises:
        StoreError: Nothing is loaded, or the store was loaded under other rules.
        LockedError: Another process writes the store.
        InputError: scikit-learn is missing, or an option needs another profile.
    """
    store, rules = Store.of(store), rules or Rules()
    held_out = _held_out(store, profile, n, disjoint_from)
    rules = training_rules(rules) if profile == TRAIN else rules
    guesser = learned_guesser() if learned else None
    check_load_rules(store, rules)
    # The manifest is checked first, so that a wrong store is refused before it is locked and thereby made.
    with store.writing("generate"):
        manifest = check_load_rules(store, rules)
        check_intervals(store, manifest)
        sequences = _sequences(store, manifest, require_occlusion)
        lows = ensure_layer(store, rules, workers, progress)
        jobs = [
            SearchJob(store.path, name, lows[name], rules, tuple(held_out.extents.get(name, ()))) for name in sequences
        ]
        with hold_graph(store.graph_path, workers):
            found = _search(jobs, workers, step_counter(progress, "searching", len(jobs)))
            pool = pa.concat_tables([one.pool for one in found])
            slim = pool.select(SELECTED_BY).append_column("row", pa.array(range(len(pool)), pa.int64()))
            selection, faults = _select(
                pool,
                slim,
                lambda slim: select(slim, rules, profile, seed, n),
                excluded,
                partial(_confirm, store.path, rules, pool, workers, progress),
            )
        rows = [row for one in found for row in one.refused]
        rows += dropped_rows(pool, selection.table, {key: fault.difference for key, fault in faults.items()})
        rejected = pa.Table.from_pylist(rows, schema=QUESTIONS["rejected"])
        order = ("kind", "sequence", "template", "rule", "plan")
        tables = {
            "rejected": rejected.sort_by([(name, "ascending") for name in order]),
            "sequences": pa.Table.from_pylist([one.head for one in found], schema=QUESTIONS["sequences"]),
        }
        chosen = Chosen(pool, selection.table)
        training = {PROFILE_KEY: TRAIN, DISJOINT_KEY: held_out.generation} if profile == TRAIN else None
        publish(store, chosen, tables, training)
    counts = tallies(rejected, selection.table)
    lacking = Counter((name, layer) for one in found for name, layers in one.lacking.items() for layer in layers)
    texts = chosen.by_template(["question_id", "answer"])
    return Generation(
        templates=tuple(counts),
        shortfalls=tuple(shortfalls(counts, lacking, len(found), selection.report)),
        selection=selection.report,
        blind=tuple(row for some in texts for row in blind_check(question_texts(*some), guesser)),
        faults=tuple(sorted(map(str, faults.values()))),
    )


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
        how = "there boxes decide who is in clear view, so needed people may be hidden"
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


# -- search -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SearchJob(LayerJob):
    """A sequence to search.

    Attributes:
        held_out: Extents of held-out questions.
    """

    held_out: tuple[Extent, ...] = ()


class Found(NamedTuple):
    """Result of the search of one sequence.

    Attributes:
        head: Row of the table `sequences`.
        pool: Proven candidates without near-duplicates, in the columns of `selection.POOL`.
        refused: Rows of the table `rejected`.
        lacking: Missing layers of each template that was not searched.
    """

    head: dict[str, Any]
    pool: pa.Table
    refused: list[dict[str, Any]]
    lacking: dict[str, tuple[str, ...]]


@without_collector()
def search_sequence(job: SearchJob) -> Found:
    """Find and prove the candidates of one sequence.

    The result depends only on the tables and the graph of the sequence, the rules and the held-out questions. So
    sequences can be shared among processes or machines.

    Args:
        job: Sequence.

    Returns:
        The candidates.

    Raises:
        StoreError: If a table or the graph is missing.
    """
    store = Store(job.store)
    (head,) = store.interval("sequence", job.sequence).to_pylist()
    frames = store.interval("frames", job.sequence).sort_by("frame")
    frames = frames.filter(frames["image" if "images" in head["layers"] else "annotated"])["frame"].to_pylist()
    own = {"sequence": job.sequence, "fps": head["fps"], "frame_count": head["frame_count"], "frames": frames}
    rows: list[dict[str, Any]] = []
    refused: list[dict[str, Any]] = []
    lacking: dict[str, tuple[str, ...]] = {}
    with open_worker_graph(store.graph_path) as graph:
        search = Search(graph, job.sequence, job.layer(graph), job.rules)
        cypher = CypherFacts(graph, job.rules.load)
        for name, forms in FORMS.items():
            missing = [tuple(layer for layer in form.layers if layer not in head["layers"]) for form in forms]
            if least := min(missing, key=len):
                lacking[name] = least
                continue
            allowed = [form for form, layers in zip(forms, missing, strict=True) if not layers]
            prover = Prover(search, cypher, job.held_out)
            for proposal, proofs in fill_pool(search, allowed, prover):
                if row := make_row(search, proposal, proofs):
                    rows.append(row)
                else:
                    prover.refused.append(Refused(proposal, "choices"))
            refused += _refusals(job.sequence, name, prover)
    return Found(own, pa.Table.from_pylist(rows, schema=POOL), refused, lacking)


def _refusals(sequence: str, template: str, prover: Prover) -> list[dict[str, Any]]:
    by_rule: dict[str, list[Refused]] = {}
    for one in sorted(prover.refused, key=lambda one: one.proposal.key):
        by_rule.setdefault(one.rule, []).append(one)
    rows: list[dict[str, Any]] = []
    for rule, some in by_rule.items():
        examples = [(one.proposal.target, canonical(one.proposal.plan), one.detail) for one in some[:EXAMPLES]]
        rows += refusal_rows(sequence, template, rule, len(some), examples)
    for rule, count in prover.untried.items():
        rows += refusal_rows(sequence, template, rule, count)
    return rows


def _search(jobs: Sequence[SearchJob], workers: Executor, advance: Callable[[int], None]) -> list[Found]:
    """Search every sequence; return the results in the order of the jobs."""
    results: dict[int, Found] = {}
    for index, result in map_sequences(search_sequence, jobs, workers, lambda job: job.weight):
        results[index] = result
        advance(1)
    return [results[index] for index in range(len(jobs))]


# -- choice -----------------------------------------------------------------------------------------------------------


def _select(
    pool: pa.Table,
    slim: pa.Table,
    choose: Callable[[pa.Table], Selection],
    excluded: frozenset[str],
    confirm: Callable[[pa.Table], Mapping[str, Fault]],
) -> tuple[Selection, dict[str, Fault]]:
    """Choose until all that is chosen is confirmed and not excluded. Return the choice, and the faults by key."""
    faults: dict[str, Fault] = {}
    confirmed: set[str] = set()
    while True:
        selection = choose(slim)
        gone: set[str] = set()
        if excluded:
            gone = {row["key"] for row in with_choices(pool, selection.table) if row["question_id"] in excluded}
        if not gone:
            added = _without(selection.table, confirmed)
            confirmed |= set(added["key"].to_pylist())
            found = confirm(added)
            faults |= found
            gone = set(found)
        if not gone:
            return selection, faults
        slim = _without(slim, gone)


def _without(rows: pa.Table, keys: Set[str]) -> pa.Table:
    """Return the rows of other keys."""
    return rows.filter(pc.invert(pc.is_in(rows["key"], value_set=pa.array(sorted(keys), pa.string()))))


def _confirm(
    store: Path, rules: Rules, pool: pa.Table, workers: Executor, progress: Progress | None, chosen: pa.Table
) -> dict[str, Fault]:
    """Return the chosen candidates that are not confirmed, by key."""
    rows = pool.select(CONFIRMED).take(chosen["row"])
    jobs = [ConfirmJob(store, rules, part) for part in split_chosen(rows)]
    advance = step_counter(progress, "confirming", len(jobs))
    faults: dict[str, Fault] = {}
    for _, found in map_sequences(find_faults, jobs, workers, lambda job: len(job.chosen)):
        faults |= found
        advance(1)
    return faults
