"""cameras.yaml: intrinsics of every sensor, the constants of the panorama checked, hostile texts refused."""

from __future__ import annotations

import time

import pytest
from environment import REAL
from loaded_stores import NAME, read_store, reported_store
from worlds import person

from jrdb_avr.schema.panorama import FOCAL_ROWS, HORIZON_ROW

CAMERAS = REAL / "calibration" / "cameras.yaml"


def sensor(fx, cx, fy, cy, size=("752", "480"), matrix=None):
    """A sensor as JRDB writes one; `matrix` is put in the place of the usual one."""
    matrix = matrix or f">\n      {fx} 0 {cx}\n      0 {fy} {cy}\n      0 0 1"
    return f"    width: {size[0]}\n    height: {size[1]}\n    D: -0.3 0.1 0 0 0\n    K: {matrix}\n    T: 0 -3.7 -56.9\n"


def cameras(*sensors):
    body = "".join(f"  sensor_{i}:\n{text}" for i, text in enumerate(sensors))
    return f"stitching:\n  radius: 1000\n  crop: 1\ncameras:\n  # the order matters\n{body}"


USUAL = [sensor(470, 350, 480, 205), sensor(471, 351, 484, 211), sensor(472, 352, 482, 209)]
ROWS = [("sensor_0", 752, 480, 470, 480, 350, 205), ("sensor_1", 752, 480, 471, 484, 351, 211)]
ROWS += [("sensor_2", 752, 480, 472, 482, 352, 209)]


def layers_of(text):
    return {"2d": {0: [person(1, (100, 60, 50, 200))]}, "calibration": text}


def loaded(tmp_path, text):
    """The file's rows, and the report of the whole load."""
    store, report = reported_store(tmp_path, layers_of(text))
    return rows_of(store), report


def read(tmp_path, text):
    """The file's rows, and the problems of a sequence's files."""
    store, found = read_store(tmp_path, layers_of(text))
    assert store.annotation("boxes_2d", NAME).num_rows == 1
    return rows_of(store), found.problems


def rows_of(store):
    table = store.annotation("calibration", NAME)
    names = ("sensor", "width", "height", "fx", "fy", "cx", "cy")
    assert set(table["sequence"].to_pylist()) <= {NAME}
    return [tuple(row[name] for name in names) for row in table.to_pylist()]


def test_sensors_are_rows_and_their_medians_stand_beside_the_constants(tmp_path):
    rows, report = loaded(tmp_path, cameras(*USUAL))
    assert rows == ROWS and report.problems == []
    check = report.cameras
    assert (check.cameras, check.fy, check.cy) == (3, 482, 209)
    assert (check.focal_rows, check.horizon_row, check.agrees) == (FOCAL_ROWS, HORIZON_ROW, True)
    assert not any("cameras" in warning for warning in report.warnings)


@pytest.mark.parametrize("fy, cy", [(FOCAL_ROWS * 1.06, HORIZON_ROW), (FOCAL_ROWS, HORIZON_ROW * 0.94)])
def test_another_robots_cameras_are_warned_of(tmp_path, fy, cy):
    _, report = loaded(tmp_path, cameras(sensor(470, 350, fy, cy)))
    assert not report.cameras.agrees
    assert any("another robot" in warning for warning in report.warnings)


MATRICES = {
    "flat list": "[470, 0, 350, 0, 480, 205, 0, 0, 1]",
    "three lists": "[[470, 0, 350], [0, 480, 205], [0, 0, 1]]",
    "one line": "470 0 350 0 480 205 0 0 1",
    "exponents": "4.7e2 0 3.5e+2 0. 480 205 0 0 1.0",
}


@pytest.mark.parametrize("matrix", MATRICES.values(), ids=MATRICES)
def test_a_matrix_may_be_written_in_several_ways(tmp_path, matrix):
    assert read(tmp_path, cameras(sensor(0, 0, 0, 0, matrix=matrix))) == (ROWS[:1], [])


BAD = {
    "eight numbers": "470 0 350 0 480 205 0 0",
    "NaN": "470 0 350 0 .nan 205 0 0 1",
    "underscores": "4_70 0 350 0 480 205 0 0 1",
    "too large": "470 0 350 0 1e400 205 0 0 1",
    "no camera": "470 0 350 0 480 205 0 0 2",
    "negative": "470 0 350 0 -480 205 0 0 1",
    "nothing": "",
    "nested": "[[[470]], 0, 350, 0, 480, 205, 0, 0, 1]",
}


@pytest.mark.parametrize("matrix", BAD.values(), ids=BAD)
def test_a_bad_matrix_costs_its_own_sensor(tmp_path, matrix):
    bad = sensor(0, 0, 0, 0, matrix=matrix or "''")
    rows, problems = read(tmp_path, cameras(USUAL[0], bad))
    assert rows == ROWS[:1]
    ((kind, layer, frame, field),) = [(p.kind, p.layer, p.frame, p.field) for p in problems]
    assert (kind, layer, frame, field) == ("record", "calibration", "sensor_1", "K")


@pytest.mark.parametrize("size", [("wide", "480"), ("0", "480"), ("7.5", "480"), ("[1]", "480")])
def test_a_bad_size_is_unknown(tmp_path, size):
    rows, problems = read(tmp_path, cameras(sensor(470, 350, 480, 205, size=size)))
    assert rows == [("sensor_0", None, 480, 470, 480, 350, 205)]
    assert [(p.kind, p.field) for p in problems] == [("field", "width")]


BOMB = "a: &a [x, x]\n" + "".join(
    f"{chr(98 + i)}: &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(24)
)
BROKEN = {
    "empty": "",
    "no cameras": "lidars: {}",
    "cameras as text": "cameras: all",
    "not YAML": "cameras: [\n  x: {",
    "deep": "cameras: " + "[" * 1000,
    "code": "!!python/object/apply:os.system ['true']",
    "bytes": b"\xff\xfe\x00",
    "bomb": BOMB,
    "large": "# " + "x" * 70_000,
    "an unknown alias": "cameras: *who",
}


@pytest.mark.parametrize("content", BROKEN.values(), ids=BROKEN)
def test_a_broken_file_costs_itself_and_no_time(tmp_path, content):
    start = time.process_time()
    rows, report = loaded(tmp_path, content)
    assert time.process_time() - start < 20
    assert rows == [] and report.cameras is None and report.boxes == 1
    assert [(p.kind, p.layer) for p in report.problems] == [("file", "calibration")]
    assert "cameras.yaml" in report.problems[0].reason


@pytest.mark.skipif(not CAMERAS.is_file(), reason="the real calibration is not here")
def test_the_published_file_agrees_with_the_constants(tmp_path):
    rows, report = loaded(tmp_path, CAMERAS.read_text())
    assert len(rows) == 10 and report.problems == [] and report.cameras.agrees
    # An independent reading: the second number of each matrix's second line.
    lines = [line.split() for line in CAMERAS.read_text().splitlines()]
    focal = sorted(float(line[1]) for line in lines if len(line) == 3 and line[0] == "0" and line[1] != "0")
    assert report.cameras.fy == pytest.approx((focal[4] + focal[5]) / 2)
