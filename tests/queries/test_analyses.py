"""The named analyses of `queries/results/` against plain Python over the same rows."""

import json
import random
from collections import Counter, defaultdict

import msgspec
import pytest
from scored_runs import BOX, ELSEWHERE, Benchmark, table

from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.report.scoring import score_predictions
from jrdb_avr.queries.runs import questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.tables import INTERVALS, RUNS

FAMILIES = ("chain_2hop", "chain_fork_join", "chain_hybrid", "long_range", "unique_anchor")
RUN_IDS = {"one": "agent", "two": "agent-passive", "three": "react"}
"""Runs with their methods; three questions of the third ended in an error."""


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A store with sixty-four questions and three runs; and its predictions, scores and questions as dicts."""
    generator = random.Random(3)
    asked = [(f"q{i:02}", f"s{i % 3}", FAMILIES[i % 7 % 5]) for i in range(64)]
    benchmark, store = Benchmark(asked), Store(tmp_path_factory.mktemp("analyses"))
    questions = benchmark.tables["questions"].to_pylist()
    for row in questions:
        row["choices"] = ["sitting", "standing", "walking", "bending"]
    benchmark.tables["questions"] = table(questions, benchmark.tables["questions"].schema)
    benchmark.write(store)
    sightings = [
        {"sequence": f"s{s}", "frame": frame, "track": track, "clear": track < 2}
        for s in range(3)
        for frame in range(4)
        for track in range(s + 1)
    ]
    for s in range(3):
        own = [row for row in sightings if row["sequence"] == f"s{s}"]
        store.write_interval("sightings", f"s{s}", table(own, INTERVALS["sightings"]))
    predictions, scores = [], []
    for run_id, method in RUN_IDS.items():
        # The first ten are guessed by all, and boxed by none.
        given = [
            (1, ELSEWHERE, 7)
            if i < 10
            else (generator.choice([1, 1, 2, 3, None]), generator.choice([BOX, BOX, ELSEWHERE, None]), 7)
            for i in range(64)
        ]
        run = benchmark.run(given, run_id, method)
        write_run_manifest(store, msgspec.structs.replace(run.manifest, questions_sha256=questions_hash(store)))
        rows = benchmark.written["predictions"].to_pylist()
        for row in rows:
            row["n_observations"] = generator.randrange(4)
            row["seconds"] = generator.random()
            row["reason"] = "" if row["status"] == "answered" else f"frame {generator.randrange(9)} is wrong"
        if run_id == "three":
            for number in (20, 30, 31):
                rows[number] |= {"status": "error", "reason": "frame 3 is wrong"}
        written = table(rows, RUNS["predictions"])
        scored = score_predictions(benchmark.truth, run_id, benchmark.ids, written)
        store.write_run(run_id, "predictions", written)
        store.write_run(run_id, "scores", scored)
        predictions += rows
        scores += scored.to_pylist()
    writes = [
        {"run_id": "one", "question_id": f"q{i:02}", "number": 0, "tool": tool, "accepted": ok, "reason": why}
        for i, (tool, ok, why) in enumerate(
            [("add_entity", True, ""), ("add_entity", False, "no o7"), ("add_entity", False, "no o31")]
        )
    ]
    store.write_run("one", "world", table(writes, RUNS["world"]))
    return store, questions, predictions, scores, sightings


def ask(world, name, **params):
    return world[0].sql(name, **params).to_pylist()


def by_run(rows, key=lambda row: row["run_id"]):
    found = defaultdict(list)
    for row in rows:
        found[key(row)].append(row)
    return found


def percent(rows, name):
    return round(100 * sum(row[f"{name}_score"] for row in rows) / len(rows), 2)


def combined(rows):
    return sum(row["combined_score"] for row in rows)


def test_hardest_questions(world):
    scores = world[3]
    own = by_run(scores, lambda row: row["question_id"])
    totals = {
        name: (combined(rows), sum(r["answer_score"] for r in rows), sum(r["evidence_score"] for r in rows))
        for name, rows in own.items()
    }
    expected = sorted(totals, key=lambda name: (*totals[name], name))[:7]
    found = ask(world, "hardest_questions", count=7)
    assert [row["question_id"] for row in found] == expected
    assert (found[0]["combined"], found[0]["answered"], found[0]["boxed"]) == totals[expected[0]]
    assert len(ask(world, "hardest_questions")) == 20


def test_right_without_evidence(world):
    guessed = sorted(world[1][:10], key=lambda row: (row["template"], row["question_id"]))
    assert [row["question_id"] for row in ask(world, "right_without_evidence")] == [
        row["question_id"] for row in guessed
    ]


def test_difficulty_by_sequence(world):
    _, questions, _, scores, sightings = world
    sequence = {row["question_id"]: row["sequence"] for row in questions}
    own = by_run(scores, lambda row: sequence[row["question_id"]])
    found = {row["sequence"]: row for row in ask(world, "difficulty_by_sequence")}
    assert found.keys() == own.keys()
    for name, rows in own.items():
        boxes = [row for row in sightings if row["sequence"] == name]
        assert found[name]["people_per_frame"] == len(boxes) / 4
        assert found[name]["clear_views"] == round(100 * sum(row["clear"] for row in boxes) / len(boxes), 1)
        assert (found[name]["questions"], found[name]["runs"]) == (len({r["question_id"] for r in rows}), 3)
        assert found[name]["combined"] == percent(rows, "combined")
        assert found[name]["evidence"] == percent(rows, "evidence")


def test_answer_priors(world):
    counts = Counter(row["template"] for row in world[1])
    assert ask(world, "answer_priors") == [
        {"template": name, "says": "sitting", "times": counts[name], "percent": 100.0} for name in sorted(counts)
    ]


def test_positions_chosen(world):
    _, _, predictions, _, _ = world
    chosen = Counter(
        (row["run_id"], json.loads(row["answer"])["choice"]) for row in predictions if row["answer"] is not None
    )
    found = {(row["run_id"], row["place"]): row for row in ask(world, "positions_chosen")}
    assert {key: row["chosen"] for key, row in found.items()} == dict(chosen)
    assert all(
        row["true_there"] == (len(by_run(predictions)[run]) if place == 1 else 0) for (run, place), row in found.items()
    )


def test_cost_per_correct(world):
    _, _, predictions, scores, _ = world
    right = {run_id: combined(rows) for run_id, rows in by_run(scores).items()}
    for row in ask(world, "cost_per_correct"):
        own = by_run(predictions)[row["run_id"]]
        assert row["correct"] == right[row["run_id"]] > 0
        assert row["looks"] == pytest.approx(sum(r["n_observations"] for r in own) / row["correct"], abs=0.0051)
        assert row["tokens"] == pytest.approx(len(own) * 110 / row["correct"], abs=0.5)


def test_invalid_reasons(world):
    _, _, predictions, _, _ = world
    expected = Counter((row["run_id"], row["status"]) for row in predictions if row["status"] != "answered")
    found = ask(world, "invalid_reasons")
    assert {(row["run_id"], row["status"]): row["times"] for row in found} == dict(expected)
    assert {row["reason"] for row in found} == {"frame # is wrong"}


def test_cost(world):
    _, _, predictions, scores, _ = world
    own, spent = by_run(scores), by_run(predictions)
    for row in ask(world, "cost"):
        rows = spent[row["run_id"]]
        assert (row["method"], row["n"]) == (RUN_IDS[row["run_id"]], 64)
        for name in ("n_observations", "n_model_calls", "prompt_tokens", "completion_tokens", "seconds"):
            total = sum(one[name] for one in rows)
            assert row[name.removeprefix("n_")] == pytest.approx(total / 64, abs=0.0006), name
        assert row["tokens_per_combined"] == pytest.approx(110 * len(rows) / combined(own[row["run_id"]]), abs=0.51)


@pytest.mark.parametrize(
    ("query", "name"),
    [
        ("hallucination", "main"),
        ("ablation", "ablation"),
        ("scores_by_group", "group"),
        ("scores_by_family", "family"),
        ("scores_by_template", "template"),
    ],
)
def test_figures_are_those_of_report(world, query, name):
    rows = [{"run": row.pop("run_id"), **row} for row in ask(world, query)]
    printed = [{column: row[column] for column in rows[0]} for row in report(world[0]).table(name)]
    in_order = sorted(map(msgspec.json.encode, rows))
    assert in_order == sorted(map(msgspec.json.encode, printed)) and len(rows) > 1


def test_looks_and_scores(world):
    _, _, predictions, scores, _ = world
    looks = {(row["run_id"], row["question_id"]): row["n_observations"] for row in predictions}
    predicted = [row for row in scores if (row["run_id"], row["question_id"]) in looks]
    own = by_run(predicted, lambda row: (row["run_id"], looks[row["run_id"], row["question_id"]]))
    found = {(row["run_id"], row["looks"]): row for row in ask(world, "looks_and_scores")}
    assert {key: (row["n"], row["evidence"]) for key, row in found.items()} == {
        key: (len(rows), percent(rows, "evidence")) for key, rows in own.items()
    }


def test_runs_disagree(world):
    _, questions, _, scores, _ = world
    template = {row["question_id"]: row["template"] for row in questions}
    value = {(row["run_id"], row["question_id"]): row["combined_score"] for row in scores}
    expected = defaultdict(list)
    for first in RUN_IDS:
        for second in RUN_IDS:
            for name in sorted(template):
                if value[first, name] > value[second, name]:
                    expected[first, second, template[name]].append(name)
    found = {(r["scores_it"], r["misses_it"], r["template"]): r for r in ask(world, "runs_disagree")}
    assert {key: (row["questions"], row["examples"]) for key, row in found.items()} == {
        key: (len(names), names[:3]) for key, names in expected.items()
    }


def test_refused_writes(world):
    assert ask(world, "refused_writes") == [
        {"run_id": "one", "tool": "add_entity", "reason": "no o#", "times": 2, "questions": 2}
    ]
