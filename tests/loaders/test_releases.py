"""`load` says per layer what is found, what is complete, and what is unlike every known release."""

import json

import pytest

from jrdb_avr.loaders.releases import PUBLIC, compare_releases, odd_values
from jrdb_avr.loaders.report import FrameRange, Heading, SequenceReport

OCCLUSIONS = {"Fully_visible": 292, "Mostly_visible": 145, "Severely_occluded": 312, "Fully_occluded": 251}


def reports(split="train", first=0, **changed):
    made = []
    for name, public in PUBLIC.items():
        if public.split == split:
            frames = FrameRange(first, first + public.frames - 1, public.frames, 18 * public.boxes)
            report = SequenceReport(name, [], layers=["2d", "3d"], ranges={"2d": frames, "3d": frames})
            report.steps, report.people, report.occlusions = {"2d": 1, "3d": 1}, public.tracks, OCCLUSIONS
            report.files = {"2d": "labels_2d_stitched/x.json", "3d": "labels_3d/x.json"}
            report.heading = Heading(200, 10.0)
            made.append(report)
    for name, value in changed.items():
        setattr(made[0], name, value)
    return made


def rows_of(*arguments, **changed):
    return {row["layer"]: row for row in compare_releases(reports(*arguments, **changed))}


def unlike(**changed):
    return {layer: row["unlike"] for layer, row in rows_of(**changed).items() if row["found"] != "nothing"}


def test_a_whole_split_is_complete_and_like_a_release():
    for arguments, found in ((["train"], "27 train (2022)"), (["train", 2], "27 train (2019)"), (["test"], "27 test")):
        rows = rows_of(*arguments)
        assert {row["found"] for row in rows.values()} == {found, "nothing"}
        for layer in ("2d", "3d"):
            assert (rows[layer]["complete"], rows[layer]["unlike"]) == (arguments[0], "")
    assert (rows["pose"]["found"], rows["pose"]["complete"]) == ("nothing", "no")
    for split, frames, tracks, boxes in (("train", 27_893, 1676, 48_330), ("test", 27_661, 1637, 54_465)):
        public = [entry for entry in PUBLIC.values() if entry.split == split]
        sums = tuple(sum(entry[column] for entry in public) for column in (1, 2, 3))
        assert sums[:2] == (frames, tracks) and abs(sums[2] - boxes) < 400


def test_differences_are_named():
    def frames(*numbers, records=99_999):
        return {"2d": FrameRange(*numbers, records), "3d": FrameRange(0, 1725, 1726)}

    assert unlike(ranges=frames(0, 9000, 9001))["2d"] == "more frames (1)"
    assert unlike(ranges=frames(0, 900, 901))["2d"] == "fewer frames (1)"
    assert unlike(ranges=frames(0, 1725, 1720))["2d"] == "missing frames (1)"
    assert unlike(ranges=frames(0, 1725, 1726, records=2420))["2d"] == "fewer boxes (1)"
    assert unlike(ranges=frames(15, 1725, 115, records=2420), steps={"2d": 15})["2d"] == "keyframes only (1)"
    assert unlike(people=33)["2d"] == "fewer tracks (1)"
    assert unlike(odd_values={"3d": ["str in box.cx"]})["3d"] == "str in box.cx (1)"
    assert unlike(files={"2d": "boxes/x.json", "3d": "labels_3d/x.json"})["2d"] == "folder boxes (1)"
    assert unlike(heading=Heading(200, 170.0))["3d"] == "reversed headings (1)"
    assert unlike(sequence="mine_0") == {"2d": "another sequence (1)", "3d": "another sequence (1)"}
    assert rows_of(layers=["2d"])["3d"]["complete"] == "no"
    assert compare_releases([SequenceReport("mine_0", [], layers=["2d"])]) == []


def test_sums_of_a_whole_split_are_compared():
    assert "other shares of occlusion" in rows_of("test", occlusions={"Fully_visible": 99_999})["2d"]["unlike"]
    few = reports()
    for report in few:
        report.layers, report.ranges["interactions"] = ["interactions"], FrameRange(0, 400, 401, 9)
    assert [row["unlike"] for row in compare_releases(few) if row["layer"] == "interactions"] == [
        "fewer records than 1,452,876"
    ]


@pytest.mark.parametrize("frame", [{}, {"label_id": "pedestrian:1"}, 3, None, "x", [], [3], [[]]])
def test_a_file_of_any_shape_is_compared(tmp_path, frame):
    (tmp_path / "a.json").write_text(json.dumps({"labels": {"000000.jpg": frame}}))
    for layer in ("2d", "3d", "social", "toys"):
        assert all(line.startswith("no ") for line in odd_values(layer, tmp_path / "a.json"))
