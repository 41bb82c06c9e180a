"""Timestamps: entries that contradict themselves or the order are refused; seconds follow the stamps of the images."""

from __future__ import annotations

import json

import numpy as np
import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from loaded_stores import NAME, read_store, reported_store
from worlds import person

from jrdb_avr.loaders.intervals.timeline import Clock

START = 1_549_578_400.25


def layers_of(stamps, frames):
    """A walk of one person, with a file of timestamps."""
    walk = {f: [person(1, (100 + f, 60, 50, 200), {"walking": 1})] for f in range(frames)}
    return {"2d": walk, "timestamps": stamps}


def loaded(tmp_path, stamps):
    """Store and report of a walk of 60 frames."""
    return reported_store(tmp_path, layers_of(stamps, 60))


def read(tmp_path, stamps):
    """The same, its files only read, of a walk of 10 frames: a store, and the problems."""
    store, found = read_store(tmp_path, layers_of(stamps, 10))
    return store, found.problems


def rows(store, sensor="images"):
    table = store.annotation("timestamps", NAME).to_pylist()
    return [(row["frame"], row["timestamp"]) for row in table if row["sensor"] == sensor]


def seconds(store):
    return {row["frame"]: row["seconds"] for row in store.interval("frames", NAME).to_pylist()}


def test_seconds_follow_the_images_and_intervals_with_them(tmp_path):
    slow = {f: START + f / 10 for f in range(60)}
    store, report = loaded(tmp_path, {"images": slow, "clouds": {f: START + 0.03 + f / 10 for f in range(62)}})
    assert rows(store) == sorted(slow.items())
    assert len(rows(store, "clouds")) == 62
    assert seconds(store) == pytest.approx({f: f / 10 for f in range(60)}, abs=1e-6)
    (run,) = (run for run in store.interval("actions", NAME).to_pylist() if run["action"] == "walking")
    assert (run["first"], run["last"]) == (0, 59)
    assert (run["first_s"], run["last_s"]) == pytest.approx((0, 5.9), abs=1e-6)
    assert (report.stamps.images, report.stamps.clouds) == (60, 62)
    assert report.stamps.fps == pytest.approx(10, abs=1e-3)
    # Stamps that reach further than the labels add no frames to the sequence.
    assert store.interval("sequence", NAME)["frame_count"].to_pylist() == [60]


def test_clouds_alone_leave_the_seconds_to_the_frame_rate(tmp_path):
    store, report = loaded(tmp_path, {"clouds": {f: START + f for f in range(60)}})
    assert seconds(store) == pytest.approx({f: f / 15 for f in range(60)})
    assert report.stamps.fps is None and report.problems == []


@settings(max_examples=examples(25), deadline=None)
@given(st.dictionaries(st.integers(0, 200), st.integers(1, 30), min_size=1, max_size=8), st.integers(0, 250))
def test_frames_without_a_stamp_lie_between_their_neighbours(steps, frame):
    known = sorted(steps)
    stamps = np.cumsum([steps[f] for f in known]).astype(float)

    def epoch(f):
        """Brute force: on the line between the nearest stamped frames, and 1/15 s per frame beyond them."""
        if f <= known[0]:
            return stamps[0] - (known[0] - f) / 15
        if f >= known[-1]:
            return stamps[-1] + (f - known[-1]) / 15
        i = max(i for i, k in enumerate(known) if k <= f)
        return stamps[i] + (f - known[i]) / (known[i + 1] - known[i]) * (stamps[i + 1] - stamps[i])

    clock = Clock(np.array(known), stamps)
    assert clock.seconds(np.array([frame]))[0] == pytest.approx(epoch(frame) - epoch(0), abs=1e-9)


def entry(frame, timestamp, url=None, **more):
    picture = {"name": "stitched_image0", "url": url or f"images/image_stitched/{NAME}/{frame:06d}.jpg"}
    return {"frame_id": frame, "timestamp": timestamp, "cameras": [picture]} | more


GOOD = [entry(f, START + f) for f in (0, 1, 2, 4, 5)]


@pytest.mark.parametrize("frame_id", [3, None])
@pytest.mark.parametrize("url", ["image_stitched/000003.jpg", "000003.png", "somewhere", None])
def test_a_frame_has_its_number_from_the_entry_or_the_file(tmp_path, frame_id, url):
    made = {"frame_id": frame_id, "timestamp": START + 3, "cameras": [{"name": "x", "url": url}]}
    store, problems = read(tmp_path, {"images": json.dumps({"data": [made]})})
    known = frame_id is not None or (url or "").startswith(("image", "000"))
    assert rows(store) == ([(3, START + 3)] if known else [])
    assert sum(problem.count for problem in problems) == (0 if known else 1)


@pytest.mark.parametrize("bad", [entry(3, START + 2), entry(3, START + 900), entry(2, START + 2.5)])
def test_stamps_that_do_not_increase_refuse_the_file(tmp_path, bad):
    store, problems = read(tmp_path, {"images": json.dumps({"data": [*GOOD, bad]}), "clouds": {0: START}})
    assert rows(store) == [] and len(rows(store, "clouds")) == 1
    assert [(p.kind, p.reason) for p in problems] == [
        ("file", "frames_img.json: timestamps do not increase with the frames")
    ]


BROKEN = ["", "[]", "{}", '{"data": {}}', '{"data": 3}', '{"data": [', b"\xff\xfe", "[" * 5000]


@pytest.mark.parametrize("content", BROKEN, ids=range(len(BROKEN)))
def test_a_broken_file_costs_its_stamps_alone(tmp_path, content):
    store, problems = read(tmp_path, {"images": content, "clouds": {0: START, 1: START + 1}})
    assert rows(store) == [] and len(rows(store, "clouds")) == 2
    assert [(p.kind, p.layer) for p in problems] == [("file", "timestamps")]
    assert "frames_img.json" in problems[0].reason
    assert store.annotation("boxes_2d", NAME).num_rows == 10
