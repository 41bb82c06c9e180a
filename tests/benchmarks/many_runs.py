"""Made-up runs as large as the paper's: 25 of 2,098 questions, over 27 sequences with 30 people in 900 frames.

All five answer modes, 500 evidence frames each (a million boxes), 729,000 boxes of people. Hardly any box scores, so
that each has a cause to be found. A run looks eight times at a question, and asks a model as often with a request of
two thousand letters.
"""

import json

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.report.truth import sort_by_sequence
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.panorama import crop_left
from jrdb_avr.schema.tables import INTERVALS, QUESTIONS, RUNS
from jrdb_avr.schema.templates import FAMILIES

QUESTION_COUNT, RUN_COUNT, EVIDENCE_FRAMES, SEQUENCES = 2_098, 25, 500, 27
FRAMES, PEOPLE, LOOKS, REQUEST = 900, 30, 8, 2_000
SMALLEST = {"QUESTION_COUNT": 54, "RUN_COUNT": 2, "EVIDENCE_FRAMES": 5, "FRAMES": 90, "PEOPLE": 3}
"""Sizes of the smallest form of the benchmarks that use this store, for `globals()`."""
MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")
METHODS = ("agent", "agent-no-world", "agent-passive", "agent-passive-no-world", "monolithic", "react")


def answer(mode, rng):
    """An answer's JSON."""
    frame = int(rng.integers(0, FRAMES))
    return json.dumps(
        {
            "multiple_choice": {"choice": int(rng.integers(1, 5))},
            "frame": {"frame": frame},
            "span": {"start_frame": frame, "end_frame": frame + int(rng.integers(1, 200))},
            "frame_viewpoint": {"frame": frame, "angle_deg": float(rng.uniform(0, 360))},
            "number": {"value": float(rng.uniform(1, 40))},
        }[mode]
    )


def filled(columns, schema):
    """A table of the columns; those that are not given are empty."""
    count = len(next(iter(columns.values())))
    arrays = []
    for field in schema:
        empty = None if field.nullable else "" if pa.types.is_string(field.type) else 0
        arrays.append(pa.array(columns.get(field.name, [empty] * count), field.type))
    return pa.table(arrays, schema=schema)


def made_up_questions(rng):
    """The four tables of `questions/`, by name; ids and modes are columns of `questions`."""
    ids = [f"{n:016x}" for n in range(QUESTION_COUNT)]
    templates = [list(FAMILIES)[n % len(FAMILIES)] for n in range(QUESTION_COUNT)]
    modes = rng.choice(MODES, QUESTION_COUNT).tolist()
    boxes = QUESTION_COUNT * EVIDENCE_FRAMES
    questions = {
        "question_id": ids,
        "sequence": [f"s{n % SEQUENCES:02}" for n in range(QUESTION_COUNT)],
        "family": [FAMILIES[template] for template in templates],
        "template": templates,
        "choices": [["a", "b", "c", "d"] if mode == "multiple_choice" else [] for mode in modes],
        "answer_mode": modes,
    }
    sequences = {
        "sequence": [f"s{n:02}" for n in range(SEQUENCES)],
        "fps": [15.0] * SEQUENCES,
        "frame_count": [FRAMES] * SEQUENCES,
        "frames": [[0]] * SEQUENCES,
    }
    answers = {
        "question_id": ids,
        "answer": [answer(mode, rng) for mode in modes],
        "target_track": np.arange(QUESTION_COUNT) // SEQUENCES,
        "hops": rng.integers(0, 4, QUESTION_COUNT),
        "time_gap_s": rng.uniform(0, 50, QUESTION_COUNT),
        "separation_deg": rng.uniform(0, 180, QUESTION_COUNT),
    }
    evidence = {
        "sequence": np.repeat(questions["sequence"], EVIDENCE_FRAMES),
        "track": np.repeat(answers["target_track"], EVIDENCE_FRAMES),
        "frame": np.tile(np.arange(EVIDENCE_FRAMES), QUESTION_COUNT),
        **{key: rng.uniform(10, 400, boxes) for key in "xywh"},
    }
    tables = {"questions": questions, "sequences": sequences, "answers": answers, "evidence": evidence}
    return {name: filled(columns, QUESTIONS[name]) for name, columns in tables.items()}


