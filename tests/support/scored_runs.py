"""Runs on multiple-choice questions with known scores, a run with one failure of each kind, and journals of runs."""

import json
from collections import defaultdict

import msgspec
import numpy as np
import pyarrow as pa

from jrdb_avr.engine.report.scored_runs import QuestionIndex, ScoredRun
from jrdb_avr.engine.report.scoring import is_judged, score_predictions
from jrdb_avr.engine.report.truth import Truth, row_numbers, sort_by_sequence
from jrdb_avr.engine.run.journal import Journal, KeptEntries, LinePosition, journal_folder
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.tables import INTERVALS, QUESTIONS, RUNS
from jrdb_avr.schema.templates import FAMILIES

BOX = (100.0, 100.0, 50.0, 120.0)
ELSEWHERE = (900.0, 100.0, 50.0, 120.0)
TEMPLATE_OF = {family: template for template, family in FAMILIES.items()}
"""A template of each family."""


def table(rows, schema):
    """Rows as a table; what a row does not name is empty."""
    blank = {f.name: None if f.nullable else ("" if pa.types.is_string(f.type) else 0) for f in schema}
    blank |= {f.name: [] for f in schema if pa.types.is_list(f.type)}
    blank |= {f.name: False for f in schema if pa.types.is_boolean(f.type)}
    return pa.Table.from_pylist([blank | row for row in rows], schema)


class Benchmark:
    """Multiple-choice questions, choice 1 right, whose target stands in `BOX` at frame 7 and 8."""

    def __init__(self, asked):
        """asked: (id, sequence, family) each."""
        self.ids = [name for name, _, _ in asked]
        questions = table(
            [
                {
                    "question_id": q,
                    "sequence": s,
                    "family": f,
                    "template": TEMPLATE_OF[f],
                    "answer_mode": "multiple_choice",
                }
                for q, s, f in asked
            ],
            QUESTIONS["questions"],
        )
        sequences = [{"sequence": s, "fps": 15.0, "frame_count": 100} for s in sorted({s for _, s, _ in asked})]
        answers = [
            {
                "question_id": q,
                "answer": '{"choice":1}',
                "target_track": 1,
            }
            for q in self.ids
        ]
        evidence = [
            {"sequence": row["sequence"], "track": 1, "frame": frame, **dict(zip("xywh", BOX, strict=True))}
            for row in sequences
            for frame in (7, 8)
        ]
        self.tables = {
            "questions": questions,
            "sequences": table(sequences, QUESTIONS["sequences"]),
            "answers": table(answers, QUESTIONS["answers"]),
            "evidence": table(evidence, QUESTIONS["evidence"]),
        }
        self.truth = Truth(*self.tables.values())
        self.index = QuestionIndex(questions, self.tables["answers"])

    def write(self, store):
        """Write the tables into a store."""
        for name, rows in self.tables.items():
            store.write_questions(name, rows, {})

    def ordered(self, rows):
        """A table of a run in the order in which stores hold it."""
        known = self.tables["questions"].select(["question_id", "sequence"])
        return sort_by_sequence(rows.join(known, "question_id", join_type="inner")).select(rows.column_names)

    def run(self, given, run_id="r", method="react", model="m"):
        """given: (choice or None, box or None, frame) per question."""
        rows = []
        for name, (choice, box, frame) in zip(self.ids, given, strict=True):
            where = {} if box is None else dict(zip(("x", "y", "w", "h"), box, strict=True))
            rows.append(
                {
                    "run_id": run_id,
                    "question_id": name,
                    "status": "answered" if choice and box else "invalid",
                    "reason": "" if choice and box else "unreadable",
                    "answer": None if choice is None else encode_answer(Choice(choice)),
                    "evidence_frame": None if box is None else frame,
                    **{f"evidence_{key}": value for key, value in where.items()},
                    "n_model_calls": 3,
                    "prompt_tokens": 100,
                    "completion_tokens": 10,
                }
            )
        predictions = table(rows, RUNS["predictions"])
        manifest = RunManifest(run_id, method, model, "0", tuple(self.ids), False, {}, "2020-01-01T00:00:00Z")
        scores = score_predictions(self.truth, run_id, self.ids, predictions)
        self.written = {"predictions": self.ordered(predictions), "scores": scores}
        return scored_run(self.index, manifest, predictions, scores)


