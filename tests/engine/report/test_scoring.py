"""Scores against oracles that share no code with the scorer: Python sets, pycocotools, integer grid cells."""

import json
import math

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
import scored_runs
from environment import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pycocotools import mask as coco
from scored_runs import Benchmark, scored_run

from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.report.scored_runs import QuestionIndex
from jrdb_avr.engine.report.scoring import box_ious, score_predictions
from jrdb_avr.engine.report.tables import score_row
from jrdb_avr.engine.report.truth import FRAME_LIMIT, Truth, read_truth
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.panorama import Box, iou
from jrdb_avr.schema.tables import QUESTIONS, RUNS

WIDTH = 3760
ANSWER_COLUMNS = ("question_id", "answer", "target_track")
MODES = ("multiple_choice", "frame", "span", "frame_viewpoint", "number")


def truth_of(rows, fps=15.0):
    """rows: (question_id, mode, answer as a dict, {frame: box})."""
    questions = [
        {
            "question_id": name,
            "sequence": "s",
            "family": "f",
            "template": "t",
            "question": "?",
            "choices": ["a", "b"] if mode == "multiple_choice" else [],
            "answer_mode": mode,
        }
        for name, mode, _, _ in rows
    ]
    answers = [
        {"question_id": name, "answer": json.dumps(answer), "target_track": track}
        for track, (name, _, answer, _) in enumerate(rows)
    ]
    evidence = [
        {"sequence": "s", "track": track, "frame": frame, **dict(zip("xywh", box, strict=True))}
        for track, (_, _, _, boxes) in enumerate(rows)
        for frame, box in boxes.items()
    ]
    sequences = [{"sequence": "s", "fps": fps, "frame_count": 1000, "frames": [0]}]
    return Truth(
        pa.Table.from_pylist(questions, schema=QUESTIONS["questions"]),
        pa.Table.from_pylist(sequences, schema=QUESTIONS["sequences"]),
        pa.Table.from_pylist(answers, schema=pa.schema(map(QUESTIONS["answers"].field, ANSWER_COLUMNS))),
        pa.Table.from_pylist(evidence, schema=QUESTIONS["evidence"]),
    )


def prediction(name, answer=None, evidence=None, status="answered"):
    """answer: a dict, or a text as it stands; evidence: (frame, box)."""
    frame, box = evidence if evidence else (None, (None,) * 4)
    return {
        "run_id": "r",
        "question_id": name,
        "status": status,
        "answer": json.dumps(answer) if isinstance(answer, dict) else answer,
        "evidence_frame": frame,
        **dict(zip(("evidence_x", "evidence_y", "evidence_w", "evidence_h"), box, strict=True)),
        "raw": "",
        "reason": "",
        "n_observations": 0,
        "n_model_calls": 0,
        "prompt_tokens": 0,
        "completion_tokens": 0,
        "seconds": 0.0,
    }


def predictions_of(rows):
    return pa.Table.from_pylist(rows, schema=RUNS["predictions"])


def score(rows, predicted, iou_threshold=0.5, asked=None, fps=15.0):
    asked = [row[0] for row in rows] if asked is None else asked
    table = score_predictions(truth_of(rows, fps), "r", asked, predictions_of(predicted), iou_threshold)
    assert table.schema == RUNS["scores"]
    assert table["question_id"].to_pylist() == list(asked)
    return [
        (row["answer_score"], row["evidence_score"], row["combined_score"], row["invalid"]) for row in table.to_pylist()
    ]


BOX = (100.0, 50.0, 40.0, 80.0)


def answer_score(mode, truth, given, fps=15.0):
    rows = [("q", mode, truth, {7: BOX})]
    return score(rows, [prediction("q", given, (7, BOX))], fps=fps)[0][0]


# -- the bounds, each on both sides: a mutant of the scorer fails here ----------------------------------------------


