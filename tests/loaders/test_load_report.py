"""The printed report of a load: what a person reads at the usual widths of a page."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner
from loaded_stores import without_graph
from worlds import load_reported, member, person, write_root

from jrdb_avr.engine.cli import group

NAMES = [f"hewlett-packard-intersection-2019-01-{day:02d}_0" for day in range(10, 14)]
BOX = (100, 60, 50, 200)


def run(folder, world, *options):
    write_root(folder / "root", world)
    with without_graph():
        result = CliRunner(env={"COLUMNS": "120"}).invoke(
            group, ["load", str(folder / "root"), "--store", str(folder / "store"), "--workers", "1", *options]
        )
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def world():
    """Every sequence has a bad box in each of two frames, and the last also a bad social file."""
    spoiled = {f: [person(1, BOX), person(2, (0, 0, -1, 5))] for f in (0, 1)}
    layers = {"2d": spoiled | {f: [person(1, BOX)] for f in (2, 3)}, "calibration": "cameras: []"}
    return {name: dict(layers) for name in NAMES} | {NAMES[-1]: {**layers, "social": "{"}}


def test_the_report_fits_a_page_and_says_each_thing_once(tmp_path, world):
    text = run(tmp_path, world)
    tables = [line for line in text.splitlines() if line[:1] in "│┃┏└┡"]
    assert tables and max(map(len, tables)) <= 120
    assert "Layers of 4 sequences: 2d at every frame; without 3d (labels_3d), demographics (" in text
    (row,) = [line for line in tables if "width or height is not positive" in line]
    cells = [cell.strip() for cell in row.strip("│").split("│")]
    assert cells[:3] == ["8", "4", "2d record"]
    problems = [problem for report in json.loads(run(tmp_path, world, "--json")) for problem in report["problems"]]
    assert sum(problem["count"] for problem in problems) == 8 + 4 + 1
    assert "13 refused or skipped" in text


def test_what_a_file_may_hold_without_end_is_not_printed_without_end(tmp_path):
    social = {0: [member(1, BOX, interactions=[(2, {f"label {i}": "1" for i in range(300)})])]}
    text = run(tmp_path, {NAMES[0]: {"2d": {0: [person(1, BOX)]}, "social": social}})
    assert text.count("H-interaction") == 50 and "... 250 more: --csv or --json prints all" in text


def test_boxes_in_another_form_get_a_warning(tmp_path):
    """Each form of the same boxes: as JRDB has them, corners, fractions of both, centres."""
    boxes = [(200 * t + 10 * f, 100 + t, 40 + 9 * t, 90 + 15 * t) for f in range(4) for t in range(17)]
    forms = {
        "": lambda x, y, w, h: (x, y, w, h),
        "corners": lambda x, y, w, h: (x, y, x + w, y + h),
        "fractions or per cents of the picture (x, y": lambda x, y, w, h: (x / 3760, y / 480, w / 3760, h / 480),
        "fractions or per cents of the picture (x1": lambda x, y, w, h: (
            x / 3760,
            y / 480,
            (x + w) / 3760,
            (y + h) / 480,
        ),
        "centres": lambda x, y, w, h: (x + w / 2, y + h / 2, w, h),
        "fractions or per cents": lambda x, y, w, h: (x / 37.6, y / 4.8, w / 37.6, h / 4.8),
        # Only one of five people has corners.
        "corners (x1": lambda x, y, w, h: (x, y, x + w, y + h) if x % 5 == 0 and x >= 2720 else (x, y, w, h),
    }
    for number, (form, change) in enumerate(forms.items()):
        layer = {f: [person(t, change(*boxes[17 * f + t])) for t in range(17)] for f in range(4)}
        _, (report,) = load_reported(tmp_path / str(number), {"yard-1": {"2d": layer}})
        found = [line.removeprefix("2D boxes look like ")[: len(form)] for line in report.warnings]
        assert (found, report.boxes) == ([form] if form else [], 68)


def test_a_recording_under_a_second_name_gets_a_note(tmp_path):
    layer = {f: [person(t, (200 * t + 10 * f, 100 + t, 40, 90)) for t in range(8)] for f in range(6)}
    moved = {f: [person(t, (200 * t + 10 * f + 1, 100 + t, 40, 90)) for t in range(8)] for f in range(6)}
    # The copy begins later, and its people have other numbers.
    again = {f - 2: [person(9 - t, (200 * t + 10 * f, 100 + t, 40, 90)) for t in range(8)] for f in range(2, 6)}
    world = {"copy": {"2d": again}, "other": {"2d": moved}, "yard": {"2d": layer}}
    *_, root = load_reported(tmp_path, world)[1]
    assert [line.partition(":")[0] for line in root.warnings] == ["copy and yard have the same boxes"]
    assert run(tmp_path / "printed", world).endswith("; notes: 1, above\n")
