"""Chance and the blind guessers below the runs: on questions with a chance known on paper, and in every format."""

import csv
import io
import json

import pytest
from click.testing import CliRunner
from scored_runs import BOX, Benchmark

from jrdb_avr.engine.commands.report import report as report_command
from jrdb_avr.engine.generate.blind import QuestionText, score_forms
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.engine.report.side_by_side import paper_rows
from jrdb_avr.engine.report.tables import breakdown_rows, main_rows
from jrdb_avr.engine.run.imported import import_predictions
from jrdb_avr.engine.validate.references import read_references
from jrdb_avr.schema.answers import Choice, FrameAnswer
from jrdb_avr.schema.references import make_references
from jrdb_avr.schema.templates import TEMPLATES

NAMES = ["pure chance", "text only", "box only"]


def test_chance_is_averaged_over_the_questions_of_a_table_that_have_choices():
    ids = ("a", "b", "c", "d")
    benchmark = Benchmark([(name, "s", "chain_2hop" if name < "c" else "unique_anchor") for name in ids])
    four, two = ("walking", "standing", "sitting", "cycling"), ("walking", "standing")
    texts = [
        *(QuestionText(name, "s", TEMPLATES["two_hop"], four, (), (0,), Choice(1)) for name in "ab"),
        QuestionText("c", "s", TEMPLATES["change"], two, (), (0, 30), Choice(1)),
        QuestionText("d", "s", TEMPLATES["start"], (), (), (0,), FrameAnswer(30)),
    ]
    benchmark.index.references = references = make_references(False)[:1]
    for group, scores in score_forms(texts, []):
        references[0].add([question.question_id for question in group], scores)
    run = benchmark.run([(1, BOX, 7)] * 4, model="Qwen3.5-9B")
    rows = main_rows(benchmark.index, [run], 0.5)
    # (1/4 + 1/4 + 1/2) / 3; the question without choices is not counted.
    assert rows[1:] == [{"run": "pure chance", "method": "", "model": "", "label": "guesser", "n": 3, "answer": 33.33}]
    by_family = breakdown_rows(benchmark.index, [run], "family")
    assert [(row["family"], row["n"], row["answer"]) for row in by_family if row["label"]] == [
        ("chain_2hop", 2, 25.0),
        ("unique_anchor", 1, 50.0),
    ]
    beside = paper_rows("paper_main", benchmark.index, [run])
    assert [(row["run"], row["n"]) for row in beside if row["label"] == "guesser"] == [("pure chance", 3)]
    assert all(row["label"] != "guesser" for row in paper_rows("paper_main", benchmark.index, []))


@pytest.fixture
def store(benchmark_copy, tmp_path):
    questions = benchmark_copy.questions("questions", ["question_id"]).to_pylist()
    lines = (json.dumps(row | {"answer": {"choice": 1}}) for row in questions)
    (tmp_path / "r.jsonl").write_text("\n".join(lines))
    import_predictions(benchmark_copy, tmp_path / "r.jsonl", "r")
    return benchmark_copy


def test_every_format_has_the_three_rows_below_the_runs(store, tmp_path):
    def printed(*options):
        result = CliRunner().invoke(report_command, ["--store", str(store.path), *options])
        assert result.exit_code == 0, result.output
        return result.stdout

    for options in ([], ["--markdown"], ["--latex"]):
        assert all(name in printed(*options) for name in NAMES), options
    rows = [row for row in json.loads(printed("--json")) if row["table"] == "main"]
    assert [row["run"] for row in rows] == ["r", *NAMES]
    _, chance, text, box = rows
    assert chance["answer"] == 25.0 and chance["n"] < text["n"] == box["n"] == rows[0]["n"]
    assert text["answer"] >= 25.0 and "evidence" not in text and "answer" not in box and 0 < box["evidence"] < 100
    lines = list(csv.DictReader(io.StringIO(printed("--csv", "--table", "answer_mode"))))
    without = [row for row in lines if row["answer_mode"] == "span" and row["run"] == "pure chance"]
    assert [(row["n"], row["answer"]) for row in without] == [("0", "")]
    printed("--html", str(tmp_path / "report.html"))
    page = (tmp_path / "report.html").read_text()
    assert all(f'<th scope="row">{name}' in page for name in NAMES) and "<tfoot>" in page


def as_papers_agent(store):
    # Columns of the terminal are as wide as the longest name needs.
    (store.path / "runs/r").rename(store.path / "runs/of-the-agent")
    path = store.path / "runs/of-the-agent/run.json"
    own = {"run_id": "of-the-agent", "method": "agent", "model": "Qwen/Qwen3.5-9B"}
    path.write_text(json.dumps(json.loads(path.read_text()) | own))


@pytest.mark.parametrize("form", ["", "--markdown", "--latex", "--html"])
def test_the_papers_tables_of_scores_have_the_three_rows_in_every_format(store, tmp_path, form):
    as_papers_agent(store)
    page = tmp_path / "report.html"
    options = [form, str(page)] if form == "--html" else [form] if form else []
    arguments = ["--store", str(store.path), "--paper", "--as", "Qwen3.5 9B", *options]
    result = CliRunner().invoke(report_command, arguments)
    assert result.exit_code == 0, result.output
    text = page.read_text().split('<h2 id="pairs">')[0] if form == "--html" else result.stdout
    begins = [text.index(f"Table {number} of the paper") for number in (3, 4, 5, 6)]
    parts = [text[begin:end] for begin, end in zip(begins, [*begins[1:], None], strict=True)]
    assert [[name in part for name in NAMES] for part in parts] == [[True] * 3, [True] * 3, [False] * 3, [True] * 3]
    assert form != "--html" or '<th class="num">paper answer</th>' in parts[0]


def test_a_report_without_references_and_a_store_without_intervals_have_none(store, tmp_path):
    assert [row["run"] for row in report(store).table()] == ["r"]
    (store.path / "intervals").rename(tmp_path / "intervals")
    assert read_references(store) == []