BOUNDS = [
    ("multiple_choice", {"choice": 2}, {"choice": 2}, 1),
    ("multiple_choice", {"choice": 2}, {"choice": 1}, 0),
    ("multiple_choice", {"choice": 1}, {"choice": 2}, 0),
    ("frame", {"frame": 100}, {"frame": 100}, 1),
    ("frame", {"frame": 100}, {"frame": 115}, 1),
    ("frame", {"frame": 100}, {"frame": 116}, 0),
    ("frame", {"frame": 100}, {"frame": 85}, 1),
    ("frame", {"frame": 100}, {"frame": 84}, 0),
    ("span", {"start_frame": 10, "end_frame": 19}, {"start_frame": 10, "end_frame": 19}, 1),
    ("span", {"start_frame": 10, "end_frame": 19}, {"start_frame": 10, "end_frame": 14}, 1),  # 5 of 10
    ("span", {"start_frame": 10, "end_frame": 19}, {"start_frame": 10, "end_frame": 13}, 0),  # 4 of 10
    ("span", {"start_frame": 10, "end_frame": 19}, {"start_frame": 10, "end_frame": 29}, 1),  # 10 of 20
    ("span", {"start_frame": 10, "end_frame": 19}, {"start_frame": 10, "end_frame": 30}, 0),
    ("span", {"start_frame": 10, "end_frame": 19}, {"start_frame": 19, "end_frame": 10}, 0),  # reversed
    ("span", {"start_frame": 10, "end_frame": 10}, {"start_frame": 10, "end_frame": 10}, 1),  # one frame
    ("span", {"start_frame": 10, "end_frame": 10}, {"start_frame": 10, "end_frame": 11}, 1),
    ("frame_viewpoint", {"frame": 9, "angle_deg": 350.0}, {"frame": 24, "angle_deg": 10.0}, 1),
    ("frame_viewpoint", {"frame": 9, "angle_deg": 350.0}, {"frame": 24, "angle_deg": 10.1}, 0),
    ("frame_viewpoint", {"frame": 9, "angle_deg": 350.0}, {"frame": 24, "angle_deg": -30.0}, 1),
    ("frame_viewpoint", {"frame": 9, "angle_deg": 350.0}, {"frame": 24, "angle_deg": -31.0}, 0),
    ("frame_viewpoint", {"frame": 9, "angle_deg": 350.0}, {"frame": 25, "angle_deg": 350.0}, 0),
    ("frame_viewpoint", {"frame": 9, "angle_deg": 10.0}, {"frame": 9, "angle_deg": 730.0}, 1),
    ("number", {"value": 8.0}, {"value": 8.0}, 1),
    ("number", {"value": 8.0}, {"value": 16.0}, 1),
    ("number", {"value": 8.0}, {"value": 16.1}, 0),
    ("number", {"value": 8.0}, {"value": 4.0}, 1),
    ("number", {"value": 8.0}, {"value": 3.9}, 0),
    ("number", {"value": 8.0}, {"value": 0.0}, 0),
    ("number", {"value": 8.0}, {"value": -8.0}, 0),
    ("number", {"value": -8.0}, {"value": -8.0}, 0),
    ("number", {"value": 0.0}, {"value": 0.0}, 0),
    ("number", {"value": 0.5}, {"value": 0.4}, 1),
]


@pytest.mark.parametrize(("mode", "truth", "given", "expected"), BOUNDS)
def test_answer_bounds_are_inclusive(mode, truth, given, expected):
    assert answer_score(mode, truth, given) == expected


def test_a_second_follows_the_frame_rate():
    assert answer_score("frame", {"frame": 100}, {"frame": 110}, fps=10.0) == 1
    assert answer_score("frame", {"frame": 100}, {"frame": 111}, fps=10.0) == 0
    assert answer_score("frame", {"frame": 100}, {"frame": 107}, fps=7.4) == 1
    assert answer_score("frame", {"frame": 100}, {"frame": 108}, fps=7.4) == 0


