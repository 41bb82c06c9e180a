"""A reader of the public text and the raw labels finds every stored answer, and no other.

The reader (`text_reader`) has no plan and shares no code with the program. It takes ambiguous words in each ordinary
way: a question passes when all of them single out the stored person and score against the stored answer.
"""

import ast
import json
import re
from dataclasses import replace

import pytest
from environment import SUPPORT, copy_real, needs_real
from keyframe_layers import ANY_VIEW
from question_files import all_evidence
from text_reader import Found, Reader, differs
from text_reader_language import Reading, parse

from jrdb_avr.engine.generate.run import generate
from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answer_modes import decode_answer, same_answer
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.wording.text import render


class Benchmark:
    """Public questions of a store with their private answers, and a reader of each sequence."""

    def __init__(self, store, root):
        self.answers = {row["question_id"]: row for row in store.questions("answers").to_pylist()}
        self.rows = sorted(store.questions("questions").to_pylist(), key=lambda row: row["sequence"])
        self.boxes = {}
        for row in all_evidence(store).to_pylist():
            self.boxes.setdefault(row["question_id"], {})[row["frame"]] = tuple(row[side] for side in "xywh")
        self.readers = {sequence: Reader(root, sequence) for sequence in {row["sequence"] for row in self.rows}}

    def stored(self, row):
        answer = self.answers[row["question_id"]]
        return Found(answer["target_track"], json.loads(answer["answer"]))


def wrong_answers(answer, choices):
    """Answers that score 0 against one, most of them barely."""
    if "choice" in answer:
        return [{"choice": choice + 1} for choice in range(len(choices)) if choice + 1 != answer["choice"]]
    if "value" in answer:
        return [{"value": answer["value"] * factor} for factor in (0.49, 2.01)]
    if "start_frame" in answer:
        first, last = answer["start_frame"], answer["end_frame"]
        way = (last - first + 1) // 3 + 1
        return [{"start_frame": first + by, "end_frame": last + by} for by in (-way, way) if first + by >= 0]
    moved = [{**answer, "frame": answer["frame"] + by} for by in (-16, 16)]
    turned = [{**answer, "angle_deg": (answer["angle_deg"] + by) % 360} for by in (-21, 21) if "angle_deg" in answer]
    return moved + turned


def check(benchmark):
    """Every stored answer is found under every held reading, and what scores 0 or is of another person is flagged."""
    for row in benchmark.rows:
        stored, reader = benchmark.stored(row), benchmark.readers[row["sequence"]]
        assert not reader.disputes(row["question"], row["choices"], stored), row["question"]
        found = reader.find(parse(row["question"]), row["choices"], Reading())
        for wrong in wrong_answers(stored.answer, row["choices"]):
            encoded = (decode_answer(row["answer_mode"], json.dumps(one)) for one in (wrong, stored.answer))
            assert not same_answer(*encoded)
            assert differs(found, Found(stored.target, wrong)), (row["question"], wrong)
        own = {
            frame: people[found.target].box
            for frame, people in reader.recording.frames.items()
            if found.target in people
        }
        assert own == benchmark.boxes[row["question_id"]]


def test_reader_finds_every_answer_of_the_sample(sample_benchmark):
    benchmark = Benchmark(sample_benchmark, sample_benchmark.path.parent / "root")
    assert len({row["template"] for row in benchmark.rows}) == 12
    check(benchmark)


def test_time_twins_differ_in_one_time_and_each_answer_is_false_in_the_other(twin_benchmark):
    """They have the same description of the same person, and the same choices in the same order."""
    benchmark = Benchmark(twin_benchmark, twin_benchmark.path.parent / "root")
    check(benchmark)
    pairs = {}
    for row in benchmark.rows:
        answer = benchmark.answers[row["question_id"]]
        if twin := answer["twin_id"]:
            pairs.setdefault(twin, []).append((row, benchmark.stored(row)))
    assert {row["template"] for pair in pairs.values() for row, *_ in pair} == {"change", "presence", "later_action"}
    for (row, own), (other, its) in pairs.values():
        assert own.target == its.target and row["choices"] == other["choices"] and own.answer != its.answer
        pieces = [re.split(r"(\S+ s \(frame [0-9]+\))", question["question"]) for question in (row, other)]
        assert sum(piece != moved for piece, moved in zip(*pieces, strict=True)) == 1
        for question, answer in ((row, its.answer), (other, own.answer)):
            found = benchmark.readers[row["sequence"]].find(parse(question["question"]), row["choices"], Reading())
            assert differs(found, Found(own.target, answer))


def test_every_paraphrase_of_a_question_is_read_alike(sample_benchmark):
    plans = {row["question_id"]: parse_plan(row["plan"]) for row in sample_benchmark.questions("answers").to_pylist()}
    for row in sample_benchmark.questions("questions").to_pylist():
        plan = plans[row["question_id"]]
        for key in range(6):
            read = parse(render(row["template"], plan, f"{key:064x}", in_view=True))
            assert read == parse(row["question"])
            unjudged = parse(render(row["template"], plan, f"{key:064x}"))
            assert unjudged == replace(read, judged=False)


@needs_real
@pytest.mark.parametrize(
    ("rules", "most"), [(Rules(), 2), (ANY_VIEW, 2), pytest.param(Rules(), None, marks=pytest.mark.slow)]
)
def test_reader_finds_every_answer_of_real_sequences(tmp_path, rules, most):
    copy_real(tmp_path, last=most)
    store = Store(tmp_path / "store")
    load(find_root(tmp_path / "root"), store, rules.load, 1)
    generate(store, rules, workers=1)
    check(Benchmark(store, tmp_path / "root"))


def test_reader_shares_no_code_with_the_program():
    for path in SUPPORT.glob("text_reader*.py"):
        tree = ast.parse(path.read_text())
        names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not [name for name in names if name.startswith("jrdb_avr")]
