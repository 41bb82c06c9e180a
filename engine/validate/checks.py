"""Check a benchmark: its files, every question by itself, and all of them together.

A question is checked against the annotation tables, and its answer and proofs are derived again by the second program.
On request generation's own proofs and the compiled plan run again too (`replay`).
"""

from __future__ import annotations

import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.distractors import CHOICE_COUNT
from jrdb_avr.engine.generate.near_duplicates import near_frames
from jrdb_avr.engine.generate.proofs import expected, failing
from jrdb_avr.engine.generate.run import check_intervals
from jrdb_avr.engine.rederive import Annotations, prove_again, rederive
from jrdb_avr.engine.validate.replay import differences, replay, run_compiled
from jrdb_avr.queries.display import Displayed, Progress, Tables, step_counter
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.queries.workers import Executor
from jrdb_avr.schema.answer_modes import MODES, decode_answer, frames_of_answer
from jrdb_avr.schema.answers import Answer, Choice, Number
from jrdb_avr.schema.errors import AvrError, DecodeError, StoreError
from jrdb_avr.schema.labels import answer_of_choice, overlapping
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan, canonical, parse_plan
from jrdb_avr.schema.questions import DISJOINT_KEY, PROFILE_KEY, QuestionRecord
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, rules_hash, training_rules
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS
from jrdb_avr.schema.templates import forms_of
from jrdb_avr.schema.wording.text import parse, question_id, question_key, render

CHECKS: Final = {
    "files": "the schema and the canary are right; public files hold nothing private",
    "ids": "each question appears once in each file; its id is the hash of its public columns",
    "choices": "a choice question has four different choices, of which no two overlap; others have none",
    "answers": "the stored answer is readable and lies within the sequence",
    "plans": "the plan is valid and belongs to the question's template",
    "text": "the text states the plan and nothing else; stated seconds are frame / fps",
    "evidence": "the evidence is every box of the target and nothing else",
    "proofs": "every required proof is present and holds; distractors and bindings fit",
    "rules": "generation used the same rules",
    "selection": "shares of answers and questions per person obey the rules; no two questions are alike",
    "rederive": "the second program finds the same person, answer, needed boxes and outcome of every proof",
}
"""Checks of stored questions: name and the statement that is tested, in the order of the report."""

REPLAY_CHECKS: Final = {
    "replay": "every proof, run again from the stored plan, gives the stored result",
    "compiled": "the plan, compiled to Cypher, finds the stored people and answer in the graph",
}
"""Further checks of `--replay`: name and the statement that is tested."""

_FILES: Final = ("questions", "sequences", "answers", "evidence", "rejected")
_OTHER_GENERATION: Final = "the files are of different generations: generate again"
_STATED: Final = re.compile(r"(\S+) s \(frame (\d+)\)")
"""A stated time in a question's text: its seconds and its frame."""


