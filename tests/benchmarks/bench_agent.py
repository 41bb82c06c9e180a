"""Compare the reference agent with other methods: `python tests/benchmarks/bench_agent.py [ROOT] [options]`.

All figures are synthetic: the simulated model answers. ROOT is a folder of annotations in JRDB's layout, or a store
with questions. The benchmark takes 300 questions from ROOT and 100 questions of a sample, in turn from each template
and sequence. Without ROOT, it takes the questions of the sample only. Each finished run is kept in the output folder.
So a stopped benchmark continues. A whole comparison takes about two CPU hours.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Final, NamedTuple
from unittest import mock

import msgspec
import numpy as np
import pyarrow.compute as pc

from jrdb_avr.agent.model.messages import Message
from jrdb_avr.agent.reference.turns import Turn
from jrdb_avr.agent.reference.world_memory import WorldMemory
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.report.bootstrap import intervals, mean_ratio
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.options import EvaluateOptions, MethodOptions, QuestionSelection, RunOptions
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.queries.questions import QuestionRow, read_question_rows
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.queries.workers import map_sequences
from jrdb_avr.schema.beliefs import Fact
from jrdb_avr.schema.panorama import WIDTH, Box, iou

PROFILES: Final = ("perfect", "independent", "lasting", "realistic")
RIVALS: Final = ("react", "agent-no-world")
PASSIVE: Final = ("agent-passive", "agent-passive-no-world")
VARIANTS: Final = ("advice off", "advice early", "identity perfect")
"""Variants of the agent, which run under the last profile only."""

SAMPLE_SEED: Final = 61
"""Seed of the sample. No constant of the agent was chosen on this sample."""


class Case(NamedTuple):
    """One method in one variant under one profile of the simulated model."""

    profile: str
    method: str
    variant: str = ""


@dataclass(frozen=True)
class Run:
    """One run to make: a case on the questions of a store with one noise seed."""

    store: Path
    questions: tuple[str, ...]
    case: Case
    seed: int

    @property
    def run_id(self) -> str:
        """Name of the run."""
        return "-".join((*filter(None, self.case), str(self.seed))).replace(" ", "-")

    @property
    def done(self) -> bool:
        """Whether the run is finished."""
        return (Store(self.store).run_path(self.run_id) / "predictions.parquet").exists()


def choose_questions(rows: Iterable[QuestionRow], count: int) -> tuple[str, ...]:
    """Return the ids of `count` questions, taken in turn from each sequence and template in a fixed order."""
    strata: dict[tuple[str, str], list[str]] = defaultdict(list)
    for row in rows:
        strata[row.template, row.sequence].append(row.question_id)
    rounds = zip_longest(*(sorted(ids) for _, ids in sorted(strata.items())))
    return tuple(question for ids in rounds for question in ids if question is not None)[:count]


def make_sample(out: Path, smallest: bool) -> Path:
    """Return the store of the sample with its questions. Make the store if it is missing."""
    root, store = out / "sample", out / "sample-store"
    if not (store / "questions" / "answers.parquet").exists():
        frames, people, sequences = (300, 12, 2) if smallest else (600, 18, 5)
        if not (root / "labels").exists():
            list(write(plan(root, [(frames, people)] * sequences, SAMPLE_SEED, images="none"), 2))
        load(root, store)
        generate(store)
    return store


def make_store(root: Path, out: Path) -> Path:
    """Return the store of the annotations in `root`, or `root` itself if it is a store."""
    if (root / "questions" / "answers.parquet").exists():
        return root.resolve()
    store = out / "root-store"
    if not (store / "questions" / "answers.parquet").exists():
        load(root, store)
        generate(store)
    return store


def make_run(run: Run) -> None:
    """Make a run, or continue it."""
    variant = run.case.variant
    simulate = (f"seed={run.seed}", *(("identity=0",) if variant == "identity perfect" else ()))
    options = EvaluateOptions(
        selection=QuestionSelection(questions=run.questions),
        method=MethodOptions(simulate=simulate, advice="off" if variant == "advice off" else "on"),
        run=RunOptions(run_id=run.run_id, resume=True),
    )
    with early_advice() if variant == "advice early" else contextlib.nullcontext():
        evaluate(Store(run.store), run.case.method, f"simulated:{run.case.profile}", options)


@contextlib.contextmanager
def early_advice() -> Iterator[None]:
    """Let the agent look at what the graph advised before the newest writes, inside the `with` block."""
    messages, advised = WorldMemory.messages, {}

    def show(memory: WorldMemory, turn: Turn) -> list[Message]:
        advised[id(memory)] = memory.advised_looks(turn.looks[1])
        return messages(memory, turn)

    with (
        mock.patch.object(WorldMemory, "messages", show),
        mock.patch.object(WorldMemory, "due_looks", lambda memory, left: advised.get(id(memory), ())[:1]),
    ):
        yield


class Measured(NamedTuple):
    """Results of one case over all stores and seeds.

    combined: the mean combined score of each question over the seeds. sequence: the sequence of each question. certain:
    the number of certain verdicts and the number of these whose prediction is right. figures: means per question.
    """

    combined: dict[str, float]
    sequence: dict[str, str]
    certain: tuple[int, int]
    figures: dict[str, float]


def measure(runs: Sequence[Run]) -> Measured:
    """Return the results of the runs of one case."""
    combined: dict[str, list[float]] = defaultdict(list)
    sequence: dict[str, str] = {}
    sums: dict[str, float] = defaultdict(float)
    certain, right, count = 0, 0, 0
    for run in runs:
        store = Store(run.store)
        sequences = {row.question_id: row.sequence for row in read_question_rows(store)}
        predictions = read_table(store.run_path(run.run_id) / "predictions.parquet")
        verdicts = dict(zip(predictions["question_id"].to_pylist(), predictions["verdict"].to_pylist(), strict=True))
        for score in report(store, [run.run_id]).scores.to_pylist():
            question = score["question_id"]
            key = f"{run.store.name}/{question}"
            combined[key].append(score["combined_score"])
            sequence[key] = f"{run.store.name}/{sequences[question]}"
            certain += verdicts[question] == "certain"
            right += verdicts[question] == "certain" and score["combined_score"] == 1
            for part in ("answer", "evidence", "combined"):
                sums[part] += 100 * score[f"{part}_score"]
        for column in ("n_model_calls", "n_observations", "prompt_tokens"):
            sums[column] += pc.sum(predictions[column]).as_py() or 0
        count += len(predictions)
    means = {question: float(np.mean(scores)) for question, scores in combined.items()}
    return Measured(
        means, sequence, (certain, right), {name: total / count for name, total in sums.items()} | {"n": count}
    )


def count_pairs(run: Run) -> tuple[int, int, int]:
    """Count pairs of readings of a question: rightly one person, read as one entity, and truly one person.

    A reading is of the labelled person with the largest overlap. Readings without an IoU of 0.5 do not count.
    """
    store = Store(run.store)
    sequences = {row.question_id: row.sequence for row in read_question_rows(store)}
    boxes: dict[tuple[str, int], dict[int, Box]] = defaultdict(dict)
    for sequence in {sequences[question] for question in run.questions}:
        for row in store.interval("sightings", sequence, ["frame", "track", "x", "y", "w", "h"]).to_pylist():
            boxes[sequence, row["frame"]][row["track"]] = Box(row["x"], row["y"], row["w"], row["h"])
    readings: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for row in read_table(store.run_path(run.run_id) / "world.parquet").to_pylist():
        fact = msgspec.json.decode(row["fact"], type=Fact) if row["fact"] else Fact()
        for sighting in fact.sighted:
            people = boxes.get((sequences[row["question_id"]], sighting.frame), {})
            shares = {track: iou(_beside(sighting.box, box), box) for track, box in people.items()}
            track = max(shares, key=shares.__getitem__, default=None)
            if track is not None and shares[track] >= 0.5:
                readings[row["question_id"]].append((sighting.source, track))
    pairs = [pair for found in readings.values() for pair in itertools.combinations(found, 2)]
    one = [(first[0] == second[0], first[1] == second[1]) for first, second in pairs]
    return sum(a and b for a, b in one), sum(a for a, _ in one), sum(b for _, b in one)


def _beside(box: Box, other: Box) -> Box:
    """Return a box moved by whole panoramas to be nearest to another box."""
    return box._replace(x=box.x - WIDTH * round((box.x - other.x) / WIDTH))


def compare(first: Measured, second: Measured) -> tuple[float, float, float]:
    """Return the difference of combined in points, first minus second, with its interval over whole sequences."""
    clusters: dict[str, list[float]] = defaultdict(list)
    for question, score in first.combined.items():
        clusters[first.sequence[question]].append(100 * (score - second.combined[question]))
    sums = np.array([[sum(differences), len(differences)] for _, differences in sorted(clusters.items())], dtype=float)
    (interval,) = intervals(sums, [mean_ratio((0, 1))])
    return interval.value or 0.0, interval.low or 0.0, interval.high or 0.0


def print_figures(results: dict[Case, Measured]) -> None:
    """Print the scores, the cost and the certain verdicts of each case."""
    head = ("profile", "method", "answer", "evidence", "combined", "calls", "looks", "tokens", "certain", "right")
    print("{:<12}{:<34}{:>8}{:>9}{:>9}{:>7}{:>7}{:>8}{:>9}{:>7}".format(*head))
    for case, measured in results.items():
        figures, (certain, right) = measured.figures, measured.certain
        name = f"{case.method}, {case.variant}" if case.variant else case.method
        print(
            f"{case.profile:<12}{name:<34}{figures['answer']:>8.1f}{figures['evidence']:>9.1f}"
            f"{figures['combined']:>9.1f}{figures['n_model_calls']:>7.1f}{figures['n_observations']:>7.1f}"
            f"{figures['prompt_tokens']:>8.0f}{100 * certain / figures['n']:>8.1f}%"
            + (f"{100 * right / certain:>6.1f}%" if certain else f"{'-':>7}")
        )


def print_differences(results: dict[Case, Measured]) -> None:
    """Print the paired differences of combined with their intervals."""
    pairs = [(Case(profile, "agent"), Case(profile, rival)) for profile in PROFILES for rival in RIVALS]
    last = PROFILES[-1]
    pairs += [(Case(last, "agent"), Case(last, "agent", variant)) for variant in VARIANTS]
    pairs += [(Case(last, "agent-passive"), Case(last, "agent-passive-no-world"))]
    for first, second in pairs:
        if first in results and second in results:
            value, low, high = compare(results[first], results[second])
            names = " - ".join(" ".join(filter(None, case[1:])) for case in (first, second))
            print(f"{first.profile:<12}{names:<50}{value:>+7.1f} [{low:+.1f}, {high:+.1f}]")


def parse() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path, nargs="?", help="annotations in JRDB's layout, or a store with questions")
    parser.add_argument("--out", type=Path, default=Path("bench-agent"), help="folder of stores and runs")
    parser.add_argument("--json", type=Path, help="write all figures to this file")
    parser.add_argument("--questions", type=int, nargs=2, default=(300, 100), help="questions of ROOT, of the sample")
    parser.add_argument("--profiles", default=",".join(PROFILES), help="profiles to run, separated by commas")
    parser.add_argument("--seeds", type=int, default=2, help="number of noise seeds")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="runs at a time")
    parser.add_argument("--smallest", action="store_true", help="two questions of two methods without noise")
    return parser.parse_args()


def main() -> None:
    """Make the runs that are missing and print all tables."""
    given = parse()
    given.out.mkdir(parents=True, exist_ok=True)
    out = given.out.resolve()
    sample = make_sample(out, given.smallest)
    chosen = {sample: choose_questions(read_question_rows(Store(sample)), 2 if given.smallest else given.questions[1])}
    if given.root is not None:
        store = make_store(given.root, out)
        chosen[store] = choose_questions(read_question_rows(Store(store)), given.questions[0])
    profiles = ["perfect"] if given.smallest else given.profiles.split(",")
    cases = [Case(profile, method) for profile in profiles for method in ("agent", *RIVALS)]
    if PROFILES[-1] in profiles:
        cases += [Case(PROFILES[-1], "agent", variant) for variant in VARIANTS]
        cases += [Case(PROFILES[-1], method) for method in PASSIVE]
    runs = [
        Run(store, questions, case, seed)
        for case in cases
        for seed in range(1, (1 if case.profile == "perfect" else given.seeds) + 1)
        for store, questions in chosen.items()
    ]
    due = [run for run in runs if not run.done]
    print(f"{len(runs)} runs, {len(runs) - len(due)} of them are finished", flush=True)
    for done, (index, _) in enumerate(map_sequences(make_run, due, given.workers, lambda run: len(run.questions)), 1):
        print(f"{done} of {len(due)}: {due[index].store.name} {due[index].run_id}", flush=True)
    results = {case: measure([run for run in runs if run.case == case]) for case in cases}
    for profile in profiles:
        agents = [run for run in runs if run.case == Case(profile, "agent")]
        right, together, true = (sum(counts) for counts in zip(*map(count_pairs, agents), strict=True))
        print(f"{profile}: F1 of association over pairs of readings {2 * right / max(together + true, 1):.3f}")
    print("\nSynthetic: the simulated model. Scores in percent; calls, looks and prompt tokens per question.")
    print_figures(results)
    print("\nDifferences of combined in points, with 95 % intervals over sequences.")
    print_differences(results)
    if given.json is not None:
        figures = [
            {**case._asdict(), **measured.figures, "certain": measured.certain} for case, measured in results.items()
        ]
        given.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    # Worker processes do not import the main module, so they find `make_run` under the name of this file.
    import bench_agent

    bench_agent.main()