@pytest.mark.parametrize(
    "unreadable",
    [
        "",
        "not json",
        '{"choice": 0}',
        '{"choice": "1"}',
        '{"choice": 1, "more": 2}',
        '{"frame": 1}',
        '{"choice": 1.5}',
        "[1]",
        "1",
        '{"choice": true}',
    ],
)
def test_unreadable_answer_scores_nothing_and_leaves_the_box(unreadable):
    rows = [("q", "multiple_choice", {"choice": 1}, {7: BOX})]
    assert score(rows, [prediction("q", unreadable, (7, BOX))]) == [(0, 1, 0, True)]


def test_a_part_that_is_missing_scores_nothing_and_is_not_unreadable():
    rows = [("q", "multiple_choice", {"choice": 1}, {7: BOX})]
    assert score(rows, [prediction("q", None, (7, BOX))]) == [(0, 1, 0, False)]
    assert score(rows, [prediction("q", {"choice": 1})]) == [(1, 0, 0, False)]
    assert score(rows, [prediction("q", {"choice": 1}, (7, (math.nan, *BOX[1:])))]) == [(1, 0, 0, True)]


@pytest.mark.parametrize(
    "box",
    [
        (math.nan, 50.0, 40.0, 80.0),
        (100.0, math.inf, 40.0, 80.0),
        (100.0, 50.0, None, 80.0),
        (100.0, 50.0, 0.0, 80.0),
        (100.0, 50.0, 40.0, 0.0),
        (140.0, 130.0, -40.0, -80.0),
        (100.0, 50.0, 1e308, 1e308),
        (-1e308, -1e308, 1e308, 1e308),
    ],
)
def test_degenerate_boxes_never_score(box):
    rows = [("q", "multiple_choice", {"choice": 1}, {7: BOX})]
    assert score(rows, [prediction("q", {"choice": 1}, (7, box))], 1e-6)[0][:3] == (1, 0, 0)


def test_box_counts_only_in_a_frame_where_the_target_has_one():
    rows = [
        ("p", "multiple_choice", {"choice": 1}, {7: BOX, 9: (500.0, 50.0, 40.0, 80.0)}),
        ("q", "multiple_choice", {"choice": 1}, {8: BOX}),
    ]
    for frame, expected in ((6, 0), (7, 1), (8, 0), (9, 0), (10, 0), (None, 0)):
        assert score(rows, [prediction("p", {"choice": 1}, (frame, BOX))])[0][1] == expected
    assert score(rows, [prediction("p", {"choice": 1}, (9, (500.0, 50.0, 40.0, 80.0)))])[0][1] == 1
    # A frame past the last one that can be scored is not taken for that one.
    last = [("p", "multiple_choice", {"choice": 1}, {FRAME_LIMIT - 1: BOX})]
    for frame, expected in ((FRAME_LIMIT - 1, 1), (FRAME_LIMIT, 0)):
        assert score(last, [prediction("p", {"choice": 1}, (frame, BOX))])[0][1] == expected


def test_threshold_is_inclusive_and_a_setting():
    rows = [("q", "multiple_choice", {"choice": 1}, {7: (0.0, 0.0, 40.0, 80.0)})]
    half = (7, (0.0, 0.0, 40.0, 40.0))  # exactly half
    less = (7, (0.0, 0.0, 40.0, 39.0))
    assert score(rows, [prediction("q", {"choice": 1}, half)], 0.5)[0][1] == 1
    assert score(rows, [prediction("q", {"choice": 1}, less)], 0.5)[0][1] == 0
    assert score(rows, [prediction("q", {"choice": 1}, less)], 0.25)[0][1] == 1
    assert score(rows, [prediction("q", {"choice": 1}, half)], 0.75)[0][1] == 0
    for wrong in (0.0, -0.5, 1.5, math.nan):
        with pytest.raises(InputError, match="threshold"):
            score(rows, [], wrong)


