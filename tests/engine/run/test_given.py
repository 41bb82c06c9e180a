"""The diagnostic methods: what they are shown, what they never get, and how tables treat them."""

import json
import sys

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from scored_runs import BOX, Benchmark

from jrdb_avr.agent.perceive.geometry import Arc, covered, seen_from
from jrdb_avr.engine.report.comparison import report, score
from jrdb_avr.engine.report.looking import gap_rows, look_rows
from jrdb_avr.engine.report.tables import ranked
from jrdb_avr.engine.run.evaluate import evaluate
from jrdb_avr.engine.run.given import GivenPictures, looks_of
from jrdb_avr.engine.run.options import EvaluateOptions, QuestionSelection
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.method import Observation, Question, SequenceInfo, Task
from jrdb_avr.schema.panorama import FOV_DEG, angle_error, center_angle, clockwise, crop_left
from jrdb_avr.schema.plan import AnswerSpec, Edge, Node, Plan, Time, canonical
from jrdb_avr.schema.questions import NeededBox

SECRET = "juggling swordfish"


def box(track, frame, x=100.0, decisive=False):
    return NeededBox({2: "a", 7: "b"}[track], track, frame, x, 100.0, 40.0, 120.0, decisive)


def plan(read="action", mode="multiple_choice", at="t0", joined=()):
    """A plan about person a, with t0 at frame 5 and t1 at frame 9."""
    edges = tuple(Edge("a", "moving together", "b", at) for at in joined)
    times = {"t0": Time(frame=5), "t1": Time(frame=9)}
    return Plan("a", "a", times, (Node("a"), Node("b"))[: 1 + len(edges)], edges, AnswerSpec(mode, read, "a", at))


def observe(sequence, frame_index, angle_deg):
    left = int(crop_left(angle_deg))
    image = np.zeros((480, 480, 3), np.uint8)
    return Observation(sequence, frame_index, 0.0, angle_deg, 45.96, left, image)


@pytest.fixture
def store(tmp_path):
    benchmark, store = Benchmark([("q", "s", "chain_2hop")]), Store(tmp_path)
    needed = [box(2, 9, 3750.0, decisive=True), box(7, 9), box(2, 5), box(2, 9, 3750.0)]
    answers = benchmark.tables["answers"]
    texts = {"needed": msgspec.json.encode(needed).decode(), "plan": canonical(plan()), "answer": f'"{SECRET}"'}
    for name, text in texts.items():
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
    asks_frame = plan("start", "frame", "t1")
    assert [look.frame for look in looks_of(needed, asks_frame)] == [5, 8, 9, 10]
    assert [look.box is not None for look in looks_of(needed, asks_frame)] == [False, False, True, False]
    assert [look.frame for look in looks_of(needed, plan(at="t1"))] == [5, 9]


@pytest.mark.parametrize("needed", [[box(2, 5, decisive=True)], [box(2, 5), box(2, 9, 3750.0, decisive=True)]])
def test_a_time_of_a_possible_absence_is_shown_in_all_directions(needed):
    looks = looks_of(needed, plan("distance_change", at=("t0", "t1")))
    assert [look.frame for look in looks] == [5] + [9] * 9, "their number does not say whether the target is present"
    assert covered([seen_from(look.angle) for look in looks if look.frame == 9])
    assert looks[1].angle == center_angle(needed[-1].x, 40.0)
    assert [bool(look.box) for look in looks].index(True) == len(needed) - 1


@pytest.mark.parametrize(("x", "count"), [(300.0, 0), (400.0, 1), (3600.0, 1), (700.0, 1), (1600.0, 3)])
def test_everything_between_two_people_of_a_relation_is_shown(x, count):
    looks = looks_of([box(2, 5), box(7, 5, x), box(2, 9)], plan(at="t1", joined=["t0"]))
    assert [look.frame for look in looks] == [5] * (2 + count) + [9]
    first, last = looks[0].angle, looks[1].angle
    way = Arc(first, clockwise(first, last)) if x < 3000 else Arc(last, clockwise(last, first))
    assert covered([seen_from(look.angle) for look in looks], way)
    # If one crop can show both people, one does.
    shown = [max(angle_error(look.angle, first), angle_error(look.angle, last)) <= FOV_DEG / 2 for look in looks]
    assert any(shown) == (way.span <= 40)


def test_given_looks_are_enough_for_the_perfect_model(benchmark_copy):
    options = EvaluateOptions(selection=QuestionSelection(per_template=6))
    evaluate(benchmark_copy, "given-looks", "simulated:perfect", options)
    (row,) = score(benchmark_copy).rows
    assert row["n"] > 50 and row["answer"] >= 95 and row["combined"] >= 95


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


@pytest.mark.slow
def test_searching_and_seeing_both_cost_the_realistic_model_answers(benchmark_copy):
    options = EvaluateOptions(selection=QuestionSelection(per_template=6))
    for method in ("react", "agent", "random-looks", "given-looks", "given-target"):
        evaluate(benchmark_copy, method, "simulated:realistic", options)
    rows = [row for row in report(benchmark_copy).table("gaps") if row["family"] == "all"]
    assert {row["run"].partition("-")[0] for row in rows} == {"react", "agent"}
    for row in rows:
        assert row["search_gap"] > 0 and row["seeing_gap"] > 0 and row["random_looks"] < row["active"], row


def test_diagnostic_runs_are_called_so_and_never_ranked():
    benchmark = Benchmark([("a", "s", "long_range")])
    runs = [played(benchmark, "given-looks", 1), played(benchmark, "react", 0)]
    assert [(run.manifest.method, run.label) for run in ranked(runs)] == [("react", ""), ("given-looks", "diagnostic")]
