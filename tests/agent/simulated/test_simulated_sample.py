"""The marker model on a small sample world, from files to scores: evidence is lost to marks and budget alone."""

import json
import shutil

import cv2
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from question_files import all_evidence

from jrdb_avr.engine.cli import group
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.markers import read
from jrdb_avr.schema.panorama import Box, iou

pytestmark = pytest.mark.slow

N = 20


def run(*arguments):
    result = CliRunner().invoke(group, [str(argument) for argument in arguments])
    assert result.exception is None, (result.output, result.exception)
    return result.stdout


def rows(store, *path):
    return pq.read_table(store.joinpath(*path)).to_pylist()


@pytest.fixture(scope="module")
def store(small_demo, tmp_path_factory):
    folder = small_demo.folder
    root = tmp_path_factory.mktemp("sample")
    shutil.copytree(folder / "store", root / "store", ignore=shutil.ignore_patterns("runs"))
    questions = rows(root / "store", "questions", "questions.parquet")
    # Some of every template, in the ids' order, which is as good as random.
    by_template = {}
    for row in sorted(questions, key=lambda row: row["question_id"]):
        by_template.setdefault(row["template"], []).append(row["question_id"])
    turns = sorted((turn, name) for names in by_template.values() for turn, name in enumerate(names))
    picked = [name for _, name in turns[:N]]
    run(
        "evaluate", "--store", root / "store", "--method", "react", "--model", "marker", "--questions", ",".join(picked)
    )
    run("score", "--store", root / "store", "react-marker")
    return root / "store"


def test_every_loss_is_explained(store):
    """What the server's log says was missing, and what is in the pixels, agree with each lost box."""
    questions = {row["question_id"]: row for row in rows(store, "questions", "questions.parquet")}
    answers = {row["question_id"]: row for row in rows(store, "questions", "answers.parquet")}
    truth = {}
    for row in all_evidence(Store(store)).to_pylist():
        truth.setdefault(row["question_id"], {})[row["frame"]] = Box(row["x"], row["y"], row["w"], row["h"])
    missing = {}
    for line in (store / "runs" / "react-marker" / "marker.jsonl").read_text().splitlines():
        entry = json.loads(line)
        missing[entry["question"], tuple(entry["choices"])] = entry["missing"]
    root = json.loads((store / "store.json").read_text())["image_root"]
    scores = rows(store, "runs", "react-marker", "scores.parquet")
    predictions = {row["question_id"]: row for row in rows(store, "runs", "react-marker", "predictions.parquet")}
    assert len(scores) >= 20
    found = 0
    for score in scores:
        name = score["question_id"]
        question, prediction = questions[name], predictions[name]
        if score["evidence_score"]:
            # A box that is given is right to the pixel or two, wherever it lies.
            box = Box(*(prediction[f"evidence_{key}"] for key in "xywh"))
            assert iou(box, truth[name][prediction["evidence_frame"]]) > 0.85
            found += 1
            continue
        reasons = missing[question["question"], tuple(question["choices"])]
        assert any(reason.startswith(("mark unreadable", "budget")) for reason in reasons), (question, reasons)
        if "group of" in question["question"] or any(reason.startswith("budget") for reason in reasons):
            continue
        # The person's mark cannot be read in the whole panorama either, at the time of the description.
        plan = json.loads(answers[name]["plan"])
        frame = min(t["frame"] for t in plan["times"].values() if "frame" in t)
        picture = cv2.imread(f"{root}/{question['sequence']}/{frame:06d}.jpg", cv2.IMREAD_COLOR_RGB)
        readable = read(picture, wrap=True)
        if plan["edges"]:
            # A hop goes wrong as well where somebody beside the path cannot be read.
            people = rows(store, "intervals", "sightings", f"{question['sequence']}.parquet")
            assert len(readable) < sum(row["frame"] == frame for row in people), (question, reasons)
            continue
        marks = [reading for reading in readable if iou(reading.box, truth[name][frame]) > 0.7]
        # A mark has room for one relation and one thing: what a description says may be another.
        told = {(c.get("interaction"), c.get("object"), c.get("verb")) for c in plan["nodes"][0]["conditions"]}
        shown = {(mark.interaction, None, None) for mark, _, _ in marks} | {(None, None, None)}
        shown |= {(None, mark.object, mark.verb) for mark, _, _ in marks}
        assert not marks or not told <= shown, (question, reasons, marks)
    assert found > len(scores) / 2


def test_a_run_keeps_its_knobs(store):
    """What `--marker` sets is done, stands in the manifest, and cannot be another when the run is resumed."""
    names = sorted(row["question_id"] for row in rows(store, "questions", "questions.parquet"))[:6]
    ask = ["evaluate", "--store", store, "--method", "monolithic", "--model", "marker", "--run-id", "knobs"]
    knobs = ["--marker", "refusal=0.5", "--marker", "seed=1"]
    run(*ask, *knobs, "--questions", ",".join(names))
    predictions = rows(store, "runs", "knobs", "predictions.parquet")
    refused = [row["question_id"] for row in predictions if "refused" in row["reason"]]
    assert 0 < len(refused) < len(names)
    manifest = json.loads((store / "runs" / "knobs" / "run.json").read_text())
    assert manifest["settings"]["marker"] == {"refusal": 0.5, "seed": 1}
    other = CliRunner().invoke(group, [str(word) for word in [*ask, "--marker", "refusal=0.5", "--resume"]])
    assert other.exit_code != 0 and "differs in the marker" in str(other.exception)


@pytest.mark.slow
def test_the_agents_right_answers_stand_on_the_right_person(store):
    asked = [row["question_id"] for row in rows(store, "runs", "react-marker", "predictions.parquet")]
    ids = ",".join(asked)
    run("evaluate", "--store", store, "--method", "agent", "--model", "marker", "--questions", ids)
    run("score", "--store", store, "agent-marker")
    scores = rows(store, "runs", "agent-marker", "scores.parquet")
    right = [row for row in scores if row["answer_score"]]
    assert len(right) > len(scores) / 3
    assert sum(row["combined_score"] for row in right) >= 0.9 * len(right)
    predictions = rows(store, "runs", "agent-marker", "predictions.parquet")
    assert all(row["status"] != "error" and row["n_observations"] <= 24 for row in predictions)
    tools = [
        row["question_id"] for row in rows(store, "runs", "agent-marker", "steps.parquet") if row["kind"] == "tool"
    ]
    # The plan is one as well.
    assert max(map(tools.count, asked)) <= 81
