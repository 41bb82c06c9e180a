"""Generation: search every sequence, select across them, publish the questions with their proofs."""

from __future__ import annotations

import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.asked import Candidate, Question
from jrdb_avr.engine.generate.blind import blind_check, question_texts
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.diagnostics import refusal_rows, shortfalls, tallies
from jrdb_avr.engine.generate.guessers import LabelCounts
from jrdb_avr.engine.generate.held_out import Extent, HeldOut, read_held_out
from jrdb_avr.engine.generate.layer import TableRow, count_actions
from jrdb_avr.engine.generate.pool import Prover, fill_pool
from jrdb_avr.engine.generate.propose import Search
from jrdb_avr.engine.generate.publish import publish, question_tables
from jrdb_avr.engine.generate.question import COLUMNS, Chosen, Fault, QuestionJob, key_of, make_questions
from jrdb_avr.engine.generate.selection import TRAIN, select
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

Advance = Callable[[int], None]


@dataclass(frozen=True, repr=False)
class Generation(Displayed):
    """Result of a generation, as rows of counts. The questions are in the store.

    Attributes:
        templates: Candidates, refusals by rule and questions of each template.
        shortfalls: Reason for few questions of each template.
        selection: Quota, proven candidates, questions, time twins and guessers of each template.
        blind: Scores of blind guessers for each form of a template.
        faults: Selected candidates that the second program refused.
    """

    templates: tuple[dict[str, Any], ...]
    shortfalls: tuple[dict[str, Any], ...]
    selection: tuple[dict[str, Any], ...]
    blind: tuple[dict[str, Any], ...]
    faults: tuple[str, ...]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per template: counts, reason if few, the selection, and its rows of the blind check."""
        blind: dict[str, list[dict[str, Any]]] = {row["template"]: [] for row in self.templates}
        for row in self.blind:
            blind[row["template"]].append(row)
        return [
            {**row, **short, **selected, "blind": blind[row["template"]]}
            for row, short, selected in zip(self.templates, self.shortfalls, self.selection, strict=True)
        ]

    def _summary(self) -> str:
        questions = sum(row["reached"] for row in self.selection)
        return f"{questions} questions of {len(self.selection)} templates, {len(self.faults)} faults"

    def _tables(self) -> Tables:
        return {"Candidates, refusals by rule, and questions": self.templates, "Blind guessers": self.blind}


def generate(
    store: Store | str | Path,
    rules: Rules | None = None,
    *,
    profile: str = "all",
    workers: Executor = 2,
    n: int | None = None,
    disjoint_from: str | Path | None = None,
    excluded: frozenset[str] = frozenset(),
    require_occlusion: bool = False,
    progress: Progress | None = None,
) -> Generation:
    """Generate the questions of a store.

    The result depends only on the tables of the store, the rules, the profile and the excluded questions. An AvrWarning
    gives the number of sequences without occlusion attributes.

    Args:
        store: The store, or its folder.
        rules: The rules; None for the defaults.
        profile: "all", as many questions as near-duplicates and caps allow; "paper", the numbers of the paper; or
            "train", a training set under `training_rules`.
        workers: Number of processes, or a Ray cluster.
        n: Maximum number of questions of a training set; None for all.
        disjoint_from: A store. No question of the training set needs a person of its questions at the same time.
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
            counts = LabelCounts({(one.head["sequence"], at): some for one in found for at, some in one.counts.items()})
            selected = _choose(
                [entry for one in found for entry in _ENTRIES.decode(one.pool)],
                lambda pool: select(pool, counts, rules, profile, n),
                partial(_make, jobs, workers, progress),
                excluded,
            )
        rows = [*(row for one in found for row in one.refused), *_left_out(selected)]
        order = [(name, "ascending") for name in ("kind", "sequence", "template", "rule", "plan")]
        rejected = pa.Table.from_pylist(rows, schema=QUESTIONS["rejected"]).sort_by(order)
        heads = pa.Table.from_pylist([one.head for one in found], schema=QUESTIONS["sequences"])
        training = {PROFILE_KEY: TRAIN, DISJOINT_KEY: held_out.generation} if profile == TRAIN else None
        tables = question_tables(store, selected.questions) | {"rejected": [rejected], "sequences": [heads]}
        publish(store, tables, training)
    templates = tallies(rejected, selected.questions)
    lacking = Counter((name, layer) for one in found for name, layers in one.lacking.items() for layer in layers)
    blind = []
    for name in sorted(set(selected.questions["template"].to_pylist())):
        own = selected.questions.filter(pc.equal(selected.questions["template"], name))
        blind += blind_check(question_texts(own, own))
    return Generation(
        templates=tuple(templates),
        shortfalls=tuple(shortfalls(templates, lacking, len(found), selected.report)),
        selection=tuple(selected.report),
        blind=tuple(blind),
        faults=tuple(sorted(map(str, selected.faults.values()))),
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


class _Entry(NamedTuple):
    """A candidate of the pool, with the form and the encoded row that make its proposal again."""

    candidate: Candidate
    form: str
    row: msgspec.Raw


_ENTRIES: Final = msgspec.msgpack.Decoder(list[_Entry])


class Found(NamedTuple):
    """Result of the search of one sequence.

    Attributes:
        head: TableRow of the table `sequences`.
        pool: Proven candidates, encoded as a list of `_Entry`.
        counts: Number of people in clear view who certainly do each action, by keyframe.
        refused: Rows of the table `rejected`.
        lacking: Missing layers of each template that was not searched.
    """

    head: TableRow
    pool: bytes
    counts: dict[int, Counter[str]]
    refused: list[TableRow]
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
    pool, refused, lacking = [], list[TableRow](), {}
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
            pool += fill_pool(search, allowed, prover)
            refused += _refusals(job.sequence, name, prover)
    return Found(own, msgspec.msgpack.encode(pool), count_actions(search.layer.facts), refused, lacking)


def _refusals(sequence: str, template: str, prover: Prover) -> list[TableRow]:
    rows: list[TableRow] = []
    for rule, count in prover.counts.items():
        examples = [(one.target, canonical(one.plan), detail) for one, detail in prover.examples[rule]]
        rows += refusal_rows(sequence, template, rule, count, examples)
    return rows


def _search(jobs: Sequence[SearchJob], workers: Executor, advance: Callable[[int], None]) -> list[Found]:
    """Search every sequence; return the results in the order of the jobs."""
    results: dict[int, Found] = {}
    for index, result in map_sequences(search_sequence, jobs, workers, lambda job: job.weight):
        results[index] = result
        advance(1)
    return [results[index] for index in range(len(jobs))]


# -- choice -----------------------------------------------------------------------------------------------------------


class Confirmed(NamedTuple):
    """Result of the selection.

    Attributes:
        questions: The questions in the columns of `question.COLUMNS`.
        report: TableRow of each template, as `select` returns it.
        left: Number of proven candidates that are not selected, by sequence, template and rule.
        faults: Candidates that are not confirmed, by template and key.
    """

    questions: pa.Table
    report: list[TableRow]
    left: Counter[tuple[str, str, str]]
    faults: dict[tuple[str, str], Fault]


def _choose(
    entries: Iterable[_Entry],
    choose: Callable[[Mapping[str, Sequence[Candidate]]], tuple[list[Question], list[TableRow]]],
    make: Callable[[Sequence[Chosen]], tuple[pa.Table, dict[str, Fault]]],
    excluded: Collection[str],
) -> Confirmed:
    """Select until all questions are confirmed and none is excluded."""
    pool = {(entry.candidate.template, entry.candidate.key): entry for entry in entries}
    made = COLUMNS.empty_table()
    faults: dict[tuple[str, str], Fault] = {}
    gone: set[tuple[str, str]] = set()
    while True:
        candidates: dict[str, list[Candidate]] = defaultdict(list)
        for name, entry in pool.items():
            if name not in gone:
                candidates[name[0]].append(entry.candidate)
        selected, report = choose(candidates)
        questions = {key_of(one): one for one in selected}
        names = {key: (one.candidate.template, one.candidate.key) for key, one in questions.items()}
        new = sorted(questions.keys() - set(made["key"].to_pylist()))
        table, found = make([_chosen(questions[key], pool[names[key]]) for key in new])
        refused = set(found)
        if excluded:
            refused |= {row["key"] for row in table.to_pylist() if row["question_id"] in excluded}
        made = pa.concat_tables([made, table])
        if not refused:
            break
        gone |= {names[key] for key in refused}
        faults |= {names[key]: fault for key, fault in found.items()}
    left: Counter[tuple[str, str, str]] = Counter()
    for name in pool.keys() - set(names.values()):
        left[pool[name].candidate.sequence, name[0], "unconfirmed" if name in faults else "selection"] += 1
    made = made.filter(pc.is_in(made["key"], value_set=pa.array(sorted(questions), pa.string())))
    return Confirmed(made.sort_by("question_id"), report, left, faults)


def _chosen(question: Question, entry: _Entry) -> Chosen:
    return Chosen(question, entry.form, msgspec.msgpack.decode(entry.row))


def _left_out(selected: Confirmed) -> Iterator[TableRow]:
    """Yield the rows of the table `rejected` for proven candidates that are not selected."""
    for place, count in sorted(selected.left.items()):
        yield from refusal_rows(*place, count)


def _make(
    jobs: Sequence[SearchJob], workers: Executor, progress: Progress | None, chosen: Sequence[Chosen]
) -> tuple[pa.Table, dict[str, Fault]]:
    """Make selected questions; return them, and the faults by key."""
    by_sequence: dict[str, list[Chosen]] = defaultdict(list)
    for one in chosen:
        by_sequence[one.question.candidate.sequence].append(one)
    question_jobs = [
        QuestionJob(job.store, job.sequence, job.low, job.rules, tuple(by_sequence[job.sequence]))
        for job in jobs
        if job.sequence in by_sequence
    ]
    advance = step_counter(progress, "confirming", len(question_jobs))
    tables, faults = [COLUMNS.empty_table()], dict[str, Fault]()
    for _, (table, found) in map_sequences(make_questions, question_jobs, workers, lambda job: job.weight):
        tables.append(table)
        faults |= found
        advance(1)
    return pa.concat_tables(tables), faults