class Validation(Displayed):
    """Result of a validation: the number of checks by kind, and the faults in the order of discovery."""

    def __init__(self) -> None:
        self.checked: Counter[str] = Counter()
        self.faults: dict[str, list[str]] = defaultdict(list)

    def check(self, name: str, holds: bool, fault: str) -> bool:
        """Count one check, and record the fault if the check fails."""
        self.add(name, 1, [] if holds else [fault])
        return holds

    def add(self, name: str, count: int, faults: Iterable[object]) -> None:
        """Count several checks, and record their faults."""
        self.checked[name] += count
        for fault in faults:
            self.faults[name].append(str(fault))

    @property
    def sound(self) -> bool:
        """Whether there is no fault."""
        return not self.faults

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per kind of check, to be printed."""
        replayed = REPLAY_CHECKS if REPLAY_CHECKS.keys() & self.checked.keys() else {}
        return [
            {
                "check": name,
                "checked": self.checked[name],
                "faults": len(self.faults.get(name, ())),
                "first fault": self.faults[name][0] if name in self.faults else "",
                "what holds": what,
            }
            for name, what in (CHECKS | replayed).items()
        ]

    def _summary(self) -> str:
        faults = sum(map(len, self.faults.values()))
        return f"sound, {self.checked.total()} checks" if self.sound else f"{faults} faults"

    def _tables(self) -> Tables:
        return {"Checks": self.rows()}


def validate(
    store: Store | str | Path,
    rules: Rules | None = None,
    *,
    replay_proofs: bool = False,
    workers: Executor = 2,
    progress: Progress | None = None,
) -> Validation:
    """Check the questions of a store, and derive each answer and proof again from the annotations.

    Args:
        store: The store, or its folder.
        rules: The rules of the generation; None for the defaults.
        replay_proofs: Whether to run every proof again, and every plan as Cypher over the graph.
        workers: Number of processes of the replay, or a Ray cluster.
        progress: Display of the progress.

    Returns:
        The number of checks by kind, and the faults.

    Raises:
        StoreError: A file is missing.
        LockedError: Another process writes the graph.
    """
    store, rules = Store.of(store), rules or Rules()
    count = store.questions("questions").num_rows
    advance = step_counter(progress, "checking questions", count)
    report = Validation()
    training = bool(store.training_set())
    rules = training_rules(rules) if training else rules
    read = {name: _read(store, store.question_path(name), name, report, training) for name in _FILES}
    tables = {name: table for name, table in read.items() if table is not None}
    if len(tables) < len(_FILES):
        return report
    report.check("files", len(set(map(_mark, tables.values()))) == 1, _OTHER_GENERATION)
    hashes = set(tables["answers"]["rules"].to_pylist())
    if hashes and rules_hash(rules) not in hashes:
        raise StoreError(f"{store.path} holds questions made under other rules: give the --rule options of generate")
    infos = {row["sequence"]: row for row in tables["sequences"].to_pylist()}
    _check_ids(report, tables)
    records = read_records(store, report)
    boxes = _read_evidence(tables["evidence"])
    stray = sorted(boxes.keys() - {(record.sequence, record.target_track) for record in records})
    report.check("evidence", not stray, f"boxes of {stray[:3]}, whom no question asks about")
    for sequence in sorted({record.sequence for record in records}):
        if not report.check("files", sequence in infos, f"sequences.parquet lacks {sequence}"):
            continue
        annotations = Annotations.read(store, sequence, rules)
        _check_sequence(report, infos[sequence], annotations)
        for record in (record for record in records if record.sequence == sequence):
            check = _QuestionCheck(report, record, infos[sequence], annotations, rules)
            check.run(boxes[sequence, record.target_track])
            advance(1)
    _check_selection(report, records, rules)
    # Without ids, files that cannot be read are the only fault.
    if replay_proofs and report.checked["ids"]:
        check_replay(report, store, records, rules, workers, step_counter(progress, "running proofs again", 2 * count))
    return report


def read_records(store: Store, report: Validation) -> list[QuestionRecord]:
    """Read every question that has an answer; a record that cannot be read is a fault."""
    private = {row["question_id"]: row for row in store.questions("answers").to_pylist()}
    records = []
    for row in store.questions("questions").to_pylist():
        name = row["question_id"]
        if name not in private:
            continue
        try:
            record = QuestionRecord.read(row, private[name])
            decode_answer(record.answer_mode, record.answer)
            records.append(record)
        except (msgspec.MsgspecError, DecodeError) as error:
            report.check("answers" if isinstance(error, DecodeError) else "proofs", False, f"{name}: {error}")
    return records


def check_replay(
    report: Validation,
    store: Store,
    records: Sequence[QuestionRecord],
    rules: Rules,
    workers: Executor,
    advance: Callable[[int], None] = lambda steps: None,
) -> None:
    """Run every proof and every compiled plan again; `advance` receives the number of finished steps, two a question.

    Raises StoreError for a missing file and an interval file that is not as loaded, and LockedError while another
    process writes the graph.
    """
    check_intervals(store, store.manifest())
    report.add("replay", len(records), replay(store, records, rules, workers, advance))
    report.add("compiled", len(records), run_compiled(store, records, rules, advance))


# -- files --------------------------------------------------------------------------------------------------------


def _read(store: Store, path: Path, table_name: str, report: Validation, training: bool) -> pa.Table | None:
    """Read a file of a table; None where it does not have the right form."""
    if not path.exists():
        raise StoreError(f"{path} is missing: run 'jrdb-avr generate --store {store.path}'")
    name, table, wanted = path.relative_to(store.path / "questions"), read_table(path), QUESTIONS[table_name]
    same = report.check(
        "files",
        table.schema.remove_metadata().equals(wanted),
        f"{name} has columns {_columns(table.schema)}; expected {_columns(wanted)}",
    )
    metadata = {key: value for key, value in (pq.read_metadata(path).metadata or {}).items() if key != b"ARROW:schema"}
    keys = {key.encode() for key in (GENERATION_KEY, *((PROFILE_KEY, DISJOINT_KEY) if training else ("canary",)))}
    report.check("files", set(metadata) == keys, f"{name} has metadata {sorted(metadata)}")
    lacking = not training and metadata.get(b"canary") != CANARY.encode()
    report.check("files", not lacking, f"{name} lacks the canary")
    try:
        table.validate(full=True)
    except pa.ArrowException as error:
        report.check("files", False, f"{name}: {str(error).splitlines()[0]}")
        return None
    nulls = [field.name for field in wanted if not field.nullable and same and table[field.name].null_count]
    report.check("files", not nulls, f"{name} has nulls in {', '.join(nulls)}")
    return table if same and not nulls else None


def _read_evidence(evidence: pa.Table) -> dict[tuple[str, int], list[tuple[int, Box]]]:
    """The boxes of each person, by sequence and track, as pairs of frame and box."""
    boxes: dict[tuple[str, int], list[tuple[int, Box]]] = defaultdict(list)
    for row in evidence.to_pylist():
        boxes[row["sequence"], row["track"]].append((row["frame"], Box(row["x"], row["y"], row["w"], row["h"])))
    return boxes


def _mark(table: pa.Table) -> bytes | None:
    """The mark of the generation that a table is of."""
    mark: bytes | None = (table.schema.metadata or {}).get(GENERATION_KEY.encode())
    return mark


def _columns(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema)


def _check_ids(report: Validation, tables: Mapping[str, pa.Table]) -> None:
    for row in tables["questions"].to_pylist():
        name = row.pop("question_id")
        report.check("ids", question_id(**row) == name, f"{name}: the id of other columns")
    questions, answers = (Counter(tables[name]["question_id"].to_pylist()) for name in ("questions", "answers"))
    for name in sorted(questions | answers):
        report.check(
            "ids",
            questions[name] == answers[name] == 1,
            f"{name}: {questions[name]} times in questions, {answers[name]} in answers",
        )


def _check_sequence(report: Validation, info: dict[str, Any], annotations: Annotations) -> None:
    frames, name = info["frames"], info["sequence"]
    images = annotations.layers.get("images") or annotations.layers.get("2d", [])
    for holds, fault in (
        (all(a < b for a, b in itertools.pairwise(frames)), "the frames of {} are not ascending"),
        (set(frames) == set(images), "the frames of {} are not its annotated frames"),
        (bool(frames) and frames[-1] < info["frame_count"], "{} has frames beyond its frame_count"),
    ):
        report.check("files", holds, f"sequences.parquet: {fault.format(name)}")


# -- one question -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _QuestionCheck:
    """The checks of one question; `info` is its row of `sequences`."""

    report: Validation
    record: QuestionRecord
    info: Mapping[str, Any]
    annotations: Annotations
    rules: Rules

    def check(self, name: str, holds: bool, fault: str) -> None:
        self.report.check(name, holds, f"{self.record.question_id}: {fault}")

    def run(self, boxes: Sequence[tuple[int, Box]]) -> None:
        """Check everything; `boxes` are the question's evidence by frame."""
        record, mode, count = self.record, self.record.answer_mode, len(self.record.choices)
        frames = dict(boxes)
        self.check("evidence", len(boxes) == len(frames) > 0, f"{len(boxes)} rows for {len(frames)} frames")
        own = frames == self.annotations.boxes(record.target_track)
        self.check("evidence", own, f"not the boxes of person {record.target_track}")
        self.check("rules", record.rules == rules_hash(self.rules), f"generated under rules {record.rules}")
        fine = count == len(set(record.choices)) == (CHOICE_COUNT if MODES[mode].is_choice else 0)
        self.check("choices", fine, f"choices {list(record.choices)} for an answer of mode {mode}")
        poses = set(map(answer_of_choice, record.choices))
        both = sorted(pose for pose in poses if overlapping(pose) & poses)
        self.check("choices", not both, f"{both} may be true beside each other")
        answer = decode_answer(mode, record.answer)
        inside = _inside(answer, count, self.info["frame_count"])
        self.check("answers", inside, f"{record.answer} is outside the sequence or the choices")
        try:
            plan, family = parse_plan(record.plan), forms_of(record.template)[0].family
        except AvrError as error:
            self.check("plans", False, str(error))
            return
        self.check("plans", canonical(plan) == record.plan, "the plan is not in its canonical form")
        self.check("plans", plan.answer.mode == mode, f"the plan's answer is of mode {plan.answer.mode}")
        self.check("plans", family == record.family, f"template {record.template!r} is of family {family!r}")
        self._check_text(plan)
        self._check_proofs(plan, answer)
        found = rederive(self.annotations, plan, record.template, self.rules, record.choices)
        again: dict[str, Any] = {
            "answer": found.answer,
            "target_track": found.target,
            "needed": frozenset(found.needed),
            "bindings": dict(found.people) | dict(found.times),
        }
        if found.outcome == "defined":
            again["proofs"] = prove_again(self.annotations, plan, record.template, self.rules, found)
        faults = [f"{record.question_id}: {fault}" for fault in found.faults]
        self.report.add("rederive", len(again), [*faults, *differences(record, again)])

    def _check_text(self, plan: Plan) -> None:
        record = self.record
        key = question_key(record.sequence, record.target_track, plan)
        at_keyframes = self.annotations.step == KEYFRAME_STEP and "actions" in self.annotations.layers
        try:
            written, (template, read) = render(record.template, plan, key, at_keyframes), parse(record.question)
        except AvrError as error:
            self.check("text", False, str(error))
            return
        self.check("text", written == record.question, f"the plan reads {written!r}")
        same = (template, canonical(read)) == (record.template, record.plan)
        self.check("text", same, "the text states another plan")
        stated = _STATED.findall(record.question)
        fitting = all(seconds == f"{int(frame) / self.info['fps']:.1f}" for seconds, frame in stated)
        self.check("text", bool(stated) and fitting, "stated seconds are not frame / fps")

    def _check_proofs(self, plan: Plan, answer: Answer) -> None:
        record = self.record
        named = [(proof.kind, proof.variant) for proof in record.proofs]
        wanted = expected(record.template, plan, self.rules)
        odd = sorted(wanted.symmetric_difference(named)) or sorted(named)
        complete = sorted(named) == sorted(wanted)
        self.check("proofs", complete, f"proofs missing, or not expected: {', '.join(map(' '.join, odd))}")
        broken = failing(record.template, record.proofs, self.rules)
        self.check("proofs", not broken, f"{', '.join(broken)} do not hold")
        fitting = len(record.distractors) == len(record.choices)
        if fitting and isinstance(answer, Choice) and answer.choice <= len(record.distractors):
            fitting = record.distractors[answer.choice - 1] is None
        self.check("proofs", fitting, f"distractors {list(record.distractors)} do not fit the choices")
        bound = record.bindings.keys() == {node.id for node in plan.nodes} | set(plan.times)
        bound = bound and record.bindings[plan.target] == record.target_track
        self.check("proofs", bound, f"bindings {record.bindings} do not fit the plan")


