"""The profile lite: nested in the profile paper, of its size, stratified, and the same in any order."""

import json
import shutil
from collections import Counter

import pyarrow as pa
import pytest
from keyframe_layers import layers_in_memory
from processes import run

from jrdb_avr.engine.generate import lite
from jrdb_avr.engine.generate.run import generate
from jrdb_avr.queries.store import Store


def made_up(order=1):
    """1,000 questions of two templates, each tenth one half of a pair of time twins."""
    rows = []
    for number in range(1000):
        pair = number // 2 if number % 20 in (0, 1) else None
        answer = "abcd"[(number // 2) % 4]
        rows.append(
            {
                "question_id": f"{number:016x}",
                "template": "change" if number < 800 else "two_hop",
                "answer": json.dumps({"choice": 1}),
                "choices": [answer, "x", "y", "z"],
                "sequence": f"s{number % 7}",
                "twin_id": None if pair is None else f"twin {pair}",
            }
        )
    return pa.Table.from_pylist(rows[::order])


def test_lite_has_its_size_and_keeps_the_shares_of_templates_answers_and_twins():
    questions = made_up()
    report = [{"template": name, "reached": 0, "twins": 0} for name in ("change", "two_hop")]
    left = Counter()
    kept, rows = lite.thin(questions, report, left)
    assert len(kept) == 240 and left.total() == 760
    templates = Counter(kept["template"].to_pylist())
    assert abs(templates["change"] - 192) <= 2
    answers = Counter(choices[0] for choices in kept["choices"].to_pylist())
    assert max(answers.values()) - min(answers.values()) <= 6
    twins = Counter(kept["twin_id"].to_pylist())
    assert {twins[name] for name in twins if name} == {2} and 240 - twins[None] == 24
    assert [row["reached"] for row in rows] == [templates["change"], templates["two_hop"]]
    assert sum(row["twins"] for row in rows) == 12
    backwards, _ = lite.thin(made_up(-1), report, left)
    assert sorted(backwards["question_id"].to_pylist()) == sorted(kept["question_id"].to_pylist())


@pytest.mark.parametrize("size", [20, 10_000])
def test_lite_is_nested_in_paper_and_has_another_hash(twin_benchmark, tmp_path, monkeypatch, size):
    monkeypatch.setattr(lite, "LITE_SIZE", size)
    store = Store(shutil.copytree(twin_benchmark.path, tmp_path / "store", ignore=shutil.ignore_patterns("questions")))
    with layers_in_memory():
        made = generate(store, profile="lite", workers=1)
    full, part = (own.questions("questions") for own in (twin_benchmark, store))
    assert set(part.to_pylist()[0]) == set(full.to_pylist()[0])
    assert set(part["question_id"].to_pylist()) <= set(full["question_id"].to_pylist())
    assert len(part) == sum(row["reached"] for row in made.rows()) == min(size, len(full))
    lines = [run("stats", "--hash", "--store", own.path)[1] for own in (twin_benchmark, store)]
    assert lines[1].startswith(f"{len(part)} questions, generation ") and (lines[0] == lines[1]) is (size > 20)
    count = [
        sum(own.questions("rejected")["candidates"].to_pylist()) + len(own.questions("questions"))
        for own in (twin_benchmark, store)
    ]
    assert count[0] == count[1]
