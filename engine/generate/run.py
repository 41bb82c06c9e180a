"""Generation: search every sequence, select across them, publish the questions with their proofs."""

from __future__ import annotations

import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.engine.generate.asked import Candidate, Question
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.diagnostics import tallies
from jrdb_avr.engine.generate.guessers import LabelCounts
from jrdb_avr.engine.generate.held_out import Extent, read_held_out
from jrdb_avr.engine.generate.layer import TableRow
from jrdb_avr.engine.generate.lite import thin
from jrdb_avr.engine.generate.pool import Prover, fill_pool
from jrdb_avr.engine.generate.publish import publish
from jrdb_avr.engine.generate.question import COLUMNS, make_questions
from jrdb_avr.engine.generate.selection import TRAIN, pool_limits, select
from jrdb_avr.engine.generate.stored_layer import Job, ensure_layer
from jrdb_avr.engine.report.truth import refuse_imported
from jrdb_avr.queries.display import Displayed, Progress, Tables, step_counter
from jrdb_avr.queries.files import file_hash
from jrdb_avr.queries.graph.handle import hold_graph, open_worker_graph
from jrdb_avr.queries.manifest import Manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import Executor, map_in_order, without_collector
from jrdb_avr.schema.errors import InputError, StoreError, warn
from jrdb_avr.schema.questions import DISJOINT_KEY, PROFILE_KEY
from jrdb_avr.schema.rules import Rules, rules_hash, training_rules
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import FAMILIES, FORMS


