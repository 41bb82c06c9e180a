"""Fit the profile `small-vlm` to published rows: `python tests/benchmarks/fit_small_vlm.py [--search | --smallest]`.

Everything is synthetic. The knobs are fitted to the paper's rows of Qwen3.5 9B of the methods that are no agent, over
questions of one sample in the mix in which they were generated; no agent is run. Prints what the profile gives beside
these rows, on the questions of the fit and on others; `--search` first looks for better knobs, one after the other, and
prints the best, to be written into `agent/simulated/knobs.py` by hand. Runs that are there are not made again.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

import msgspec
import pyarrow.compute as pc
from bench_agent import FULL, SMALL, code_hash, make_store

from jrdb_avr.agent.simulated.knobs import PROFILES, Knobs, settings
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.report.paper import MAIN
from jrdb_avr.engine.report.scored_runs import SCORES
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.options import EvaluateOptions, MethodOptions, QuestionSelection, RunOptions
from jrdb_avr.queries.questions import read_question_rows
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import map_sequences

SAMPLE: Final = 20
MODEL: Final = "Qwen3.5 9B"
METHODS: Final = ("monolithic", "chain-of-thought", "search-recognize", "react")
NEAR: Final = 3.0
"""Points within which a score should lie."""

STEPS: Final[dict[str, tuple[float, ...]]] = {
    "policy": (-0.1, 0.1),
    "miss": (-0.08, 0.08),
    "forget": (-0.02, 0.02),
    "wrong_box": (-0.08, 0.08),
    "coarse": (-1.5, 1.5),
    "confuse": (-0.08, 0.08),
    "please": (-0.08, 0.08),
    "wrong_attribute": (-0.06, 0.06),
}
"""Knobs that are fitted, and the changes that are tried."""

Row = tuple[float, ...]
"""Answer, evidence and combined in percent."""

PUBLISHED: Final[dict[str, Row]] = {
    row.method: (row.answer, row.evidence, row.combined) for row in MAIN if row.model == MODEL and row.method in METHODS
}


@dataclass(frozen=True)
class Job:
    """One method with knobs on questions."""

    store: Path
    method: str
    knobs: Knobs
    questions: tuple[str, ...]

    def row(self) -> Row:
        """The scores of its run, which is made where it is not there."""
        about = hashlib.sha256(repr((settings(self.knobs), self.questions)).encode()).hexdigest()[:10]
        run_id, store = f"fit-{self.method}-{about}-{code_hash(self.method)}", Store(self.store)
        if not (store.run_path(run_id) / "predictions.parquet").exists():
            options = EvaluateOptions(
                selection=QuestionSelection(questions=self.questions),
                method=MethodOptions(marker=self.knobs),
                run=RunOptions(run_id=run_id, resume=True),
            )
            evaluate(store, self.method, "simulated", options)
        scores = report(store, [run_id]).scores
        return tuple(100 * pc.mean(scores[f"{name}_score"]).as_py() for name in SCORES)


def rows(store: Path, knobs: Knobs, questions: tuple[str, ...]) -> dict[str, Row]:
    """The scores of every method."""
    jobs = [Job(store, method, knobs, questions) for method in METHODS]
    return {
        jobs[place].method: row for place, row in map_sequences(Job.row, jobs, 2, lambda job: job.method == "react")
    }


def misfit(found: dict[str, Row]) -> float:
    """The sum of squared differences to the published rows; those beyond the bound count four times."""
    off = [abs(one - other) for name in METHODS for one, other in zip(found[name], PUBLISHED[name], strict=True)]
    return sum(one**2 * (4 if one > NEAR else 1) for one in off)


def search(store: Path, knobs: Knobs, questions: tuple[str, ...], sweeps: int) -> Knobs:
    """Better knobs, found by changing one after the other as long as that fits better."""
    best, least = knobs, misfit(rows(store, knobs, questions))
    for _ in range(sweeps):
        before = best
        for name, step in ((name, step) for name, steps in STEPS.items() for step in steps):
            value = round(getattr(best, name) + step, 3)
            if not 0 <= value <= (1 if name != "coarse" else 1000):
                continue
            tried = msgspec.structs.replace(best, **{name: value})
            found = misfit(rows(store, tried, questions))
            print(f"{name}={value:g}: {found:.0f}{', better' if found < least else ''}", flush=True)
            if found < least:
                best, least = tried, found
        if best == before:
            break
    return best


def print_fit(found: dict[str, Row], title: str) -> None:
    """Print the scores beside the published ones."""
    print(f"\n{title}: simulated (synthetic), published, difference in points")
    far = 0
    for name, place in product(METHODS, range(len(SCORES))):
        one, other = found[name][place], PUBLISHED[name][place]
        far += abs(one - other) > NEAR
        mark = "  beyond" if abs(one - other) > NEAR else ""
        print(f"{name if place == 0 else '':<18}{SCORES[place]:<10}{one:>6.1f}{other:>7.1f}{one - other:>+7.1f}{mark}")
    print(f"{far} of {len(METHODS) * len(SCORES)} differ by more than {NEAR:g} points")


def mixed(store: Path) -> tuple[str, ...]:
    """All questions in an order that mixes their templates as they were generated."""
    return tuple(sorted(question.question_id for question in read_question_rows(Store(store))))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--search", action="store_true", help="look for better knobs first")
    parser.add_argument("--smallest", action="store_true", help="two questions each of a small sample")
    parser.add_argument("--sweeps", type=int, default=2, help="how often the search goes through the knobs")
    parser.add_argument("--questions", type=int, default=268, help="of the fit; of the others, as many")
    parser.add_argument("--out", type=Path, default=Path("bench-agent"), help="folder of the sample, store and runs")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    if given.smallest:
        given.questions = 2
    store = make_store(given.out.resolve(), SAMPLE, SMALL if given.smallest else FULL)
    every = mixed(store)
    fitted, others = every[: given.questions], every[given.questions : 2 * given.questions]
    knobs = PROFILES["small-vlm"]
    if given.search:
        knobs = search(store, knobs, fitted, given.sweeps)
    print("knobs:", " ".join(settings(knobs)))
    print_fit(rows(store, knobs, fitted), f"{len(fitted)} questions of the fit")
    print_fit(rows(store, knobs, others), f"{len(others)} other questions")


if __name__ == "__main__":
    main()
