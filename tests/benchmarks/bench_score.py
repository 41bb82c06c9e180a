"""Scoring: `python tests/benchmarks/bench_score.py`. Prints seconds for 25 runs of 2,098 predictions (bar: 2 s).

The questions are made up (all five modes, 500 evidence frames each: a million boxes); the work is what `score` does
between reading and writing its files, and the reading of the four tables apart.
"""

import json
import time

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.scoring import make_truth, score_predictions
from jrdb_avr.schema.tables import QUESTIONS

QUESTION_COUNT, RUN_COUNT, EVIDENCE_FRAMES = 2_098, 25, 500
MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")


def answer(mode, rng):
    frame = int(rng.integers(0, 900))
    return json.dumps(
        {
            "multiple_choice": {"choice": int(rng.integers(1, 5))},
            "frame": {"frame": frame},
            "span": {"start_frame": frame, "end_frame": frame + int(rng.integers(1, 200))},
            "frame_viewpoint": {"frame": frame, "angle_deg": float(rng.uniform(0, 360))},
            "number": {"value": float(rng.uniform(1, 40))},
        }[mode]
    )


def main() -> None:
    rng = np.random.default_rng(1)
    ids = [f"{n:016x}" for n in range(QUESTION_COUNT)]
    modes = rng.choice(MODES, QUESTION_COUNT).tolist()
    rows = [
        {"question_id": name, "sequence": f"s{n % 27}", "family": "", "template": "", "question": "", "choices": []}
        | {"answer_mode": mode}
        for n, (name, mode) in enumerate(zip(ids, modes, strict=True))
    ]
    questions = pa.Table.from_pylist(rows, schema=QUESTIONS["questions"])
    sequences = pa.Table.from_pylist(
        [{"sequence": f"s{n}", "fps": 15.0, "frame_count": 900, "frames": [0]} for n in range(27)],
        schema=QUESTIONS["sequences"],
    )
    answers = pa.table({"question_id": ids, "answer": [answer(mode, rng) for mode in modes]})
    boxes = QUESTION_COUNT * EVIDENCE_FRAMES
    evidence = pa.table(
        {
            "question_id": np.repeat(ids, EVIDENCE_FRAMES),
            "frame": pa.array(np.tile(np.arange(EVIDENCE_FRAMES), QUESTION_COUNT), pa.int32()),
            **{key: rng.uniform(10, 400, boxes) for key in "xywh"},
        }
    )
    runs = [
        pa.table(
            {
                "question_id": ids,
                "status": ["answered"] * QUESTION_COUNT,
                "answer": [answer(mode, rng) for mode in modes],
                "evidence_frame": pa.array(rng.integers(0, 900, QUESTION_COUNT), pa.int32()),
                **{f"evidence_{key}": rng.uniform(10, 400, QUESTION_COUNT) for key in "xywh"},
            }
        )
        for _ in range(RUN_COUNT)
    ]
    start = time.perf_counter()
    truth = make_truth(questions, sequences, answers, evidence)
    prepared = time.perf_counter()
    for number, predictions in enumerate(runs):
        score_predictions(truth, f"r{number}", ids, predictions)
    end = time.perf_counter()
    print(
        f"{RUN_COUNT} runs x {QUESTION_COUNT}: {end - start:.2f} s in all (bar 2), {prepared - start:.2f} s of it once"
    )


if __name__ == "__main__":
    main()
