"""Sets of choices: no two members overlap, and which member is true cannot be told from the set."""

import hashlib
import json
from collections import Counter, defaultdict
from itertools import combinations

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.generate.blind import FEW
from jrdb_avr.engine.generate.distractors import APART
from jrdb_avr.engine.generate.selection import POOL, select, with_choices
from jrdb_avr.schema.labels import POSES, answer_of_choice, choice_text, overlapping
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.wording.text import question_id

PUBLIC = ("sequence", "family", "template", "question", "choices", "answer_mode")


def candidate(number, answer, sets=None, template="change", family="unique_anchor"):
    """A row of the pool: a person of its own, and every set of choices that holds the answer."""
    row = {
        "sequence": "s",
        "family": family,
        "template": template,
        "form": template,
        "question": f"question {number}",
        "answer_mode": "multiple_choice",
        "target_track": number,
        "key": hashlib.sha256(str(number).encode()).hexdigest(),
        "answer_text": answer,
        "plan": "",
        "stated": [],
        "times": [0, 60],
        "read_frames": [60],
        "sets": [],
    }
    for one in sets or [one for one in APART if answer in one]:
        texts = [choice_text(pose) for pose in one]
        mistakes = [None if pose == answer else f"mistake {pose}" for pose in one]
        row["sets"].append(json.dumps({"texts": texts, "true": one.index(answer) + 1, "perturbations": mistakes}))
    return row


def chosen(counts, profile="all", **more):
    rows = [
        candidate(100 * i + n, pose, **more) for i, (pose, count) in enumerate(counts.items()) for n in range(count)
    ]
    pool = pa.Table.from_pylist(rows, schema=POOL)
    numbered = pool.append_column("row", pa.array(range(len(rows)), pa.int64()))
    return with_choices(pool, select(numbered, Rules(), profile, 0).table)


def guessed(rows):
    """Right answers of somebody who knows which answer is true most often with each set of choices."""
    by_set = defaultdict(Counter)
    for row in rows:
        by_set[frozenset(row["choices"])][row["answer_text"]] += 1
    return sum(max(answers.values()) for answers in by_set.values())


def test_no_two_poses_of_a_set_overlap_and_each_pose_has_sets():
    for one in APART:
        assert len(one) == 4 and not any(b in overlapping(a) for a, b in combinations(one, 2))
    assert {pose for one in APART for pose in one} == set(POSES)


@pytest.mark.slow
@given(st.fixed_dictionaries({pose: st.integers(0, 12) for pose in POSES[:8]}))
@settings(deadline=None, max_examples=30)
def test_the_set_does_not_tell_the_answer(counts):
    rows = chosen(counts)
    # Of few questions no guesser's share is reliable.
    assert len(rows) <= FEW or guessed(rows) <= Rules().max_answer_share * len(rows) + 1e-9


def test_level_answers_all_stay():
    rows = chosen({"walking": 30, "standing": 30, "sitting": 30})
    assert len(rows) == 90 and {tuple(sorted(row["choices"])) for row in rows} == {
        ("lying down", "sitting", "standing", "walking")
    }


def test_two_answers_that_only_exclude_each_other_are_left_out():
    assert chosen({"walking": 50, "standing": 50}) == []


TELLING_SETS = {
    "walking": APART[:1],
    "standing": APART[:1],
    "bending": [one for one in APART if "bending" in one],
}
"""Sets that tell the answer: in the first only walking and standing are ever true."""


def test_a_family_that_lacks_its_number_takes_what_level_answers_allow():
    rows = [
        candidate(100 * i + n, pose, sets, "three_hop", "chain_3hop")
        for i, (pose, sets) in enumerate(TELLING_SETS.items())
        for n in range(40)
    ]
    table = pa.Table.from_pylist([row | {"times": [0], "read_frames": [0]} for row in rows], schema=POOL)
    assert select(table, Rules(), "all", 0).table.num_rows == FEW
    assert Counter(select(table, Rules(), "paper", 0).table["answer_text"].to_pylist()) == dict.fromkeys(
        TELLING_SETS, 40
    )


def test_a_template_has_its_even_share_before_another_fills_for_it():
    poses = [(pose, sets, "later_action") for pose, sets in TELLING_SETS.items() for _ in range(40)]
    poses += [(pose, APART[:1], "consequence") for pose in APART[0] for _ in range(40)]
    rows = [candidate(n, pose, sets, name, "long_range") for n, (pose, sets, name) in enumerate(poses)]
    table = pa.Table.from_pylist(rows, schema=POOL)
    # Of 30 questions each of three templates has ten, of which three answers with 34 % each make nine; gap has none.
    chosen = Counter(select(table, Rules(), "paper", 0).table["template"].to_pylist())
    assert chosen == {"later_action": 9, "consequence": 21}


def test_the_record_follows_the_chosen_set():
    rows = chosen(
        {"walking": 9, "standing": 9, "sitting": 9, "cycling": 9, "bending": 9, "going upstairs": 9, "lying": 9}
    )
    assert rows
    for row in rows:
        true = json.loads(row["answer"])["choice"] - 1
        assert answer_of_choice(row["choices"][true]) == row["answer_text"]
        assert row["question_id"] == question_id(**{name: row[name] for name in PUBLIC})
        for place, mistake in enumerate(json.loads(row["distractors"])):
            assert mistake == (None if place == true else f"mistake {answer_of_choice(row['choices'][place])}")
