"""Checks of a benchmark: of the question files, of each question, and of all questions together.

The second program (`rederive`) derives the answer and the proofs of each question again from the annotation tables. On
request, statements over the graph repeat the proofs too (`replay`).
"""

from __future__ import annotations

import contextlib
import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.engine.generate.near_duplicates import are_near, near_frames
from jrdb_avr.engine.generate.proofs import failing
from jrdb_avr.engine.rederive import Annotations, Outcome, prove_again, rederive
from jrdb_avr.engine.rederive.twins import compare_twins
from jrdb_avr.engine.report.hashes import hash_of, in_hash_order
from jrdb_avr.engine.report.scoring import DEFAULT_IOU
from jrdb_avr.engine.report.truth import is_imported, is_inside, refuse_imported
from jrdb_avr.engine.validate.replay import compare_record, read_plans, replay, run_compiled
from jrdb_avr.engine.validate.validation import Validation
from jrdb_avr.queries.display import Progress, step_counter
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.schema.answer_modes import MODES, decode_answer, frames_of_answer
from jrdb_avr.schema.choice_labels import CHOICE_COUNT
from jrdb_avr.schema.errors import AvrError, DecodeError, StoreError
from jrdb_avr.schema.labels import answer_of_choice
from jrdb_avr.schema.panorama import Box, angle_error, iou
from jrdb_avr.schema.plan import Plan, canonical, parse_plan
from jrdb_avr.schema.questions import DISJOINT_KEY, IMPORTED_KEY, PROFILE_KEY, QuestionRecord
from jrdb_avr.schema.rules import FPS, KEYFRAME_STEP, Rules, rules_hash, training_rules
from jrdb_avr.schema.tables import CANARY, GENERATION_KEY, QUESTIONS
from jrdb_avr.schema.templates import forms_of
from jrdb_avr.schema.wording.text import parse, question_id, question_key, render

_FILES: Final = ("questions", "sequences", "answers", "evidence", "rejected")


def validate(
    store: Store | str | Path,
    rules: Rules | None = None,
    *,
    replay_proofs: bool = False,
    progress: Progress | None = None,
) -> Validation:
    """Check the questions of a store, and derive each answer and proof again from the annotations.

    Args:
        store: Store, or its folder.
        rules: Rules of the generation, or None for the default rules.
        replay_proofs: Whether statements over the graph also repeat all proofs, and each plan runs as Cypher.
        progress: Function that receives the progress.

    Returns:
        The numbers of checks, and the faults.

    Raises:
        StoreError: If nothing is loaded, a file is missing, or the questions were made under other rules.
        LockedError: If the proofs are repeated while another process writes the graph.
    """
    store, rules = Store.of(store), rules or Rules()
    store.manifest()
    count = store.questions("questions").num_rows
    advance = step_counter(progress, "checking questions", count)
    report = Validation()
    training, imported = bool(store.training_set()), is_imported(store)
    if replay_proofs:
        refuse_imported(store, "validate without --replay")
    rules = training_rules(rules) if training else rules
    marks = {PROFILE_KEY, DISJOINT_KEY} if training else {"canary", IMPORTED_KEY} if imported else {"canary"}
    read = {name: _read(store, name, report, marks | {GENERATION_KEY}) for name in _FILES}
    tables = {name: table for name, table in read.items() if table is not None}
    if len(tables) < len(_FILES):
        return report
    generations = {(table.schema.metadata or {}).get(GENERATION_KEY.encode()) for table in tables.values()}
    report.check("files", len(generations) == 1, "the files are of different generations: generate again")
    hashes = set(tables["answers"]["rules"].to_pylist())
    if hashes and not imported and rules_hash(rules) not in hashes:
        raise StoreError(f"{store.path} has questions of other rules: give the --rule options of generate")
    infos = {row["sequence"]: row for row in tables["sequences"].to_pylist()}
    _check_ids(report, tables, imported)
    records = read_records(store, report)
    boxes = _read_evidence(tables["evidence"])
    stray = sorted(boxes.keys() - {(record.sequence, record.target_track) for record in records})
    report.check("evidence", not stray, f"boxes of {stray[:3]}, but no question asks about these people")
    keys = _check_twins(report, records, rules)
    for sequence in sorted({record.sequence for record in records}):
        if not report.check("files", sequence in infos, f"sequences.parquet lacks {sequence}"):
            continue
        annotations = Annotations.read(store, sequence, rules)
        _check_sequence(report, infos[sequence], annotations)
        for record in (record for record in records if record.sequence == sequence):
            check = _QuestionCheck(report, record, infos[sequence], annotations, rules, keys[record.question_id])
            check.run(boxes[sequence, record.target_track])
            advance(1)
    if not imported:
        _check_selection(report, records, rules)
    if replay_proofs:
        check_replay(report, store, records, rules, step_counter(progress, "repeating proofs", 2 * count))
    return report