def _inside(answer: Answer, choices: int, frame_count: int) -> bool:
    if isinstance(answer, Choice):
        return answer.choice <= choices
    if frames := frames_of_answer(answer):
        return frames == sorted(frames) and frames[-1] < frame_count
    return not isinstance(answer, Number) or answer.value > 0


# -- all questions together ----------------------------------------------------------------------------------------


def _check_selection(report: Validation, records: Sequence[QuestionRecord], rules: Rules) -> None:
    persons = Counter((record.sequence, record.target_track, record.template) for record in records)
    for (sequence, track, template), count in sorted(persons.items()):
        few = count <= rules.max_per_person
        report.check("selection", few, f"{count} questions {template} of person {track} in {sequence}")
    in_all = Counter((record.sequence, record.target_track) for record in records)
    for (sequence, track), count in sorted(in_all.items()):
        few = count <= rules.max_per_person_in_all
        report.check("selection", few, f"{count} questions of person {track} in {sequence}")
    _check_alike(report, records, rules)
    chosen: dict[str, Counter[str]] = defaultdict(Counter)
    for record in records:
        if MODES[record.answer_mode].is_choice:
            chosen[record.template][record.answer_text] += 1
    for template, counts in sorted(chosen.items()):
        ((commonest, count),) = counts.most_common(1)
        share = count / counts.total()
        report.check("selection", share <= rules.max_answer_share, f"{template}: {commonest!r} takes {share:.1%}")


