"""Questions of a small sample world can be answered by looking: one who sees perfectly scores 100 %.

Some of every template are tried, and all with `-m slow`. The whole sample is put to the same test, through its
panoramas, by `tests/benchmarks/solvability.py`.
"""

import dataclasses
import json
from collections import Counter

import numpy as np
import pytest
from fact_teller import Teller
from perfect_perception import take

from jrdb_avr.queries.questions import read_question_rows, read_sequences
from jrdb_avr.schema.method import Observation
from jrdb_avr.schema.panorama import crop_left
from jrdb_avr.schema.templates import TEMPLATES

NOTHING = np.zeros((1, 1, 3), np.uint8)


def observe(sequence, frame, angle):
    """Where a crop is; its pixels are not needed."""
    return Observation(sequence, frame, f"{frame:06d}", frame / 15, angle, 45.96, int(crop_left(angle)), NOTHING)


@pytest.fixture(scope="module")
def asked(sample_benchmark):
    """The questions, and all that one who takes them is given but what there is to see."""
    # The sample has no pictures: every frame may be looked at.
    sequences = {
        name: dataclasses.replace(info, frames=tuple(range(info.frame_count)))
        for name, info in read_sequences(sample_benchmark).items()
    }
    return sample_benchmark, read_question_rows(sample_benchmark), sequences


@pytest.fixture(scope="module")
def some(asked):
    """Four questions of each template, or as many as there are, of one sequence."""
    _, questions, sequences = asked
    name, counts = max(sequences), Counter()
    found = []
    for question in questions:
        if question.sequence == name and counts[question.template] < 4:
            counts[question.template] += 1
            found.append(question)
    assert set(counts) == {template.name for template in TEMPLATES.values()}
    return found


@pytest.fixture(scope="module")
def teller(sample_benchmark):
    return Teller(sample_benchmark.path.parent / "root")


def check(asked, teller, questions):
    store, _, sequences = asked
    rows = take(store, teller, questions, sequences, observe)
    assert [row for row in rows if not row["answer_score"] or not row["evidence_score"]] == []
    # No one look shows a whole scene.
    assert min(row["n_observations"] for row in rows) >= 8


def test_a_question_of_each_template_can_be_answered_by_looking(asked, some, teller):
    check(asked, teller, some)


@pytest.mark.slow
def test_every_question_can_be_answered_by_looking(asked, teller):
    check(asked, teller, asked[1])


def test_nothing_is_known_but_what_is_seen(asked, some):
    store, _, sequences = asked
    rows = take(store, lambda observation: [], some[:30], sequences, observe)
    assert {row["status"] for row in rows} == {"invalid"}
    assert not any(row["answer_score"] or row["evidence_score"] for row in rows)


def test_a_crop_tells_of_those_in_clear_view_inside_it(some, teller):
    """Beside the label file itself: who is visible, and on which columns."""
    name = some[0].sequence
    labels = json.loads((teller.root / "labels" / "labels_2d_stitched" / f"{name}.json").read_text())["labels"]
    told = 0
    for frame in range(0, 450, 45):
        for angle in (0, 100, 222.5):
            left = round(angle / 360 * 3760) - 240
            crop = {(left + column) % 3760 for column in range(480)}
            inside = {}
            for one in labels[f"{frame:06d}.jpg"]:
                x, _, w, h = one["box"]
                columns = {(round(x) + column) % 3760 for column in range(round(w))}
                visible = one["attributes"].get("occlusion") in ("Fully_visible", "Mostly_visible")
                if visible and w >= 12 and h >= 40 and not one["attributes"]["no_eval"]:
                    inside[int(one["label_id"].split(":")[1])] = columns & crop, len(columns)
            seen = {one.name: one for one in teller(observe(name, frame, angle))}
            assert set(seen) == {track for track, (shared, width) in inside.items() if 2 * len(shared) >= width}
            for track, one in seen.items():
                assert round(one.box[2]) == len(inside[track][0])
                told += 1
    assert told > 20