def read_records(store: Store, report: Validation) -> list[QuestionRecord]:
    """Read all questions that have an answer.

    Args:
        store: Store with the questions.
        report: Result that gets a fault for each record that cannot be read.

    Returns:
        The records that can be read, in the order of the file.
    """
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
    advance: Callable[[int], None] = lambda count: None,
) -> None:
    """Repeat all proofs by statements over the graph, and run all plans as Cypher.

    Args:
        report: Result that gets the checks and their faults.
        store: Store with the graph.
        records: Questions.
        rules: Rules of the questions.
        advance: Function that receives the number of finished steps. There are two steps per question.

    Raises:
        StoreError: If the graph is missing or damaged.
        LockedError: If another process writes the graph.
    """
    plans, unreadable = read_plans(records)
    advance(2 * len(unreadable))
    report.add("replay", len(records), [*unreadable, *replay(store, plans, rules, advance)])
    report.add("compiled", len(records), [*unreadable, *run_compiled(store, plans, rules, advance)])


# -- files ------------------------------------------------------------------------------------------------------------


def _read(store: Store, table_name: str, report: Validation, keys: set[str]) -> pa.Table | None:
    """Read a question file, with these keys of metadata. Return None if its columns or values are wrong."""
    path, schema = store.question_path(table_name), QUESTIONS[table_name]
    if not path.exists():
        raise StoreError(f"{path} is missing: run 'jrdb-avr generate --store {store.path}'")
    name, table = path.relative_to(store.path / "questions"), read_table(path)
    if IMPORTED_KEY in keys and table_name == "answers":  # Other columns follow.
        table = table.select(range(len(schema)))
    columns, same = _list_columns(table.schema), table.schema.remove_metadata().equals(schema)
    report.check("files", same, f"{name} has the columns {columns}; expected {_list_columns(schema)}")
    stored = {key.decode(errors="replace"): value for key, value in (pq.read_metadata(path).metadata or {}).items()}
    named = stored.keys() - {"ARROW:schema"}
    report.check("files", named == keys, f"{name} has the metadata {sorted(named)}")
    marked = "canary" not in keys or stored.get("canary") == CANARY.encode()
    report.check("files", marked, f"{name} lacks the canary")
    try:
        table.validate(full=True)
    except pa.ArrowException as error:
        report.check("files", False, f"{name}: {str(error).splitlines()[0]}")
        return None
    nulls = [field.name for field in schema if not field.nullable and same and table[field.name].null_count]
    report.check("files", not nulls, f"{name} has nulls in {', '.join(nulls)}")
    return table if same and not nulls else None


def _read_evidence(evidence: pa.Table) -> dict[tuple[str, int], list[tuple[int, Box]]]:
    """Return the boxes of each person, by sequence and track, as pairs of frame and box."""
    boxes: dict[tuple[str, int], list[tuple[int, Box]]] = defaultdict(list)
    for row in evidence.to_pylist():
        boxes[row["sequence"], row["track"]].append((row["frame"], Box(row["x"], row["y"], row["w"], row["h"])))
    return boxes


def _list_columns(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema)


def _check_ids(report: Validation, tables: Mapping[str, pa.Table], imported: bool) -> None:
    for row in tables["questions"].to_pylist():
        name = row.pop("question_id")
        report.check("ids", imported or question_id(**row) == name, f"{name}: the hash of the public columns differs")
    questions, answers = (Counter(tables[name]["question_id"].to_pylist()) for name in ("questions", "answers"))
    for name in sorted(questions | answers):
        counts = questions[name], answers[name]
        report.check("ids", counts == (1, 1), f"{name}: {counts[0]} times in questions, {counts[1]} times in answers")