def made_up_predictions(questions, rng, run_id=""):
    """One run's predictions."""
    count = questions.num_rows
    columns = {
        "run_id": [run_id] * count,
        "question_id": questions["question_id"].to_pylist(),
        "status": ["answered"] * count,
        "answer": [answer(mode, rng) for mode in questions["answer_mode"].to_pylist()],
        "evidence_frame": rng.integers(0, FRAMES, count),
        **{f"evidence_{key}": rng.uniform(10, 400, count) for key in "xywh"},
        "n_observations": [LOOKS] * count,
        "n_model_calls": [LOOKS] * count,
        "prompt_tokens": [9_000] * count,
        "completion_tokens": [300] * count,
    }
    return filled(columns, RUNS["predictions"])


def made_up_steps(questions, rng, run_id):
    """One run's transcript: looks all over the panorama, and what was asked of the model."""
    looks = questions.num_rows * LOOKS
    frame, angle = rng.integers(0, EVIDENCE_FRAMES, looks).tolist(), rng.integers(0, 360, looks).tolist()
    asked = [f'{{"sequence":"s","frame_index":{f},"angle_deg":{a}.0}}' for f, a in zip(frame, angle, strict=True)]
    shown = [
        json.dumps(
            {"frame_id": f"{f:06}", "timestamp": f / 15, "angle_deg": a, "fov_deg": 45.96, "left": int(crop_left(a))}
        )
        for f, a in zip(frame, angle, strict=True)
    ]
    ids = np.repeat(questions["question_id"].to_pylist(), LOOKS).tolist()
    said = [f"{n:08}" * (REQUEST // 8) for n in range(looks)]
    columns = {
        "run_id": [run_id] * (2 * looks),
        "question_id": ids * 2,
        "kind": ["observe"] * looks + ["model"] * looks,
        "request": asked + said,
        "response": shown + ["{}"] * looks,
    }
    return filled(columns, RUNS["steps"])


def made_up_sightings(sequence, rng):
    """Everybody's boxes in a sequence."""
    count = FRAMES * PEOPLE
    columns = {
        "sequence": [sequence] * count,
        "frame": np.repeat(np.arange(FRAMES), PEOPLE),
        "track": np.tile(np.arange(PEOPLE), FRAMES),
        **{key: rng.uniform(10, 400, count) for key in "yw"},
        "x": rng.uniform(0, 3760, count),
        "h": rng.uniform(10, 400, count),
    }
    for field in INTERVALS["sightings"]:
        if pa.types.is_boolean(field.type):
            columns.setdefault(field.name, [False] * count)
    return filled(columns, INTERVALS["sightings"])


def write_runs(path, runs=None):
    """A store with the questions, everybody's boxes and the runs."""
    rng, store = np.random.default_rng(1), Store(path)
    tables = made_up_questions(rng)
    for name, table in tables.items():
        store.write_questions(name, table, {})
    for sequence in tables["sequences"]["sequence"].to_pylist():
        store.write_interval("sightings", sequence, made_up_sightings(sequence, rng))
    questions = sort_by_sequence(tables["questions"])
    for number in range(runs or RUN_COUNT):
        run_id = f"run-{number:02}"
        store.write_run(run_id, "predictions", made_up_predictions(questions, rng, run_id))
        store.write_run(run_id, "steps", made_up_steps(questions, rng, run_id))
        ids = tuple(questions["question_id"].to_pylist())
        method, model = METHODS[number % len(METHODS)], f"model {number // len(METHODS)}"
        manifest = RunManifest(run_id, method, model, questions_hash(store), ids, True, {}, "2020-01-01T00:00:00Z")
        write_run_manifest(store, manifest)
    return store