def test_errors_and_silence_score_nothing_and_stay_in_n():
    rows = [(name, "multiple_choice", {"choice": 1}, {7: BOX}) for name in "abcd"]
    predicted = [
        prediction("b", {"choice": 1}, (7, BOX), status="error"),
        prediction("a", {"choice": 1}, (7, BOX), status="invalid"),
        prediction("d", {"choice": 1}, (7, BOX)),
    ]
    assert score(rows, predicted) == [(1, 1, 1, True), (0, 0, 0, False), (0, 0, 0, False), (1, 1, 1, False)]


def test_only_asked_questions_count():
    rows = [(name, "multiple_choice", {"choice": 1}, {7: BOX}) for name in "abc"]
    assert len(score(rows, [], asked=["c", "a"])) == 2
    assert score(rows, [], asked=[]) == []
    good = prediction("a", {"choice": 1}, (7, BOX))
    with pytest.raises(StoreError, match="not one of its questions"):
        score(rows, [good], asked=["b"])
    with pytest.raises(StoreError, match="two predictions"):
        score(rows, [good, good])
    with pytest.raises(StoreError, match="does not have"):
        score(rows, [], asked=["z"])
    with pytest.raises(StoreError, match="twice"):
        score(rows, [], asked=["a", "a"])


# -- oracles --------------------------------------------------------------------------------------------------------


def unrolled_iou(a, b):
    """pycocotools on boxes unrolled over the seam: b is laid at every turn, the best meeting counts."""
    both = [[b[0] + turn * WIDTH, *b[1:]] for turn in range(-4, 5)]
    return float(coco.iou(np.array([a], float), np.array(both, float), [0] * len(both)).max())


sides = st.floats(1, 400, allow_nan=False)
boxes = st.tuples(st.floats(-WIDTH, 2 * WIDTH), st.floats(-50, 480), sides, sides)
near = st.tuples(st.floats(-60, 60), st.floats(-60, 60), st.floats(0.5, 2), st.floats(0.5, 2), st.integers(-2, 2))


@given(boxes, near)
@settings(max_examples=examples(80))
def test_box_iou_equals_pycocotools(a, change):
    dx, dy, fw, fh, turn = change
    b = (a[0] + dx + turn * WIDTH, a[1] + dy, a[2] * fw, a[3] * fh)
    ours = float(box_ious(np.array([a]), np.array([b]))[0])
    assert ours == pytest.approx(unrolled_iou(a, b), abs=1e-9)
    assert ours == iou(Box(*a), Box(*b))


cells = st.tuples(st.integers(-40, WIDTH), st.integers(0, 60), st.integers(1, 50), st.integers(1, 50))


def grid(box):
    x, y, w, h = box
    return {((x + i) % WIDTH, y + j) for i in range(w) for j in range(h)}


frames = st.integers(0, 60)


# -- against a scorer that goes row by row --------------------------------------------------------------------------


def plain_answer(mode, truth, given, fps):
    """Section 6 of the protocol, straight down, on dicts."""
    if mode == "multiple_choice":
        return given["choice"] == truth["choice"]
    if mode == "frame":
        return abs(given["frame"] - truth["frame"]) <= fps
    if mode == "span":
        a = set(range(truth["start_frame"], truth["end_frame"] + 1))
        b = set(range(given["start_frame"], given["end_frame"] + 1))
        return 2 * len(a & b) >= len(a | b)
    if mode == "number":
        low, high = sorted((given["value"], truth["value"]))
        return low > 0 and high / low <= 2
    turn = abs(given["angle_deg"] - truth["angle_deg"]) % 360
    return abs(given["frame"] - truth["frame"]) <= fps and min(turn, 360 - turn) <= 20