def _check_sequence(report: Validation, info: dict[str, Any], annotations: Annotations) -> None:
    frames, name = info["frames"], info["sequence"]
    images = annotations.layers.get("images") or annotations.layers.get("2d", [])
    report.check("files", frames == sorted(images), f"sequences.parquet: not the annotated frames of {name}")
    inside = bool(frames) and frames[-1] < info["frame_count"]
    report.check("files", inside, f"sequences.parquet: {name} has frames beyond its frame_count")
    report.check("files", info["fps"] == FPS, f"sequences.parquet: {name} has {info['fps']} frames per second")


# -- one question -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _QuestionCheck:
    """The checks of one question.

    `info` is the row of its sequence in `sequences`. `key` chooses the paraphrase and the order of the choices.
    """

    report: Validation
    record: QuestionRecord
    info: Mapping[str, Any]
    annotations: Annotations
    rules: Rules
    key: str

    def check(self, name: str, holds: bool, fault: str) -> None:
        self.report.check(name, holds, f"{self.record.question_id}: {fault}")

    def run(self, boxes: Sequence[tuple[int, Box]]) -> None:
        """Run all checks. `boxes` are the boxes of the evidence by frame."""
        record, mode, count = self.record, self.record.answer_mode, len(self.record.choices)
        imported, expected = not record.plan, CHOICE_COUNT if MODES[mode].is_choice else 0
        complete = count == len(set(record.choices)) == (count if imported and expected else expected)
        self.check("choices", complete, f"choices {list(record.choices)} for an answer of mode {mode}")
        answer = decode_answer(mode, record.answer)
        inside = is_inside(answer, count, self.info["frame_count"])
        self.check("answers", inside, f"{record.answer} is outside the sequence or the choices")
        if imported:
            self._check_near(boxes)
            return
        same = sorted(boxes) == sorted(self.annotations.boxes(record.target_track).items())
        self.check("evidence", same, f"the boxes differ from those of person {record.target_track}")
        self.check("rules", record.rules == rules_hash(self.rules), f"generated under the rules {record.rules}")
        try:
            plan, family = parse_plan(record.plan), forms_of(record.template)[0].family
        except AvrError as error:
            self.check("plans", False, str(error))
            return
        self.check("plans", canonical(plan) == record.plan, "the plan is not in its canonical form")
        self.check("plans", plan.answer.mode == mode, f"the answer of the plan has the mode {plan.answer.mode}")
        self.check("plans", family == record.family, f"template {record.template!r} belongs to the family {family!r}")
        labels = tuple(map(answer_of_choice, record.choices))
        self.check("choices", in_hash_order(labels, self.key) == labels, "the choices are in another order")
        self._check_text(plan)
        self._check_proofs(plan)
        outcome = rederive(self.annotations, plan, record.template, self.rules, record.choices)
        again = self._compute_columns(plan, outcome)
        faults = [f"{record.question_id}: {fault}" for fault in outcome.faults]
        self.report.add("rederive", len(again), [*faults, *compare_record(record, again)])

    def _check_near(self, boxes: Sequence[tuple[int, Box]]) -> None:
        """Check imported boxes: a method can look at one of them, and an annotated box of a person is near each."""
        frames = {frame for frame, _ in boxes}
        self.check("evidence", not frames.isdisjoint(self.info["frames"]), f"no picture of the frames {sorted(frames)}")
        for frame, box in boxes:
            people = [self.annotations.boxes(track)[frame] for track in self.annotations.people(frame)]
            near = any(iou(box, person) >= DEFAULT_IOU for person in people)
            self.check("evidence", near, f"no annotated box is near {list(box)} at frame {frame}")

    def _compute_columns(self, plan: Plan, outcome: Outcome) -> dict[str, Any]:
        """Return the values of columns that follow from the outcome of the second program."""
        columns: dict[str, Any] = {
            "answer": outcome.answer,
            "target_track": outcome.target,
            "needed": frozenset(outcome.needed),
            "bindings": dict(outcome.people) | dict(outcome.times),
        }
        if outcome.outcome == "defined":
            annotations, begin = self.annotations, outcome.needed[0].frame
            before = annotations.angle(outcome.target or 0, begin)
            decisive = [box for box in outcome.needed if box.node == plan.target and box.decisive]
            columns |= {
                "proofs": prove_again(annotations, plan, self.record.template, self.rules, outcome),
                "hops": len(plan.edges),
                "time_gap_s": (max(dict(outcome.times).values()) - begin) / self.info["fps"],
                "separation_deg": max(angle_error(annotations.angle(box.track, box.frame), before) for box in decisive),
                "people_in_scene": len(annotations.people(begin)),
            }
        return columns

    def _check_text(self, plan: Plan) -> None:
        record = self.record
        at_keyframes = self.annotations.step == KEYFRAME_STEP and "actions" in self.annotations.layers
        try:
            written = render(record.template, plan, self.key[:64], at_keyframes, self.annotations.judges_views)
            template, stated = parse(record.question)
        except AvrError as error:
            self.check("text", False, str(error))
            return
        self.check("text", written == record.question, f"the text of the plan is {written!r}")
        self.check("text", (template, canonical(stated)) == (record.template, record.plan), "the text has another plan")

    def _check_proofs(self, plan: Plan) -> None:
        record = self.record
        broken = failing(record.template, record.proofs, self.rules)
        self.check("proofs", not broken, f"{', '.join(broken)} do not hold")
        bound = record.bindings.keys() == {node.id for node in plan.nodes} | set(plan.times)
        bound = bound and record.bindings[plan.target] == record.target_track
        self.check("proofs", bound, f"bindings {record.bindings} do not fit the plan")


