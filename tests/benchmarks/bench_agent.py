"""The agent beside other methods: `python tests/benchmarks/bench_agent.py [--full | --smallest] [--out FOLDER]`.

Everything is synthetic: the simulated model on samples. Makes a sample and its questions for each seed, runs the
methods under settings of noise, and prints scores, cost, and each bound of `agent_bounds.py` with what was measured.
Without `--full` one small sample, one noise seed and a few settings; with it four samples that no agent was tuned on,
three noise seeds and all settings.

Runs are kept in FOLDER and not made again, so that a stopped benchmark goes on where it was. A run is of the program's
code (see `code_hash`): what has changed is measured anew.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, zip_longest
from pathlib import Path
from typing import Final

import msgspec
import pyarrow.compute as pc
from agent_bounds import (
    AGENT,
    CONTROL,
    NO_WORLD,
    PASSIVE,
    PASSIVE_NO_WORLD,
    REACT,
    Measured,
    print_ablation,
    print_bounds,
    print_figures,
)

import jrdb_avr
from jrdb_avr.agent.simulated.knobs import PROFILES, Knobs
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.methods import default_policy
from jrdb_avr.engine.run.options import EvaluateOptions, MethodOptions, QuestionSelection, RunOptions
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.queries.questions import read_question_rows
from jrdb_avr.queries.store import Store, read_table
from jrdb_avr.queries.workers import map_sequences
from jrdb_avr.schema.panorama import CROP, WIDTH, Box, iou

METHODS: Final = (AGENT, CONTROL, "agent model", NO_WORLD, REACT, PASSIVE, PASSIVE_NO_WORLD)
"""The methods, each by its name, and by a policy where that is not the method's own."""


def noise(share: float, **more: float) -> Knobs:
    """The knobs of a noise: attributes and boxes are wrong as often, a fifth as many replies malformed."""
    return Knobs(wrong_attribute=share, wrong_box=share, malformed=share / 5, **more)


SETTINGS: Final = {
    "perfect": Knobs(),
    "noise-0.05": noise(0.05),
    "noise-0.1": noise(0.1),
    "noise-0.2": noise(0.2),
    "correlated": noise(0.1, correlated=0.6),
    "ids-off": noise(0.1, ids=False),
    "small-vlm": PROFILES["small-vlm"],
}

SMALL, FULL = (300, 14, 2), (600, 18, 3)
"""Frames, people and sequences of a sample."""


@dataclass(frozen=True)
class Run:
    """One run to make: a method on the chosen questions of a store."""

    store: Path
    setting: str
    knobs: Knobs
    method: str
    questions: tuple[str, ...]
    seed: int

    @property
    def run_id(self) -> str:
        """The same for the same setting, seed, method, questions and code."""
        chosen = hashlib.sha256("".join(self.questions).encode()).hexdigest()[:4]
        name = f"{self.setting}-{self.seed}-{self.method}-{chosen}-{code_hash(self.method)}"
        return name.replace(".", "").replace(" ", "-")

    @property
    def path(self) -> Path:
        return Store(self.store).run_path(self.run_id)

    @property
    def done(self) -> bool:
        path = self.path / "predictions.parquet"
        return path.exists() and "error" not in read_table(path)["status"].to_pylist()


def driven(method: str) -> bool:
    """Whether the harness finds the looks of a method."""
    name, _, policy = method.partition(" ")
    return (policy or default_policy(name)) != "model"


@functools.cache
def code_hash(method: str) -> str:
    """A hash of the sources of `agent/` at the start; those of the harness that looks count for its methods alone."""
    root = Path(jrdb_avr.__file__).parent / "agent"
    own = (
        "perception/",
        "reference/belief_writer.py",
        "reference/driven.py",
        "reference/guided.py",
        "reference/perceive.py",
        "reference/recognize.py",
    )
    found = hashlib.sha256()
    for path in sorted(root.rglob("*.*")):
        name = path.relative_to(root).as_posix()
        if path.suffix in (".py", ".md") and (driven(method) or not name.startswith(own)):
            found.update(name.encode() + path.read_bytes())
    return found.hexdigest()[:6]