small = st.integers(0, 40)
payloads = {
    "multiple_choice": st.fixed_dictionaries({"choice": st.integers(1, 4)}),
    "frame": st.fixed_dictionaries({"frame": small}),
    "span": st.fixed_dictionaries({"start_frame": small, "end_frame": small}),
    "frame_viewpoint": st.fixed_dictionaries({"frame": small, "angle_deg": st.integers(0, 72).map(lambda n: n * 5.0)}),
    "number": st.fixed_dictionaries({"value": st.integers(-4, 40).map(lambda n: n / 2)}),
}


@st.composite
def worlds(draw):
    rows, predicted = [], []
    for n in range(draw(st.integers(1, 8))):
        mode = draw(st.sampled_from(MODES))
        truth = draw(payloads[mode])
        if mode == "span":
            truth = {"start_frame": min(truth.values()), "end_frame": max(truth.values())}
        places = draw(st.dictionaries(st.integers(0, 3), cells, min_size=0, max_size=3))
        rows.append((f"q{n}", mode, truth, {f: tuple(map(float, box)) for f, box in places.items()}))
        if draw(st.integers(0, 5)):
            answer = draw(st.one_of(payloads[mode], payloads[draw(st.sampled_from(MODES))], st.none()))
            box = None
            if draw(st.integers(0, 4)):
                frame = draw(st.integers(0, 3))
                base = places.get(frame) or draw(cells)
                box = (frame, (float(base[0] + draw(st.sampled_from([0, 0, 5, WIDTH]))), *map(float, base[1:])))
            status = draw(st.sampled_from(["answered", "answered", "invalid", "error"]))
            predicted.append(prediction(f"q{n}", answer, box, status))
    return rows, draw(st.permutations(predicted))


@pytest.mark.slow
@given(worlds(), st.sampled_from([0.25, 0.5, 1.0]))
@settings(max_examples=examples(40), deadline=None)
def test_set_wise_equals_row_by_row(world, threshold):
    rows, predicted = world
    by_name = {p["question_id"]: p for p in predicted}
    expected = []
    for name, mode, truth, places in rows:
        said = by_name.get(name)
        if said is None or said["status"] == "error":
            expected.append((0, 0, 0, False))
            continue
        given = None if said["answer"] is None else json.loads(said["answer"])
        readable = given is not None and given.keys() == truth.keys()
        right = readable and plain_answer(mode, truth, given, 15)
        frame = said["evidence_frame"]
        hit = False
        if frame in places:
            box = tuple(int(said[f"evidence_{key}"]) for key in "xywh")
            mine, theirs = grid(box), grid(tuple(map(int, places[frame])))
            hit = len(mine & theirs) >= threshold * len(mine | theirs)
        invalid = said["status"] == "invalid" or (given is not None and not readable)
        expected.append((int(right), int(hit), int(right and hit), invalid))
    assert score(rows, predicted, threshold) == expected


# -- the report -----------------------------------------------------------------------------------------------------


def row_of(rows, predicted, synthetic=False):
    truth, names = truth_of(rows), [row[0] for row in rows]
    manifest = RunManifest("r", "react", "simulated", "0", tuple(names), synthetic, {}, "2020-01-01T00:00:00Z")
    table = predictions_of(predicted)
    texts = {name: pa.array(names, pa.string()) for name in ("question_id", "sequence", "answer_mode")}
    kinds = {"family": ["chain_2hop"] * len(names), "template": ["two_hop"] * len(names)}
    numbers = {name: pa.array([0.0] * len(names)) for name in ("time_gap_s", "separation_deg")}
    index = QuestionIndex(
        pa.table({**texts, **{name: pa.array(values, pa.string()) for name, values in kinds.items()}}),
        pa.table({"question_id": texts["question_id"], **numbers, "twin_id": pa.nulls(len(names), pa.string())}),
    )
    return score_row(scored_run(index, manifest, table, score_predictions(truth, "r", names, table)), 0.5)