@dataclass(frozen=True, repr=False)
class Generation(Displayed):
    """Result of a generation, as rows of counts. The questions are in the store.

    Attributes:
        templates: Candidates, refusals by rule, questions and the reason for few questions of each template.
        selection: Quota, proven candidates, questions, time twins and guessers of each template.
        faults: Selected candidates that the second program refused.
    """

    templates: tuple[dict[str, Any], ...]
    selection: tuple[dict[str, Any], ...]
    faults: tuple[str, ...]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per template: counts, reason if few, and the selection."""
        return [{**row, **selected} for row, selected in zip(self.templates, self.selection, strict=True)]

    def _summary(self) -> str:
        questions = sum(row["reached"] for row in self.selection)
        return f"{questions} questions of {len(self.selection)} templates, {len(self.faults)} faults"

    def _tables(self) -> Tables:
        return {"Candidates, refusals by rule, and questions": self.templates}


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
        profile: "all", as many questions as near-duplicates and caps allow; "paper", the numbers of the paper;
            "lite", 240 of the questions of "paper"; or "train", a training set under `training_rules`.
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
    refuse_imported(store, "load the annotations into another store, and generate there")
    held_out, extents = _held_out(store, profile, n, disjoint_from)
    rules = training_rules(rules) if profile == TRAIN else rules
    check_load_rules(store, rules)
    # The manifest is checked first, so that a wrong store is refused before it is locked and thereby made.
    with store.writing("generate"):
        manifest = check_load_rules(store, rules)
        check_intervals(store, manifest)
        layers = {name: manifest.sequences[name].layers for name in _sequences(store, manifest, require_occlusion)}
        jobs = [
            replace(job, held_out=tuple(extents.get(job.sequence, ())), limits=pool_limits(profile, len(layers)))
            for job in ensure_layer(store, rules, workers, progress)
            if job.sequence in layers
        ]
        with hold_graph(store.graph_path, workers):
            advance = step_counter(progress, "searching", len(jobs))
            found = map_in_order(search_sequence, jobs, workers, Job.weigh, advance)
            counts = LabelCounts({(one.head["sequence"], at): some for one in found for at, some in one.counts.items()})
            questions, report, left, faults = _choose(
                [candidate for one in found for candidate in _CANDIDATES.decode(one.pool)],
                lambda pool: select(pool, counts, rules, profile, n),
                partial(_make, jobs, workers, progress),
                excluded,
            )
            if profile == "lite":
                questions, report = thin(questions, report, left)
        rows = [row for one in found for row in one.refused]
        rows += [_refusal(*rule, count) for rule, count in left.items()]
        order = [(name, "ascending") for name in ("sequence", "template", "rule")]
        rejected = pa.Table.from_pylist(rows, schema=QUESTIONS["rejected"]).sort_by(order)
        heads = pa.Table.from_pylist([one.head for one in found], schema=QUESTIONS["sequences"])
        training = {PROFILE_KEY: TRAIN, DISJOINT_KEY: held_out} if profile == TRAIN else None
        publish(store, questions, {"rejected": rejected, "sequences": heads}, training)
    return Generation(tuple(tallies(rejected, questions, layers, report)), tuple(report), tuple(faults))


def _held_out(
    store: Store, profile: str, n: int | None, disjoint_from: str | Path | None
) -> tuple[str, Mapping[str, Sequence[Extent]]]:
    """Return the generation and the extents of the held-out questions, or none without a path."""
    if profile != TRAIN and (n is not None or disjoint_from is not None):
        raise InputError(f"a number of questions and held-out ones go with the profile {TRAIN!r}", field="profile")
    if n is not None and n < 1:
        raise InputError(f"{n} is no number of questions: give 1 or more", field="n")
    if disjoint_from is None:
        return "", {}
    if Path(disjoint_from).resolve() == store.path.resolve():
        raise InputError(
            f"{store.path} holds the questions to keep away from, which new ones would replace: load the annotations "
            "into another store, and generate the training set there",
            field="disjoint_from",
        )
    return read_held_out(Path(disjoint_from))


def _sequences(store: Store, manifest: Manifest, require_occlusion: bool) -> list[str]:
    """Return the sequences to search. Raise StoreError if all of them lack occlusion attributes that are required."""
    unclear = store.without_occlusion()
    if unclear:
        what = f"{len(unclear)} of {len(manifest.sequences)} sequences have no occlusion attributes"
        how = "there boxes decide who is in clear view, so needed people may be hidden"
        line = f"{what} and are skipped" if require_occlusion else f"{what}: {how}; --require-occlusion skips them"
        warn(line)
    if require_occlusion and len(unclear) == len(manifest.sequences):
        raise StoreError("no sequence has occlusion attributes: generate without --require-occlusion")
    return sorted(manifest.sequences.keys() - set(unclear if require_occlusion else ()))


def check_load_rules(store: Store, rules: Rules) -> Manifest:
    """Return the manifest of a store.

    Args:
        store: Store.
        rules: Rules of the generation.

    Returns:
        The manifest.

    Raises:
        StoreError: If the store was loaded under other load rules.
    """
    manifest = store.manifest()
    if manifest.load_rules_hash != rules_hash(rules.load):
        raise StoreError(
            f"{store.path} was loaded under other load rules: run 'jrdb-avr load --rebuild --store {store.path}' with "
            "the same --rule, or give them to generate as --rule load.NAME=VALUE"
        )
    return manifest


def check_intervals(store: Store, manifest: Manifest) -> None:
    """Check that the interval files are unchanged since they were loaded.

    Args:
        store: Store.
        manifest: Manifest of the store.

    Raises:
        StoreError: If an interval file is missing or was changed.
    """
    for entry in manifest.sequences.values():
        for name, digest in entry.tables.items():
            path = store.path / name
            if name.startswith("intervals/") and (not path.is_file() or file_hash(path) != digest):
                raise StoreError(
                    f"{path} is not as it was loaded: run 'jrdb-avr load --verify --store {store.path}', which says "
                    "what else is damaged, then 'jrdb-avr load --rebuild' with the same --store"
                )


# -- search -----------------------------------------------------------------------------------------------------------


_CANDIDATES: Final = msgspec.msgpack.Decoder(list[Candidate])


class Found(NamedTuple):
    """Result of the search of one sequence.

    Attributes:
        head: Row of the table `sequences`.
        pool: Proven candidates, encoded.
        counts: Number of people in clear view who certainly do each action, by keyframe.
        refused: Rows of the table `rejected`.
    """

    head: TableRow
    pool: bytes
    counts: dict[int, Counter[str]]
    refused: list[TableRow]


@without_collector()
def search_sequence(job: Job) -> Found:
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
    pool, refused = [], list[TableRow]()
    with open_worker_graph(Store(job.store).graph_path) as graph:
        layer, limits = job.layer(graph), dict(job.limits)
        cypher = CypherFacts(graph, job.rules.load, layer.facts)
        for name, forms in FORMS.items():
            allowed = [form for form in forms if set(form.layers).issubset(layer.head["layers"])]
            prover = Prover(layer, cypher, job.held_out)
            pool += fill_pool(layer, allowed, prover, limits.get(name, sys.maxsize)) if allowed else []
            refused += [_refusal(job.sequence, name, rule, count) for rule, count in prover.counts.items()]
    head = {name: layer.head[name] for name in ("sequence", "fps", "frame_count")} | {"frames": layer.frames}
    return Found(head, msgspec.msgpack.encode(pool), layer.facts.counts, refused)


def _refusal(sequence: str, template: str, rule: str, count: int) -> TableRow:
    """Return the row of the table `rejected` for one rule."""
    return {"sequence": sequence, "family": FAMILIES[template], "template": template, "rule": rule, "candidates": count}


# -- choice -----------------------------------------------------------------------------------------------------------


def _choose(
    candidates: Sequence[Candidate],
    choose: Callable[[Mapping[str, Sequence[Candidate]]], tuple[list[Question], list[TableRow]]],
    make: Callable[[Sequence[Question]], tuple[pa.Table, dict[str, str]]],
    excluded: Collection[str],
) -> tuple[pa.Table, list[TableRow], Counter[tuple[str, str, str]], list[str]]:
    """Select until all questions are confirmed and none is excluded.

    Returns the questions, the row of each template, the number of other candidates by sequence, template and rule, and
    a line per candidate that is not confirmed.
    """
    made, gone = COLUMNS.empty_table(), dict[Candidate, str]()
    while True:
        pool: dict[str, list[Candidate]] = defaultdict(list)
        for candidate in candidates:
            if candidate not in gone:
                pool[candidate.template].append(candidate)
        selected, report = choose(pool)
        questions = {question.key: question for question in selected}
        table, faults = make([questions[key] for key in sorted(questions.keys() - set(made["key"].to_pylist()))])
        made = pa.concat_tables([made, table])
        unwanted = table.filter(pc.is_in(table["question_id"], pa.array(sorted(excluded), pa.string())))
        new = dict.fromkeys(unwanted["key"].to_pylist(), "") | faults
        if not new:
            break
        gone |= {questions[key].candidate: fault for key, fault in new.items()}
    unused = set(candidates).difference(question.candidate for question in selected)
    left = Counter((one.sequence, one.template, "unconfirmed" if gone.get(one) else "selection") for one in unused)
    made = made.filter(pc.is_in(made["key"], pa.array(sorted(questions), pa.string())))
    return made.sort_by("question_id"), report, left, sorted(filter(None, gone.values()))


def _make(
    jobs: Sequence[Job], workers: Executor, progress: Progress | None, questions: Sequence[Question]
) -> tuple[pa.Table, dict[str, str]]:
    """Make selected questions; return them, and the faults by key."""
    by_sequence: dict[str, list[Question]] = defaultdict(list)
    for question in questions:
        by_sequence[question.candidate.sequence].append(question)
    own = [replace(job, questions=tuple(by_sequence[job.sequence])) for job in jobs if job.sequence in by_sequence]
    advance = step_counter(progress, "confirming", len(own))
    results = map_in_order(make_questions, own, workers, Job.weigh, advance)
    faults = {key: fault for _, refused in results for key, fault in refused.items()}
    return pa.concat_tables([COLUMNS.empty_table(), *(table for table, _ in results)]), faults