# -- all questions together -------------------------------------------------------------------------------------------


def _parse_plans(records: Sequence[QuestionRecord]) -> Iterator[tuple[QuestionRecord, Plan]]:
    """Yield each question with its plan, if the plan is valid. The check "plans" reports the other plans."""
    for record in records:
        with contextlib.suppress(AvrError):
            yield record, parse_plan(record.plan)


def _check_twins(report: Validation, records: Sequence[QuestionRecord], rules: Rules) -> dict[str, str]:
    """Check the pairs of time twins. Return the key of each question, which twins share, by the question's id."""
    keys: dict[str, str] = defaultdict(str)
    groups: dict[str, list[QuestionRecord]] = defaultdict(list)
    for record, plan in _parse_plans(records):
        answer = f" {record.answer_text}" if plan.answer.read in ("action", "next_action") else ""
        keys[record.question_id] = question_key(record.sequence, record.target_track, plan) + answer
        if record.twin_id is not None:
            groups[record.twin_id].append(record)
    for twin, group in groups.items():
        names = [record.question_id for record in group]
        named = f"{twin}: {', '.join(names)}"
        if report.check("twins", len(group) == 2, f"{named}: a twin_id is not on exactly two questions"):
            key = min(keys[name] for name in names)
            keys |= dict.fromkeys(names, key)
            report.check("twins", twin == f"{hash_of(key):016x}", f"{named} have another twin_id")
            fault = compare_twins(group[0], group[1], rules)
            report.check("twins", fault is None, f"{named} {fault}")
    return keys


def _check_selection(report: Validation, records: Sequence[QuestionRecord], rules: Rules) -> None:
    persons: Counter[tuple[str, int, str]] = Counter()
    for record in records:
        persons.update((record.sequence, record.target_track, template) for template in (f" {record.template}", ""))
    for (sequence, track, template), count in sorted(persons.items()):
        few = count <= (rules.max_per_person if template else rules.max_per_person_in_all)
        report.check("selection", few, f"{count} questions{template} of person {track} in {sequence}")
    _check_alike(report, records, rules)


def _check_alike(report: Validation, records: Sequence[QuestionRecord], rules: Rules) -> None:
    """Check for near-duplicates: questions about the same start, and questions of one template with near times."""
    starts: dict[tuple[str, int, str | None, int], list[str]] = defaultdict(list)
    reads: dict[tuple[str, int, str], list[tuple[str, tuple[int, ...]]]] = defaultdict(list)
    for record, plan in _parse_plans(records):
        times = [plan.times[name] for name in plan.answer.times]
        if frames := frames_of_answer(decode_answer(record.answer_mode, record.answer)):
            starts[record.sequence, record.target_track, times[0].action, frames[0]].append(record.question_id)
        stated = tuple(time.frame for time in times if time.frame is not None)
        if len(stated) == len(times):
            reads[record.sequence, record.target_track, record.template].append((record.question_id, stated))
    for names in starts.values():
        report.check("selection", len(names) == 1, f"{', '.join(names)} are about one start")
    for (_, _, template), questions in reads.items():
        near = near_frames(template, rules)
        for (first, asked), (second, asked_too) in itertools.combinations(questions, 2):
            far = not are_near(asked, asked_too, near)
            report.check("selection", far, f"{first} and {second} read at nearly the same times")
