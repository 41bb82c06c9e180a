"""The diagnostic methods: what they are shown, what they never get, and how tables treat them."""

import json
import sys

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from scored_runs import BOX, Benchmark

from jrdb_avr.engine.report.looking import gap_rows, look_rows
from jrdb_avr.engine.report.tables import ranked
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.given import GivenPictures, looks_of
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.method import Observation, Question, SequenceInfo, Task
from jrdb_avr.schema.panorama import crop_left
from jrdb_avr.schema.questions import NeededBox

SECRET = "juggling swordfish"


def box(track, frame, x=100.0, decisive=False):
    return NeededBox("a", track, frame, x, 100.0, 40.0, 120.0, decisive)


def observe(sequence, frame_index, angle_deg):
    left = int(crop_left(angle_deg))
    image = np.zeros((480, 480, 3), np.uint8)
    return Observation(sequence, frame_index, 0.0, angle_deg, 45.96, left, image)


@pytest.fixture
def store(tmp_path):
    benchmark, store = Benchmark([("q", "s", "chain_2hop")]), Store(tmp_path)
    needed = [box(2, 9, 3750.0, decisive=True), box(7, 9), box(2, 5), box(2, 9, 3750.0)]
    answers = benchmark.tables["answers"]
    for name, text in {"needed": msgspec.json.encode(needed).decode(), "plan": SECRET, "answer": f'"{SECRET}"'}.items():
        answers = answers.set_column(answers.column_names.index(name), name, pa.array([text]))
    tracks = answers.column_names.index("target_track")
    benchmark.tables["answers"] = answers.set_column(tracks, answers.schema.field(tracks), pa.array([2], pa.int32()))
    benchmark.write(store)
    return store


def task(*frames):
    question = Question("q", "s", "?", ("a", "b"), "multiple_choice")
    return Task(question, SequenceInfo("s", 15.0, 100, frames), observe, None, print, print)


def test_each_needed_person_and_time_is_one_picture_in_order_of_time(store):
    shown = GivenPictures(store, observe, False)(task(5, 9))
    # The target comes first in a frame, and nothing is drawn.
    assert [(crop.frame_index, round(crop.angle_deg)) for crop in shown] == [(5, 11), (9, 1), (9, 11)]
    assert not any(crop.image.any() for crop in shown)
    assert len(GivenPictures(store, observe, False)(task(9))) == 2, "frame 5 has no panorama"


def test_the_target_is_marked_only_in_the_picture_of_the_time_asked(store):
    shown = GivenPictures(store, observe, True)(task(5, 9))
    assert [bool(crop.image.any()) for crop in shown] == [False, True, False]
    # The crop is centred on the box of 40 by 120 pixels, across the seam.
    rows, columns = np.nonzero(shown[1].image[..., 0])
    assert (rows.min(), rows.max()) == (99, 220) and 218 <= columns.min() <= columns.max() <= 261
    assert not shown[1].image[..., 1:].any()


def test_an_asked_frame_comes_with_the_frames_beside_it():
    needed = [box(2, 5), box(2, 9, decisive=True)]
    assert [look.frame for look in looks_of(needed, 2, True)] == [5, 8, 9, 10]
    assert [look.box is not None for look in looks_of(needed, 2, True)] == [False, False, True, False]
    assert [look.frame for look in looks_of(needed, 2, False)] == [5, 9]


def test_a_method_gets_pictures_alone_and_its_process_never_opens_the_answers(store):
    opened = []
    sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
    pictures = GivenPictures(store, observe, True)
    shown = pictures(task(5, 9))
    assert not [path for path in opened if "answers" in path or "evidence" in path]
    assert {type(crop) for crop in shown} == {Observation}
    reachable = json.dumps([str(vars(pictures)), *map(str, shown)])
    assert SECRET not in reachable and "track" not in reachable and "chain_2hop" not in reachable


def test_a_public_store_refuses_diagnostic_methods(store):
    store.question_path("answers").unlink()
    for method in ("random-looks", "given-looks", "given-target"):
        with pytest.raises(StoreError, match="is diagnostic: it needs the answers"):
            evaluate(store, method, "simulated:perfect")


def played(benchmark, method, right, settings=None, run_id=None):
    """A run of a method with this number of right answers and boxes."""
    given = [(1, BOX, 7)] * right + [(2, BOX, 7)] * (len(benchmark.ids) - right)
    run = benchmark.run(given, run_id or method, method)
    run.manifest = msgspec.structs.replace(run.manifest, settings=settings or {})
    return run


def test_gaps_are_paired_differences_in_points():
    benchmark = Benchmark([(f"q{n:02}", f"s{n % 10}", ("long_range", "chain_2hop")[n % 2]) for n in range(20)])
    counts = {"react": 4, "random-looks": 2, "given-looks": 10, "given-target": 15}
    rows = gap_rows(benchmark.index, [played(benchmark, name, right) for name, right in counts.items()])
    assert [(row["run"], row["family"], row["score"]) for row in rows[:3]] == [
        ("react", "all", "answer"),
        ("react", "all", "combined"),
        ("react", "chain_2hop", "answer"),
    ]
    row = rows[1]
    assert [row[name] for name in ("active", "random_looks", "given_looks", "given_target")] == [20.0, 10.0, 50.0, 75.0]
    assert (row["search_gap"], row["seeing_gap"], row["n"], row["interval"]) == (30.0, 25.0, 20, "95 %")
    assert type(row["active"]) is float, "NumPy numbers become texts in JSON"
    assert row["search_gap_low"] <= 30 <= row["search_gap_high"] and len(rows) == 6
    assert gap_rows(benchmark.index, [played(benchmark, "react", 4)]) == []


def test_budgets_are_compared_if_nothing_else_differs():
    benchmark = Benchmark([(f"q{n}", "s", "long_range") for n in range(4)])
    settings = [{"method": {"budget": n, "most_calls": 2 * n + 2, "x": x}} for n, x in ((24, 1), (8, 1), (8, 2))]
    runs = [played(benchmark, "react", n, each, f"r{n}") for n, each in enumerate(settings, 1)]
    assert [(row["looks"], row["run"], row["combined"]) for row in look_rows(benchmark.index, runs)] == [
        (8, "r2", 50.0),
        (24, "r1", 25.0),
    ]


def test_diagnostic_runs_are_called_so_and_never_ranked():
    benchmark = Benchmark([("a", "s", "long_range")])
    runs = [played(benchmark, "given-looks", 1), played(benchmark, "react", 0)]
    assert [(run.manifest.method, run.label) for run in ranked(runs)] == [("react", ""), ("given-looks", "diagnostic")]