def make_store(out: Path, seed: int, size: tuple[int, int, int]) -> Path:
    """A store with the questions of a new sample; made once."""
    frames, people, sequences = size
    name = f"sample-{seed}-{sequences}x{frames}x{people}"
    store = out / f"{name}-store"
    if not (store / "questions" / "answers.parquet").exists():
        if not (out / name / "labels").exists():
            list(write(plan(out / name, [(frames, people)] * sequences, seed, images="changes"), 2))
        load(out / name, store)
        generate(store)
    return store


def choose(store: Path, count: int) -> tuple[str, ...]:
    """Ids of questions: one of each template in turn, until there are so many."""
    by_template: dict[str, list[str]] = defaultdict(list)
    for question in read_question_rows(Store(store)):
        by_template[question.template].append(question.question_id)
    rounds = zip_longest(*(sorted(own) for _, own in sorted(by_template.items())))
    return tuple(name for own in rounds for name in own if name is not None)[:count]


def make_run(run: Run) -> None:
    """Make a run, or finish it."""
    method, _, policy = run.method.partition(" ")
    run.path.mkdir(parents=True, exist_ok=True)
    world = run.path / "world.kuzu" if method in ("agent", "agent-passive") else None
    marker = msgspec.structs.replace(run.knobs, seed=run.seed)
    options = EvaluateOptions(
        selection=QuestionSelection(questions=run.questions),
        method=MethodOptions(policy=policy or None, marker=marker),
        run=RunOptions(run_id=run.run_id, resume=True, world_db=world),
    )
    evaluate(Store(run.store), method, "simulated", options)
    if world is not None:
        # The run's own tables hold all of it.
        for path in run.path.glob("world.kuzu*"):
            path.unlink()


def measure(runs: Sequence[Run]) -> Measured:
    """What the runs of one method in one setting show together."""
    scores: dict[str, list[tuple[float, float, float]]] = defaultdict(list)
    certain, choices, pairs, calls, tokens, asked = [0, 0], [0, 0], [0, 0, 0], 0, 0, 0
    for run in runs:
        store = Store(run.store)
        modes = {question.question_id: question.answer_mode for question in read_question_rows(store)}
        scored = report(store, [run.run_id]).scores
        predictions = read_table(store.run_path(run.run_id) / "predictions.parquet")
        rows = {row["question_id"]: row for row in predictions.to_pylist()}
        for own in scored.to_pylist():
            name, row = own["question_id"], rows[own["question_id"]]
            scores[f"{run.store.name}/{name}"].append(
                tuple(own[f"{part}_score"] for part in ("answer", "evidence", "combined"))
            )
            if row["verdict"] == "certain":
                certain = [certain[0] + own["combined_score"], certain[1] + 1]
            if modes[name] == "multiple_choice":
                choices = [choices[0] + (row["answer"] is not None), choices[1] + 1]
        asked += len(rows)
        calls += pc.sum(predictions["n_model_calls"]).as_py()
        tokens += pc.sum(predictions["prompt_tokens"]).as_py() or 0
        if run.method == AGENT:
            pairs = [sum(both) for both in zip(pairs, associated_pairs(run), strict=True)]
    means = {name: tuple(sum(part) / len(own) for part in zip(*own, strict=True)) for name, own in scores.items()}
    found = tuple(pairs) if pairs[2] else None
    return Measured(means, tuple(certain), tuple(choices), calls / asked, tokens / asked, found)


# -- association ------------------------------------------------------------------------------------------------------


def associated_pairs(run: Run) -> tuple[int, int, int]:
    """Pairs of readings of one question: rightly of one person, taken for one, and truly of one.

    A reading is of the labelled person whose box, as far as the look shows it, overlaps the written one best; those
    that overlap nobody's by half are left out.
    """
    store = Store(run.store)
    where = {question.question_id: question.sequence for question in read_question_rows(store)}
    table = read_table(run.path / "world.parquet")
    people = {
        sequence: _boxes_by_frame(store, sequence)
        for sequence in {where[name] for name in set(run.questions) & set(where)}
    }
    seen: dict[str, tuple[int, int]] = {}
    readings: dict[str, list[tuple[str, int]]] = defaultdict(list)
    for row in table.filter(pc.field("accepted")).to_pylist():
        question, call = row["question_id"], json.loads(row["arguments"])
        if row["tool"] == "observe":
            fact = json.loads(row["fact"])["observation"]
            seen[f"{question}/o{fact['number']}"] = fact["frame"], fact["left"]
        elif row["tool"] == "add_entity" and "node" not in call:
            frame, left = seen[f"{question}/{call['observation']}"]
            person = _person(Box(*map(float, call["box"])), left, people[where[question]].get(frame, {}))
            if person is not None:
                readings[question].append((call["id"], person))
    right = taken = true = 0
    for own in readings.values():
        for (one, person), (other, other_person) in combinations(own, 2):
            taken += one == other
            true += person == other_person
            right += one == other and person == other_person
    return right, taken, true


