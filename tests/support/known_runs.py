"""Runs on multiple-choice questions of which every count is known."""

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.report.scored_runs import SCORES, QuestionIndex, ScoredRun
from jrdb_avr.engine.report.scoring import is_judged, score_predictions
from jrdb_avr.engine.report.truth import Truth, row_numbers
from jrdb_avr.queries.questions import in_order
from jrdb_avr.queries.runs import RunManifest
from jrdb_avr.schema.answers import Choice, encode_answer
from jrdb_avr.schema.tables import QUESTIONS, RUNS
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
                "distractors": '[null,"time.shift +3 s","x without y",null]',
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
        return in_order(rows.join(known, "question_id", join_type="inner")).select(rows.column_names)

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
    digits = np.stack([scores[f"{name}_score"].to_numpy() for name in SCORES], axis=1)
    invalid = scores["invalid"].to_numpy(zero_copy_only=False).astype(np.int8)
    errors = len(rows) - int(np.count_nonzero(is_judged(predictions["status"])))
    given = {row["question_id"]: row["answer"] for row in predictions.to_pylist()}
    answers = [given.get(name) for name in scores["question_id"].to_pylist()]
    return ScoredRun(manifest, rows, digits, invalid, errors, index.ids, answers)
