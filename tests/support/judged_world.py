"""Answers for the asked world, and a method that reads the questions' marks: what scores are tried on."""

import json

import pyarrow as pa
from asked_world import POSES, QUESTIONS_ASKED

from jrdb_avr.schema.answers import Choice, Evidence
from jrdb_avr.schema.method import Prediction
from jrdb_avr.schema.tables import QUESTIONS


def asked_frame(question):
    return int(question.question.rpartition("(frame ")[2].partition(")")[0])


def shown_at(frame):
    return POSES.index("sitting" if frame < 120 else "lying") + 1


def box_at(frame):
    return (3650 + frame * 0.5, 120.0, 70.0, 220.0)


def write_answers(store, questions=QUESTIONS_ASKED):
    """Answers under which every second question's mark is right, and evidence where the person stands."""
    answers, evidence = [], {}
    for i, q in enumerate(questions):
        frame = asked_frame(q)
        answer = json.dumps({"choice": shown_at(frame) if i % 2 else shown_at(frame) % 4 + 1})
        texts = dict.fromkeys(("plan", "distractors", "rules", "bindings", "needed", "proofs"), "{}")
        numbers = {"target_track": 1, "hops": 1, "time_gap_s": 1.0, "separation_deg": 1.0, "people_in_scene": 2}
        answers.append({"question_id": q.question_id, "answer": answer, **texts, **numbers})
        box = dict(zip("xywh", box_at(frame), strict=True))
        evidence[q.sequence, frame] = {"sequence": q.sequence, "track": 1, "frame": frame, **box}
    store.write_questions("answers", pa.Table.from_pylist(answers, QUESTIONS["answers"]), {})
    rows = store.questions("questions").filter(pa.compute.field("sequence") != "unseen")
    store.write_questions("questions", rows, {})
    store.write_questions("evidence", pa.Table.from_pylist([*evidence.values()], QUESTIONS["evidence"]), {})


class Reader:
    """A method that reads the questions' marks without looking."""

    name = "reader"

    def answer(self, task):
        t1 = asked_frame(task.question)
        return Prediction("answered", Choice(shown_at(t1)), Evidence(t1, box_at(t1)))