def scored_run(index, manifest, predictions, scores):
    """A run of its tables, whose rows are in the run's order."""
    rows = row_numbers(scores["question_id"].combine_chunks(), index.ids)
    errors = len(rows) - int(np.count_nonzero(is_judged(predictions["status"])))
    given = {row["question_id"]: row["answer"] for row in predictions.to_pylist()}
    answers = [given.get(name) for name in scores["question_id"].to_pylist()]
    return ScoredRun(manifest, rows, scores, errors, answers)


CASES = {
    # name: (choice, box, frame), the look (frame, left or None for a panorama), cause
    "scores": ((1, BOX, 7), (7, 0), ""),
    "no box": ((1, None, 0), (7, 0), "no box"),
    "looked behind": ((1, ELSEWHERE, 7), (7, 2000), "never looked there"),
    "looked too early": ((1, ELSEWHERE, 7), (6, 0), "never looked there"),
    "a third of it": ((1, ELSEWHERE, 7), (7, 134), "never looked there"),
    "half of it": ((1, ELSEWHERE, 7), (7, 125), "nobody"),
    "over the seam": ((1, ELSEWHERE, 7), (7, 3500), "nobody"),
    "a panorama": ((1, ELSEWHERE, 7), (8, None), "nobody"),
    "another frame": ((1, BOX, 9), (7, 0), "frame where the target is absent"),
    "loose": ((1, (100.0, 100.0, 50.0, 59.0), 7), (7, 0), "right person, loose box"),
    "another person": ((1, (300.0, 100.0, 50.0, 120.0), 7), (7, 0), "wrong person"),
    "between two": ((1, (100.0, 100.0, 250.0, 120.0), 8), (7, 0), "right person, loose box"),
    "nobody": ((1, ELSEWHERE, 7), (7, 0), "nobody"),
}


def stored_failures(path, settings=None, families=("long_range",)):
    """A store in which run r fails in each way once; the questions are of these families in turn."""
    benchmark = Benchmark([(name, "s", families[place % len(families)]) for place, name in enumerate(CASES)])
    run = benchmark.run([given for given, _, _ in CASES.values()])
    store = Store(path)
    benchmark.write(store)
    people = [(7, 1, BOX), (8, 1, BOX), (7, 2, (300.0, 100.0, 50.0, 120.0)), (8, 2, (320.0, 100.0, 30.0, 120.0))]
    sightings = [
        {"sequence": "s", "frame": frame, "track": track, **dict(zip("xywh", box, strict=True))}
        for frame, track, box in people
    ]
    store.write_interval("sightings", "s", table(sightings, INTERVALS["sightings"]))
    steps = []
    for name, (_, (frame, left), _) in CASES.items():
        asked = {"sequence": "s", "frame_index": frame} | ({} if left is None else {"angle_deg": 1.0})
        looked = {"run_id": "r", "question_id": name, "kind": "observe", "request": json.dumps(asked)}
        shown = {"frame_id": f"{frame:06}"} | ({} if left is None else {"angle_deg": 1.0, "left": left})
        steps.append(looked | {"response": json.dumps(shown)})
        # A refused look shows nothing, and other steps are no looks.
        steps.append(looked | {"request": '{"frame_index":7,"angle_deg":0}', "response": '{"refused":"twice"}'})
        steps.append(looked | {"kind": "model", "request": "[]", "response": "{}"})
    store.write_run("r", "steps", table(steps, RUNS["steps"]))
    store.write_run("r", "predictions", benchmark.written["predictions"])
    write_run_manifest(
        store, msgspec.structs.replace(run.manifest, questions_sha256=questions_hash(store), settings=settings or {})
    )
    return benchmark, run, store


def opened(path):
    """The journal in a file's folder that writes all entries into this file."""
    return Journal(path.parent, defaultdict(lambda: path.stem))


def segment_of(run, sequence="s"):
    """The file of a sequence in the journal of a run's folder."""
    return journal_folder(run) / f"{sequence}.jsonl"


def journal_lines(run):
    """All lines of a run's journal."""
    return [line for path in sorted(journal_folder(run).glob("*.jsonl")) for line in path.read_text().splitlines()]


class InMemory(KeptEntries):
    """Entries that lie in no file, as of one sequence."""

    def __init__(self, *entries):
        super().__init__(None, {own.question_id: LinePosition("s", 0, 0) for own in entries})
        self._entries = {own.question_id: own for own in entries}

    def __getitem__(self, question_id):
        return self._entries[question_id]
