"""Measure what the methods send per question: `python tests/benchmarks/bench_usage.py [--out FOLDER]`.

It prints the file `engine/run/usage.toml`. All figures are synthetic: the simulated model answers 60 questions of a
sample. Finished runs in the output folder are kept.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow.compute as pc
from bench_agent import choose_questions, make_sample

from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.methods import METHODS
from jrdb_avr.engine.run.options import EvaluateOptions, MethodOptions, QuestionSelection, RunOptions
from jrdb_avr.queries.questions import read_question_rows
from jrdb_avr.queries.store import Store, read_table

PROFILES: Final = {
    "perfect": (),
    "realistic": (),
    "realistic with 20 % malformed replies": ("malformed=0.2",),
}
"""Settings of the simulated model. Methods with fixed stages are measured under the first alone, without retries."""

FIXED: Final = METHODS[:3]
QUESTIONS: Final = 60
PICTURE_TOKENS: Final = 256
"""Tokens of a picture at the server of the simulated model."""

HEAD: Final = f"""\
# Per question of each method: the mean, the 5 % quantile and the 95 % quantile over questions. Pictures are counted
# each time that a call sends them. Tokens of texts are a quarter of their characters.
# Synthetic: the simulated model answers {QUESTIONS} questions of a sample (tests/benchmarks/bench_usage.py), with the
# profiles {", ".join(PROFILES)}. Methods with fixed stages are
# measured with the profile perfect alone, so without retries."""


def measure(store: Store, run_id: str) -> list[dict[str, int]]:
    """Return the counts of each question of a run."""
    folder = store.run_path(run_id)
    steps = read_table(folder / "steps.parquet")
    calls = steps.filter(pc.equal(steps["kind"], "model")).select(["question_id", "request"]).to_pylist()
    measured = []
    for row in read_table(folder / "predictions.parquet").to_pylist():
        sent = [call["request"] for call in calls if call["question_id"] == row["question_id"]]
        panoramas = sum(text.count(" panorama]") for text in sent)
        pictures = sum(text.count("[image ") for text in sent)
        counts = {"calls": len(sent), "panoramas": panoramas, "crops": pictures - panoramas}
        text = row["prompt_tokens"] - PICTURE_TOKENS * pictures
        measured.append(counts | {"text_tokens": text, "reply_tokens": row["completion_tokens"]})
    return measured


def main() -> None:
    """Make the runs that are missing, and print the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("bench-usage"), help="folder of the store and the runs")
    parser.add_argument("--smallest", action="store_true", help="two questions without noise")
    given = parser.parse_args()
    out = given.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    store = Store(make_sample(out, smallest=True))
    selection = QuestionSelection(
        questions=choose_questions(read_question_rows(store), 2 if given.smallest else QUESTIONS)
    )
    print(HEAD)
    for method in METHODS:
        counts = []
        for profile, changes in list(PROFILES.items())[: 1 if method in FIXED or given.smallest else None]:
            run_id = f"{profile.replace(' ', '-').replace('%', 'percent')}-{method}-1"
            if not (store.run_path(run_id) / "predictions.parquet").exists():
                options = MethodOptions(simulate=("seed=1", *changes))
                options = EvaluateOptions(
                    selection=selection, method=options, run=RunOptions(run_id=run_id, resume=True)
                )
                evaluate(store, method, f"simulated:{profile.split()[0]}", options)
            counts += measure(store, run_id)
        print(f'\n["{method}"]')
        for name in counts[0]:
            values = np.array([row[name] for row in counts])
            low, high = np.quantile(values, (0.05, 0.95))
            print(f"{name} = [{values.mean():.1f}, {low:.1f}, {high:.1f}]", flush=True)


if __name__ == "__main__":
    main()
