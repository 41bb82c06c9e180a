"""Whether the question files hold what they promise: every check counted, every fault told with its question.

Reads the files of `questions/` and, for what they claim of the scene, the annotation tables. Where the proofs are to be
run again, the interval tables are searched and the graph is asked too.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.publish import GENERATION_KEY
from jrdb_avr.engine.rederive import Annotations
from jrdb_avr.engine.validate.compiled import ask_compiled
from jrdb_avr.engine.validate.outcomes import Validation
from jrdb_avr.engine.validate.question_checks import check_evidence, check_question
from jrdb_avr.engine.validate.replay import replay
from jrdb_avr.engine.validate.stored import stored_question
from jrdb_avr.queries.display import Progress, step_counter
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice, decode_answer
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.rules import Rules, rules_hash
from jrdb_avr.schema.tables import CANARY, QUESTIONS
from jrdb_avr.schema.wording import question_id

FILES: Final = ("questions", "sequences", "answers", "evidence", "rejected")


def validate(
    store: Store | str | Path,
    rules: Rules | None = None,
    *,
    replay_proofs: bool = False,
    workers: int = 2,
    progress: Progress | None = None,
) -> Validation:
    """Check a store's questions, and derive each answer again from the annotations.

    `replay_proofs`: also run every proof again, in `workers` processes, and every plan as Cypher on the graph. Raises
    StoreError for a missing file, and LockedError where the graph is in use.
    """
    store, rules = Store.of(store), rules or Rules()
    advance = step_counter(progress, "checking questions", store.questions("questions").num_rows)
    report = Validation()
    tables = {name: _read(store, name, report) for name in FILES}
    if any(table is None for table in tables.values()):
        return report
    marks = {(table.schema.metadata or {}).get(GENERATION_KEY.encode()) for table in tables.values() if table}
    report.check("files", len(marks) == 1, "the files are of different generations: generate again")
    questions, sequences, answers, evidence, _ = (table.to_pylist() for table in tables.values() if table is not None)
    hashes = {row["rules"] for row in answers}
    if hashes and rules_hash(rules) not in hashes:
        raise StoreError(f"{store.path} holds questions made under other rules: give the --rule options of generate")
    infos = {row["sequence"]: row for row in sequences}
    private = {row["question_id"]: row for row in answers}
    _check_ids(report, questions, answers, evidence)
    boxes: dict[str, dict[int, Box]] = defaultdict(dict)
    rows_of: Counter[str] = Counter()
    for row in evidence:
        boxes[row["question_id"]][row["frame"]] = Box(row["x"], row["y"], row["w"], row["h"])
        rows_of[row["question_id"]] += 1
    of_sequence: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in questions:
        of_sequence[row["sequence"]].append(row)
    for sequence in sorted(of_sequence):
        if not report.check("files", sequence in infos, f"sequences.parquet lacks {sequence}"):
            continue
        annotations = Annotations.read(store, sequence, rules)
        _check_sequence(report, infos[sequence], annotations)
        for row in of_sequence[sequence]:
            own = private.get(row["question_id"])
            if own is not None:
                known = boxes[row["question_id"]]
                check_question(report, row, own, infos[sequence], annotations, rules)
                check_evidence(report, row, own, known, rows_of[row["question_id"]], annotations)
            advance(1)
    _check_selection(report, questions, private, rules)
    # Without ids, files that cannot be read are the only fault.
    if replay_proofs and report.checked["ids"]:
        replayed = step_counter(progress, "running proofs again", 2 * len(questions))
        check_replay(report, store, rules, workers, replayed)
    return report


def check_replay(
    report: Validation, store: Store, rules: Rules, workers: int, advance: Callable[[int], None] = lambda steps: None
) -> None:
    """Add to the report what comes of running every proof again, and of the compiled plans; `advance` is told how many
    questions are done, of each twice as many as there are.

    Raises StoreError for a missing file, and LockedError while the graph is written.
    """
    private = {row["question_id"]: row for row in store.questions("answers").to_pylist()}
    questions = []
    for row in store.questions("questions").to_pylist():
        own = private.get(row["question_id"])
        try:
            questions.append(stored_question(row, own) if own is not None else None)
        except AvrError as error:
            report.check("replay", False, f"{row['question_id']}: {error}")
    known = [question for question in questions if question is not None]
    for name, differences in (
        ("replay", replay(store, known, rules, workers, advance)),
        ("compiled", ask_compiled(store, known, rules, advance)),
    ):
        report.checked[name] += len(known)
        report.faults[name] += [str(difference) for difference in differences]
        if not report.faults[name]:
            del report.faults[name]


# -- files --------------------------------------------------------------------------------------------------------


def _read(store: Store, name: str, report: Validation) -> pa.Table | None:
    """The table, or None where its file is not what it should be."""
    path = store.question_path(name)
    if not path.exists():
        raise StoreError(f"{path} is missing: run 'jrdb-avr generate --store {store.path}'")
    table = store.questions(name)
    wanted = QUESTIONS[name]
    same = report.check(
        "files",
        table.schema.remove_metadata().equals(wanted),
        f"{name}.parquet has columns {_columns(table.schema)}; expected {_columns(wanted)}",
    )
    metadata = {key: value for key, value in (pq.read_metadata(path).metadata or {}).items() if key != b"ARROW:schema"}
    keys = {b"canary", GENERATION_KEY.encode()}
    report.check("files", set(metadata) == keys, f"{name}.parquet has metadata {sorted(metadata)}")
    report.check("files", metadata.get(b"canary") == CANARY.encode(), f"{name}.parquet lacks the canary")
    try:
        table.validate(full=True)
    except pa.ArrowException as error:
        report.check("files", False, f"{name}.parquet: {str(error).splitlines()[0]}")
        return None
    nulls = [field.name for field in wanted if not field.nullable and same and table[field.name].null_count]
    report.check("files", not nulls, f"{name}.parquet has nulls in {', '.join(nulls)}")
    return table if same and not nulls else None


def _columns(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema)


def _check_ids(
    report: Validation, questions: list[dict[str, Any]], answers: list[dict[str, Any]], evidence: list[dict[str, Any]]
) -> None:
    for row in questions:
        public = (row[name] for name in ("sequence", "family", "template", "question", "choices", "answer_mode"))
        report.check("ids", question_id(*public) == row["question_id"], f"{row['question_id']}: id of other columns")
    asked = Counter(row["question_id"] for row in questions)
    answered = Counter(row["question_id"] for row in answers)
    shown = {row["question_id"] for row in evidence}
    for identifier in sorted(asked | answered | Counter(shown)):
        once = asked[identifier] == 1 and answered[identifier] == 1 and identifier in shown
        report.check(
            "ids",
            once,
            f"{identifier}: {asked[identifier]} times in questions, {answered[identifier]} in answers, "
            f"{'' if identifier in shown else 'not '}in evidence",
        )


def _check_sequence(report: Validation, info: dict[str, Any], annotations: Annotations) -> None:
    frames, name = info["frames"], info["sequence"]
    ordered = all(a < b for a, b in itertools.pairwise(frames))
    report.check("files", ordered, f"sequences.parquet: the frames of {name} are not ascending")
    images = annotations.layers.get("images") or annotations.layers.get("2d", [])
    report.check(
        "files", set(frames) == set(images), f"sequences.parquet: the frames of {name} are not those there are"
    )
    inside = bool(frames) and frames[-1] < info["frame_count"]
    report.check("files", inside, f"sequences.parquet: {name} has frames beyond its frame_count")


# -- all questions together ----------------------------------------------------------------------------------------


def _check_selection(
    report: Validation, questions: list[dict[str, Any]], private: dict[str, dict[str, Any]], rules: Rules
) -> None:
    persons: Counter[tuple[str, int, str]] = Counter()
    chosen: dict[str, Counter[str]] = defaultdict(Counter)
    for row in questions:
        own = private.get(row["question_id"])
        if own is None:
            continue
        persons[row["sequence"], own["target_track"], row["template"]] += 1
        if row["answer_mode"] == "multiple_choice":
            try:
                answer = decode_answer("multiple_choice", own["answer"])
            except AvrError:
                continue
            if isinstance(answer, Choice) and answer.choice <= len(row["choices"]):
                chosen[row["template"]][row["choices"][answer.choice - 1]] += 1
    for (sequence, track, template), count in sorted(persons.items()):
        few = count <= rules.max_per_person
        report.check("selection", few, f"{count} questions {template} of person {track} in {sequence}")
    for template, counts in sorted(chosen.items()):
        commonest, count = counts.most_common(1)[0]
        share = count / counts.total()
        report.check("selection", share <= rules.max_answer_share, f"{template}: {commonest!r} takes {share:.1%}")
