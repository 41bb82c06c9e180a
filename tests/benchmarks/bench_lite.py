"""Does lite order methods as the full set does? `python tests/benchmarks/bench_lite.py [--store STORE] [--smallest]`.

STORE holds questions of the profile paper, and gets a run; without it a synthetic one is made. The 20 runs are DRAWN,
not measured: one run of the simulated model is measured. A drawn run has a question right with the odds that the
measured run had on the question's template, times e to the strength of the drawn run (-2 to 2). Printed is Kendall's
tau (b) between the orders of the 20 runs by combined score on lite and on the full set, for ten draws. Aim: 0.9.
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
from scipy.stats import kendalltau

from jrdb_avr import EvaluateOptions, evaluate, generate, load, report
from jrdb_avr.engine.generate.lite import thin
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.queries.store import Store

RUNS, AIM, DRAWS = 20, 0.9, 10


def made(folder, size):
    """A synthetic store with questions of the profile paper."""
    list(write(plan(folder / "root", size, 7, "keyframes"), 2))
    store = Store(folder / "store")
    load(folder / "root", store)
    generate(store, profile="paper")
    return store


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--store", type=Path)
    parser.add_argument("--smallest", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        size = [(450, 15)] if given.smallest else [(900, 24)] * 10
        store = Store(given.store) if given.store else made(Path(folder), size)
        result = evaluate(store, "monolithic", "simulated", EvaluateOptions())
        scores = report(store, [result.run_id]).scores.sort_by("question_id")
        questions, answers = (store.questions(name).sort_by("question_id") for name in ("questions", "answers"))
        for name in answers.column_names[1:]:
            questions = questions.append_column(name, answers[name])
        scores = scores.append_column("template", questions["template"])
        lite, _ = thin(questions, [], Counter())
        inside = pc.is_in(scores["question_id"], lite["question_id"].combine_chunks()).to_numpy()
        means = scores.group_by("template").aggregate([("combined_score", "mean")]).to_pydict().values()
        chances = np.clip([*map(dict(zip(*means, strict=True)).get, scores["template"].to_pylist())], 0.02, 0.98)
        print(f"{len(inside)} questions, {inside.sum()} of them in lite; {RUNS} drawn runs, {DRAWS} times")
        taus = []
        for seed in range(DRAWS):
            rng = np.random.default_rng(seed)
            odds = chances / (1 - chances) * np.exp(np.linspace(-2, 2, RUNS))[:, None]
            runs = rng.random(odds.shape) < odds / (1 + odds)
            taus.append(kendalltau([run.mean() for run in runs], [run[inside].mean() for run in runs]).statistic)
        print("combined on the full set in the last draw, in percent:", *(f"{100 * run.mean():.0f}" for run in runs))
        print(f"Kendall's tau {np.mean(taus):.3f} (lowest {min(taus):.3f}, highest {max(taus):.3f}); aim {AIM}")
    sys.exit(int(np.mean(taus) < AIM and not given.smallest))


if __name__ == "__main__":
    main()
