"""Whether the question files hold what they promise: every check counted, every fault told with its question.

Reads the files of `questions/` and, for what they claim of the scene, the annotation tables. Where the proofs are to be
run again, the interval tables are searched and the graph is asked too.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Answer, Choice, FrameAnswer, FrameViewpoint, Span, decode_answer, encode_answer
from jrdb_avr.schema.errors import AvrError, StoreError
from jrdb_avr.schema.panorama import Box
from jrdb_avr.schema.plan import Plan, canonical, parse_plan
from jrdb_avr.schema.rules import KEYFRAME_STEP, Rules, rules_hash
from jrdb_avr.schema.tables import CANARY, QUESTIONS
from jrdb_avr.schema.wording import FAMILIES, parse, question_id, question_key, render

from .compiled import ask_compiled
from .publish import GENERATION_KEY
from .rederive import Annotations, NeededBox, rederive
from .replay import replay
from .required import expected_proofs, failing_proofs
from .stored import stored_question

FILES: Final = ("questions", "sequences", "answers", "evidence", "rejected")
CHOICE_COUNT: Final = 4

CHECKS: Final = {
    "files": "schema, canary, nothing private in public files",
    "ids": "each question once, its id is the hash of its public columns, and each file knows the same ones",
    "choices": "four different choices, exactly one of them true; none for other answers",
    "answers": "the stored answer reads back and lies within the sequence",
    "plans": "the plan is valid and of the question's template",
    "text": "the text says the plan and nothing else; stated seconds are frame / fps",
    "evidence": "every box of the target, and nothing else",
    "proofs": "every required proof is there and holds; distractors and bindings fit",
    "rules": "made under the rules given",
    "selection": "shares of answers and questions per person keep to the rules",
    "rederive": "the second path finds the same person, answer and needed boxes",
}
"""What is checked, in the order in which it is reported."""

REPLAY_CHECKS: Final = {
    "replay": "every proof, run again from the stored plan, comes out as it is stored",
    "compiled": "the plan, compiled to Cypher, finds the stored people and answer in the graph",
}
"""What is checked besides where the proofs are run again."""

_STATED: Final = re.compile(r"(\S+) s \(frame (\d+)\)")


class Report:
    """Counts per check, and its faults in the order found."""

    def __init__(self) -> None:
        self.checked: Counter[str] = Counter()
        self.faults: dict[str, list[str]] = defaultdict(list)

    def check(self, name: str, holds: bool, fault: str) -> bool:
        """Count one check; keep the fault where it does not hold."""
        self.checked[name] += 1
        if not holds:
            self.faults[name].append(fault)
        return holds

    @property
    def sound(self) -> bool:
        """Whether nothing was found."""
        return not self.faults

    def rows(self) -> list[dict[str, Any]]:
        """One row per check, for printing."""
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


def validate(store: Store, rules: Rules, advance: Callable[[int], None] = lambda steps: None) -> Report:
    """Check the store's questions; `advance` is told how many were rederived. Raises StoreError for a missing file."""
    report = Report()
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
                _check_question(report, row, own, infos[sequence], annotations, rules)
                _check_evidence(report, row, own, known, rows_of[row["question_id"]], annotations)
            advance(1)
    _check_selection(report, questions, private, rules)
    return report