def test_a_run_in_short():
    rows = [(name, "multiple_choice", {"choice": 1}, {7: BOX}) for name in "abcdefgh"]
    predicted = [
        prediction("a", {"choice": 1}, (7, BOX)),
        prediction("b", {"choice": 1}, (8, BOX)),
        prediction("c", {"choice": 1}),
        prediction("d", {"choice": 2}, (7, BOX)),
        prediction("e", status="error"),
    ]
    row = row_of(rows, predicted, synthetic=True)
    assert row == {
        "run": "r",
        "label": "synthetic",
        "n": 8,
        "answer": 37.5,
        "evidence": 25.0,
        "combined": 12.5,
        "hallucination": 66.67,
        "invalid": 0.0,
        "errors": 50.0,
        "iou": 0.5,
    }


def test_a_run_of_nothing():
    row = row_of([("a", "frame", {"frame": 900}, {})], [prediction("a", {"frame": 1})])
    assert (row["answer"], row["hallucination"]) == (0.0, None)
    assert row_of([], [])["answer"] is None


# -- rounding, and files that are not as they should be ---------------------------------------------------------------


@example(122, 200)  # 32.2 - 12.2 is a little more than 20
@given(st.integers(0, 3599), st.sampled_from([200, -200]))
def test_twenty_degrees_score_whatever_rounding_says(tenths, turn):
    truth = {"frame": 100, "angle_deg": tenths / 10}
    for beyond in (0, 1):
        given_ = {"frame": 100, "angle_deg": (tenths + turn + (beyond if turn > 0 else -beyond)) % 3600 / 10}
        assert answer_score("frame_viewpoint", truth, given_) == 1 - beyond


@given(*[st.integers(1, 40_000)] * 2, *[st.integers(2, 4_000)] * 2)
def test_half_a_box_scores_whatever_rounding_says(x, y, w, h):
    rows = [("q", "frame", {"frame": 1}, {5: (x / 10, y / 10, w / 10, h / 10)})]
    for share, expected in ((1.0, 1), (0.999, 0)):
        predicted = [prediction("q", {"frame": 1}, (5, (x / 10, y / 10, w / 20 * share, h / 10)))]
        assert score(rows, predicted)[0][1] == expected


@pytest.fixture
def one_question(tmp_path):
    """A store with one question, and a run of it."""
    store = Store(tmp_path)
    benchmark = Benchmark([("q", "s", "long_range")])
    benchmark.write(store)
    write_run_manifest(store, RunManifest("r", "m", "x", questions_hash(store), ("q",), True, {}, "now"))
    return store


def test_predictions_of_another_form_are_one_line(one_question):
    good = predictions_of([prediction("q")])
    path = one_question.run_path("r") / "predictions.parquet"
    for name, column in (("evidence_x", ["left"]), ("status", [None]), ("evidence_frame", ["many"])):
        table = good.set_column(good.schema.get_field_index(name), name, pa.array(column, pa.string()))
        pq.write_table(table, path)
        with pytest.raises(StoreError, match="has other column types"):
            report(one_question, ["r"])
    pq.write_table(good.drop_columns(["status"]), path)
    with pytest.raises(StoreError, match="lacks the column status"):
        report(one_question, ["r"])
    path.write_bytes(b"PAR1 nothing")
    with pytest.raises(StoreError, match=r"cannot read .*predictions\.parquet"):
        report(one_question, ["r"])


@pytest.mark.parametrize("name", ["questions", "sequences", "answers", "evidence"])
def test_tables_of_different_generations_are_not_scored(one_question, name):
    assert len(read_truth(one_question).ids) == 1
    path = one_question.question_path(name)
    pq.write_table(pq.read_table(path).replace_schema_metadata({"generation": "second"}), path)
    with pytest.raises(StoreError, match="of different generations: run 'jrdb-avr generate"):
        read_truth(one_question)