def _boxes_by_frame(store: Store, sequence: str) -> dict[int, dict[int, Box]]:
    found: dict[int, dict[int, Box]] = defaultdict(dict)
    table = store.interval("sightings", sequence, ["frame", "track", "x", "y", "w", "h"])
    for row in table.to_pylist():
        found[row["frame"]][row["track"]] = Box(row["x"], row["y"], row["w"], row["h"])
    return found


def _person(box: Box, left: int, people: dict[int, Box]) -> int | None:
    """Who of the people of a frame a box of a look from the column `left` is of."""
    shares = {}
    for who, whole in people.items():
        start = (whole.x + whole.w / 2 - left - CROP / 2 + WIDTH / 2) % WIDTH - WIDTH / 2 + CROP / 2 - whole.w / 2
        first, last = max(start, 0.0), min(start + whole.w, float(CROP))
        if last > first:
            shares[who] = iou(box, Box(first, whole.y, last - first, whole.h))
    best = max(shares, key=shares.__getitem__, default=None)
    return best if best is not None and shares[best] >= 0.5 else None


# -- the command ------------------------------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="four samples, three noise seeds, all settings")
    parser.add_argument("--smallest", action="store_true", help="two questions of two methods, without noise")
    parser.add_argument("--samples", help="seeds of samples, with commas between; 20, or 21 to 24 with --full")
    parser.add_argument("--questions", type=int, help="most questions of each sample; 48, or 120 with --full")
    parser.add_argument("--seeds", type=int, help="noise seeds of each noisy setting; 1, or 3 with --full")
    parser.add_argument("--settings", help=f"of {','.join(SETTINGS)}; without --full, those with bounds")
    parser.add_argument("--methods", default=",".join(METHODS), help=f"of {','.join(METHODS)}")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="runs at a time")
    parser.add_argument("--out", type=Path, default=Path("bench-agent"), help="folder of samples, stores and runs")
    given = parser.parse_args()
    if given.smallest:
        given.questions, given.settings, given.methods = 2, "perfect", f"{AGENT},{REACT}"
    few = ("perfect", "noise-0.1", "correlated", "ids-off")
    settings = given.settings.split(",") if given.settings else list(SETTINGS) if given.full else few
    samples = [int(seed) for seed in (given.samples or ("21,22,23,24" if given.full else "20")).split(",")]
    seeds, count = given.seeds or (3 if given.full else 1), given.questions or (120 if given.full else 48)
    given.out.mkdir(parents=True, exist_ok=True)
    runs = []
    for sample in samples:
        store = make_store(given.out.resolve(), sample, FULL if given.full else SMALL)
        chosen = choose(store, count)
        print(f"sample {sample}: {len(chosen)} questions", flush=True)
        runs += [
            Run(store, setting, SETTINGS[setting], method, chosen, seed)
            for setting in settings
            for method in given.methods.split(",")
            for seed in range(1, 1 + (1 if setting == "perfect" else seeds))
        ]
    due = [run for run in runs if not run.done]
    print(f"{len(runs)} runs, {len(runs) - len(due)} of them are there", flush=True)
    for done, (number, _) in enumerate(map_sequences(make_run, due, given.workers, lambda run: driven(run.method)), 1):
        print(f"{done} of {len(due)}: {due[number].run_id}", flush=True)
    cells: dict[tuple[str, str], list[Run]] = defaultdict(list)
    for run in runs:
        cells[run.setting, run.method].append(run)
    measured = {cell: measure(own) for cell, own in cells.items()}
    print("\nSynthetic: the simulated model on samples; shares in percent, calls and prompt tokens per question")
    print_figures(measured)
    print("\nPaired differences in points with 95 % intervals, and the bounds")
    print_bounds(measured)
    if "small-vlm" in settings:
        print()
        print_ablation(measured, "small-vlm")


if __name__ == "__main__":
    main()