def check_replay(
    report: Report, store: Store, rules: Rules, workers: int, advance: Callable[[int], None] = lambda steps: None
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


def _read(store: Store, name: str, report: Report) -> pa.Table | None:
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
    report: Report, questions: list[dict[str, Any]], answers: list[dict[str, Any]], evidence: list[dict[str, Any]]
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


def _check_sequence(report: Report, info: dict[str, Any], annotations: Annotations) -> None:
    frames, name = info["frames"], info["sequence"]
    ordered = all(a < b for a, b in itertools.pairwise(frames))
    report.check("files", ordered, f"sequences.parquet: the frames of {name} are not ascending")
    images = annotations.layers.get("images") or annotations.layers.get("2d", [])
    report.check(
        "files", set(frames) == set(images), f"sequences.parquet: the frames of {name} are not those there are"
    )
    inside = bool(frames) and frames[-1] < info["frame_count"]
    report.check("files", inside, f"sequences.parquet: {name} has frames beyond its frame_count")


# -- one question -------------------------------------------------------------------------------------------------


def _check_question(
    report: Report,
    row: dict[str, Any],
    own: dict[str, Any],
    info: dict[str, Any],
    annotations: Annotations,
    rules: Rules,
) -> None:
    name, mode, choices = row["question_id"], row["answer_mode"], row["choices"]
    report.check("rules", own["rules"] == rules_hash(rules), f"{name}: made under rules {own['rules']}")
    if mode == "multiple_choice":
        fine = len(choices) == len(set(choices)) == CHOICE_COUNT
        report.check("choices", fine, f"{name}: choices {choices}")
    else:
        report.check("choices", not choices, f"{name}: choices for an answer of mode {mode}")
    try:
        answer = decode_answer(mode, own["answer"])
    except AvrError as error:
        report.check("answers", False, f"{name}: {error}")
        return
    report.check("answers", _inside(answer, len(choices), info["frame_count"]), f"{name}: {own['answer']} is outside")
    try:
        plan = parse_plan(own["plan"])
    except AvrError as error:
        report.check("plans", False, f"{name}: {error}")
        return
    family = FAMILIES.get(row["template"], "none")
    report.check("plans", canonical(plan) == own["plan"], f"{name}: the plan is not in its canonical form")
    report.check("plans", plan.answer.mode == mode, f"{name}: the plan's answer is of mode {plan.answer.mode}")
    report.check("plans", family == row["family"], f"{name}: template {row['template']!r} is of family {family!r}")
    _check_text(report, row, own, plan, info, annotations)
    _check_private(report, row, own, plan, answer, rules)
    found = rederive(annotations, plan, row["template"], rules)
    shown = choices[answer.choice - 1] if isinstance(answer, Choice) and answer.choice <= len(choices) else None
    said = shown if isinstance(answer, Choice) else encode_answer(answer)
    report.check(
        "rederive",
        found.outcome == "defined" and found.answer == said and found.target == own["target_track"],
        f"{name}: {found.outcome}, {found.answer} of person {found.target}; stored: {said} of {own['target_track']}"
        f" {'; '.join(found.faults)}",
    )
    report.check("rederive", not found.faults, f"{name}: {'; '.join(found.faults)}")
    report.check("rederive", _needed(own["needed"]) == set(found.needed), f"{name}: other boxes are needed")
    bound = _decoded(own["bindings"]) == dict(found.people) | dict(found.times)
    report.check("rederive", bound, f"{name}: bindings {own['bindings']} are others")


def _inside(answer: Answer, choices: int, frame_count: int) -> bool:
    match answer:
        case Choice(number):
            return number <= choices
        case FrameAnswer(frame) | FrameViewpoint(frame):
            return frame < frame_count
        case Span(start, end):
            return start <= end < frame_count
    return answer.value > 0


def _check_text(
    report: Report,
    row: dict[str, Any],
    own: dict[str, Any],
    plan: Plan,
    info: dict[str, Any],
    annotations: Annotations,
) -> None:
    name, text = row["question_id"], row["question"]
    key = question_key(row["sequence"], own["target_track"], plan)
    about = annotations.step == KEYFRAME_STEP and "actions" in annotations.layers
    try:
        written, read = render(row["template"], plan, key, about), parse(text)
    except AvrError as error:
        report.check("text", False, f"{name}: {error}")
        return
    report.check("text", written == text, f"{name}: the plan reads {written!r}")
    report.check("text", (read[0], canonical(read[1])) == (row["template"], own["plan"]), f"{name}: says another plan")
    stated = _STATED.findall(text)
    seconds = all(said == f"{int(frame) / info['fps']:.1f}" for said, frame in stated)
    report.check("text", bool(stated) and seconds, f"{name}: stated seconds are not frame / fps")


def _check_private(
    report: Report, row: dict[str, Any], own: dict[str, Any], plan: Plan, answer: Answer, rules: Rules
) -> None:
    name = row["question_id"]
    try:
        proofs = msgspec.json.decode(own["proofs"], type=list[dict[str, Any]])
        distractors = msgspec.json.decode(own["distractors"], type=list[str | None])
        bindings = msgspec.json.decode(own["bindings"], type=dict[str, int])
        _needed(own["needed"])
    except msgspec.DecodeError as error:
        report.check("proofs", False, f"{name}: {error}")
        return
    named = [(str(one.get("kind")), str(one.get("variant"))) for one in proofs]
    expected = expected_proofs(row["template"], plan, rules)
    known = sorted(named) == sorted(expected)
    odd = sorted(expected.symmetric_difference(named)) or sorted(named)
    report.check("proofs", known, f"{name}: proofs missing, or not expected: {', '.join(map(' '.join, odd))}")
    holds = {key: one.get("holds") is True for key, one in zip(named, proofs, strict=True)}
    failing = failing_proofs(row["template"], holds)
    report.check("proofs", not failing, f"{name}: {', '.join(failing)} do not hold")
    fitting = len(distractors) == len(row["choices"])
    if fitting and isinstance(answer, Choice) and answer.choice <= len(distractors):
        fitting = distractors[answer.choice - 1] is None
    report.check("proofs", fitting, f"{name}: distractors {own['distractors']} do not fit the choices")
    names = {node.id for node in plan.nodes} | set(plan.times)
    bound = set(bindings) == names and bindings.get(plan.target) == own["target_track"]
    report.check("proofs", bound, f"{name}: bindings {own['bindings']} do not fit the plan")


def _decoded(text: str) -> dict[str, int] | None:
    try:
        return msgspec.json.decode(text, type=dict[str, int])
    except msgspec.DecodeError:
        return None


class _Needed(msgspec.Struct, forbid_unknown_fields=True):
    node: str
    track: int
    frame: int
    x: float
    y: float
    w: float
    h: float
    decisive: bool


def _needed(text: str) -> set[NeededBox]:
    try:
        boxes = msgspec.json.decode(text, type=list[_Needed])
    except msgspec.DecodeError:
        return set()
    return {NeededBox(b.node, b.track, b.frame, Box(b.x, b.y, b.w, b.h), b.decisive) for b in boxes}


def _check_evidence(
    report: Report, row: dict[str, Any], own: dict[str, Any], known: dict[int, Box], rows: int, annotations: Annotations
) -> None:
    name, target = row["question_id"], own["target_track"]
    report.check("evidence", rows == len(known) > 0, f"{name}: {rows} rows for {len(known)} frames")
    report.check("evidence", known == annotations.boxes(target), f"{name}: not the boxes of person {target}")


# -- all together -------------------------------------------------------------------------------------------------


def _check_selection(
    report: Report, questions: list[dict[str, Any]], private: dict[str, dict[str, Any]], rules: Rules
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