@pytest.mark.parametrize("name", ["questions", "sequences", "answers", "evidence"])
def test_questions_of_another_form_are_one_line(one_question, name):
    path = one_question.question_path(name)
    row = pa.table({field.name: pa.nulls(1, field.type) for field in QUESTIONS[name]})
    pq.write_table(pa.table({"question_id": ["q"]}), path)
    with pytest.raises(StoreError, match="lacks the column"):
        read_truth(one_question)
    pq.write_table(row, path)
    with pytest.raises(StoreError, match="has other column types"):
        read_truth(one_question)
    path.unlink()
    with pytest.raises(StoreError, match=r"run .jrdb-avr (generate|load)"):
        read_truth(one_question)


def test_answers_of_another_generation_are_refused_by_every_reader(tmp_path):
    from jrdb_avr.engine.pages.inspect import inspect_questions
    from jrdb_avr.engine.report.traces import Trace
    from jrdb_avr.engine.validate.statistics import statistics

    store = Store(tmp_path)
    for table in ("questions", "sequences", "answers", "evidence", "rejected"):
        generation = "second" if table == "answers" else "first"
        store.write_questions(table, QUESTIONS[table].empty_table(), {"generation": generation})
    write_run_manifest(store, RunManifest("r", "m", "x", questions_hash(store), (), True, {}, "now"))
    store.write_run("r", "predictions", predictions_of([prediction("q")]))
    readers = (lambda: statistics(store), lambda: inspect_questions(store, []), lambda: Trace(store, "r", "q"))
    for read in readers:
        with pytest.raises(StoreError, match=r"answers.* of different generations: run 'jrdb-avr generate"):
            read()


def test_predictions_may_be_in_any_order_and_may_be_missing(tmp_path):
    """Six questions about three sequences, not in the order of their ids; the last has no prediction."""
    store, benchmark = Store(tmp_path), Benchmark([(f"q{n}", f"s{n % 3}", "long_range") for n in range(6)])
    benchmark.write(store)
    run = benchmark.run([(1 + n % 2, scored_runs.BOX, 7) for n in range(6)])
    write_run_manifest(store, msgspec.structs.replace(run.manifest, questions_sha256=questions_hash(store)))
    predictions = benchmark.written["predictions"].filter(pc.field("question_id") != "q5")
    for order in ("ascending", "descending"):
        store.write_run("r", "predictions", predictions.sort_by([("question_id", order)]))
        found = report(store, ["r"])
        right = {row["question_id"]: row["combined_score"] for row in found.scores.to_pylist()}
        assert right == {"q0": 1, "q1": 0, "q2": 1, "q3": 0, "q4": 1}
        assert found.table()[0] | {"n": 5, "errors": 0.0, "label": "partial, 5 of 6"} == found.table()[0]
    stray = pa.array([*predictions["question_id"].to_pylist()[:-1], "stray"])
    store.write_run("r", "predictions", predictions.set_column(1, predictions.schema.field(1), stray))
    with pytest.raises(StoreError, match="predicts 'stray', which is not one of its questions"):
        report(store, ["r"])


def test_sequence_and_track_identify_a_target():
    """Two sequences have a track 1, at different positions."""
    targets = [("q0", "s0", (0.0, 0.0, 50.0, 90.0)), ("q1", "s1", (900.0, 0.0, 50.0, 90.0))]
    benchmark = Benchmark([(name, sequence, "long_range") for name, sequence, _ in targets])
    boxes = [
        {"sequence": sequence, "track": 1, "frame": 7, **dict(zip("xywh", box, strict=True))}
        for _, sequence, box in targets
    ]
    benchmark.tables["evidence"] = scored_runs.table(boxes, QUESTIONS["evidence"])
    benchmark.truth = Truth(*benchmark.tables.values())
    assert benchmark.run([(1, box, 7) for _, _, box in targets]).scores.tolist() == [[1, 1, 1]] * 2
    assert benchmark.run([(1, box, 7) for _, _, box in reversed(targets)]).scores.tolist() == [[1, 0, 0]] * 2
