"""`load` says per layer what is found, what is complete, and what is unlike every known release."""

import msgspec

from jrdb_avr.loaders.releases import _FRAMES, compare_releases
from jrdb_avr.loaders.report import FrameRange, Heading, SequenceReport


def reports(**changed):
    made = []
    for name, (split, count) in _FRAMES.items():
        if split == "train":
            frames = FrameRange(0, count - 1, count)
            report = SequenceReport(name, [], layers=["2d", "3d"], label_frames=frames, visibility="attributes")
            report.heading = Heading(200, 10.0)
            made.append(report)
    for name, value in changed.items():
        setattr(made[0], name, value)
    return made


def unlike(**changed):
    return {row["layer"]: row["unlike"] for row in compare_releases(reports(**changed))}


def test_a_whole_split_is_complete_and_like_a_release():
    rows = compare_releases(reports())
    assert rows == [{"layer": name, "sequences": 27, "complete": "train", "unlike": ""} for name in ("2d", "3d")]
    assert {split: sum(n for of, n in _FRAMES.values() if of == split) for split in ("train", "test")} == {
        "train": 27_893,
        "test": 27_661,
    }
    count = _FRAMES[reports()[0].sequence][1]
    assert unlike(label_frames=FrameRange(2, count + 1, count)) == {"2d": "", "3d": ""}


def test_differences_are_named():
    assert unlike(visibility="geometry")["2d"] == "no occlusion attributes (1)"
    assert unlike(label_frames=FrameRange(0, 9000, 9001))["2d"] == "more frames (1)"
    assert unlike(heading=Heading(200, 170.0))["3d"] == "reversed headings (1)"
    assert unlike(sequence="mine_0") == {"2d": "another sequence (1)", "3d": "another sequence (1)"}
    assert compare_releases(reports(layers=["2d"]))[1]["complete"] == ""
    assert compare_releases([SequenceReport("mine_0", [], layers=["2d"])]) == []
    assert msgspec.to_builtins(reports()[0])["layers"] == ["2d", "3d"]