def _check_alike(report: Validation, records: Sequence[QuestionRecord], rules: Rules) -> None:
    """Check that no two questions are about one start of a person, or of one template and read at near stated times."""
    starts: dict[tuple[str, int, str | None, int], list[str]] = defaultdict(list)
    reads: dict[tuple[str, int, str], list[tuple[str, tuple[int, ...]]]] = defaultdict(list)
    for record in records:
        try:
            plan = parse_plan(record.plan)
        except AvrError:
            continue  # A fault of `plans`.
        times = [plan.times[name] for name in plan.answer.times]
        if frames := frames_of_answer(decode_answer(record.answer_mode, record.answer)):
            start = record.sequence, record.target_track, times[0].action, frames[0]
            starts[start].append(record.question_id)
        stated = tuple(time.frame for time in times if time.frame is not None)
        if len(stated) == len(times):
            reads[record.sequence, record.target_track, record.template].append((record.question_id, stated))
    for names in starts.values():
        report.check("selection", len(names) == 1, f"{', '.join(names)} are about one start")
    for (_, _, template), own in reads.items():
        near = near_frames(template, rules)
        for (name, one), (other_name, other) in itertools.combinations(own, 2):
            far = any(abs(a - b) > near for a, b in zip(one, other, strict=False))
            report.check("selection", far, f"{name} and {other_name} read at nearly the same times")
