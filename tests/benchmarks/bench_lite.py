"""Does lite order methods as the full set does? `python tests/benchmarks/bench_lite.py [--store STORE] [--smallest]`.

STORE holds questions of the profile paper, and gets the runs; without it a synthetic store is made. The simulated
model plays 20 runs of two methods, with more and more errors. Printed is Kendall's tau (b) between the orders of the
runs by combined score on lite and on the full set. Aim: 0.9.
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau

from jrdb_avr import EvaluateOptions, evaluate, generate, load, report
from jrdb_avr.engine.generate.lite import thin
from jrdb_avr.engine.run.options import MethodOptions, RunOptions
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.queries.store import Store

AIM = 0.9
METHODS = ("monolithic", "search-recognize")


def made(folder, size):
    """A synthetic store with questions of the profile paper."""
    list(write(plan(folder / "root", size, 7, "keyframes"), 2))
    store = Store(folder / "store")
    load(folder / "root", store)
    generate(store, profile="paper")
    return store


def play(store, method, errors):
    """Combined scores of a run, in the order of ids of questions."""
    settings = (f"wrong={0.06 * errors}", f"miss={0.08 * errors}", f"seed={errors}")
    run = f"{method}-{errors}"
    options = EvaluateOptions(method=MethodOptions(simulate=settings), run=RunOptions(run_id=run, resume=True))
    evaluate(store, method, "simulated:perfect", options)
    return report(store, [run]).scores.sort_by("question_id")["combined_score"].to_numpy()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--store", type=Path)
    parser.add_argument("--smallest", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        size = [(450, 15)] if given.smallest else [(900, 24)] * 10
        store = Store(given.store) if given.store else made(Path(folder), size)
        runs = [play(store, METHODS[number % 2], number // 2) for number in range(4 if given.smallest else 20)]
        questions, answers = (store.questions(name).sort_by("question_id") for name in ("questions", "answers"))
        for name in answers.column_names[1:]:
            questions = questions.append_column(name, answers[name])
        lite, _ = thin(questions, [], Counter())
        inside = np.isin(questions["question_id"].to_numpy(), lite["question_id"].to_numpy())
        full, part = (100 * np.array(runs)[:, chosen].mean(axis=1) for chosen in (slice(None), inside))
        tau = float(kendalltau(full, part).statistic)
        print(f"{len(inside)} questions, {inside.sum()} of them in lite; {len(runs)} synthetic runs")
        for number, scores in enumerate(zip(full, part, strict=True)):
            print(f"{METHODS[number % 2]:16} combined {scores[0]:5.1f}, on lite {scores[1]:5.1f}")
        print(f"Kendall's tau {tau:.3f}; aim {AIM}")
    sys.exit(int(tau < AIM and not given.smallest))


if __name__ == "__main__":
    main()
