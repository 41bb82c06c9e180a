"""Time-grounded accuracy on twins made by hand, and the same figures by SQL."""

import json

import duckdb
import numpy as np
import pytest
from click.testing import CliRunner
from scored_runs import BOX, ELSEWHERE
from twin_runs import QUESTIONS_ASKED, twin_store

from jrdb_avr.engine.commands.report import report as report_command
from jrdb_avr.engine.pages.report import report_page
from jrdb_avr.engine.report.comparison import report
from jrdb_avr.schema.errors import AvrWarning


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return twin_store(tmp_path_factory.mktemp("twins"))


def test_a_pair_counts_only_if_both_are_right(store):
    run, *guessers = report(store).table("twins")
    # Of four pairs a and b have both answers right, and a alone has both boxes too; 5 of 8 answers are right.
    assert (run["n"], run["sequences"], run["interval"]) == (4, 3, "too few sequences for an interval")
    assert (run["both_answers"], run["both_combined"], run["single"]) == (50.0, 25.0, 62.5)
    assert (run["both_answers_low"], run["both_answers_high"]) == (0.0, 100.0)
    # Three pairs of change and one of presence: (3/12 + 1/4) / 4.
    assert [(row["run"], row["both_answers"], row["single"]) for row in guessers] == [
        ("uniform answers", 6.25, 25.0),
        ("two answers", 12.5, 25.0),
        ("time ignored", 0.0, 50.0),
    ]
    assert {(row["n"], row["label"]) for row in guessers} == {(4, "guesser")}


def test_a_question_without_its_twin_is_left_out(tmp_path):
    run, *_ = report(twin_store(tmp_path, ids=["a1", "b1", "b2", "e"])).table("twins")
    assert (run["n"], run["both_answers"], run["both_combined"], run["single"]) == (1, 100.0, 0.0, 100.0)


def test_a_twin_id_on_three_questions_is_named_and_left_out(tmp_path):
    with pytest.warns(AvrWarning, match="twin_id d: not on exactly two questions"):
        run, *_ = report(twin_store(tmp_path, [*QUESTIONS_ASKED, ("f", *QUESTIONS_ASKED[-2][1:])])).table("twins")
    assert run["n"] == 3


def test_questions_without_twins_have_no_table(tmp_path):
    store = twin_store(tmp_path, [(*row[:3], None, row[4]) for row in QUESTIONS_ASKED])
    assert report(store).table("twins") == []
    for options in ([], ["--markdown"], ["--latex"], ["--json"], ["--table", "all"]):
        result = CliRunner().invoke(report_command, ["--store", str(tmp_path), *options])
        assert result.exit_code == 0 and "twin" not in result.output, result.output
    assert "Time twins" not in report_page(report(store))


def test_every_form_of_the_report_has_it(store):
    def printed(*options):
        result = CliRunner().invoke(report_command, ["--store", str(store.path), *options])
        assert result.exit_code == 0, result.output
        return result.output

    assert "twins\n" in printed() and "time ignored" in printed()
    assert "| time ignored" in printed("--markdown")
    assert "time ignored" in printed("--latex") and "both answers" in printed("--latex")
    rows = json.loads(CliRunner().invoke(report_command, ["-s", str(store.path), "--json"]).stdout)
    assert [row["both_combined"] for row in rows if row["table"] == "twins" and row["label"] != "guesser"] == [25.0]
    assert "run,method" in printed("--csv") and "guesser" not in printed("--csv")
    assert "time ignored" in printed("--csv", "--table", "twins")
    assert "Time twins" in report_page(report(store)) and "time ignored" in report_page(report(store))


def test_methods_are_not_ranked_by_it(store):
    assert set(report(store).table("main")[0]) & {"both_answers", "both_combined", "single"} == set()


def test_random_scores_give_the_figures_of_sql(tmp_path):
    generator = np.random.default_rng(5)
    templates = ("change", "presence")
    asked = []
    for number in range(400):
        template, sequence = templates[generator.integers(2)], f"s{generator.integers(20):02}"
        for twin in range(2):
            given = (int(generator.integers(1, 3)), BOX if generator.integers(3) else ELSEWHERE, 7)
            asked.append((f"{number:03}{twin}", sequence, template, None if number % 7 == 0 else f"t{number}", given))
    store = twin_store(tmp_path, asked)
    run, _, different, _ = report(store).table("twins")
    scores = report(store).scores  # noqa: F841 - DuckDB reads it by name
    pairs = f"""(SELECT a.twin_id, any_value(q.template) AS template, any_value(q.sequence) AS sequence,
        min(answer_score) AS answers, min(combined_score) AS boxes, sum(answer_score) AS single
        FROM scores JOIN '{store.question_path("answers")}' a USING (question_id)
        JOIN '{store.question_path("questions")}' q USING (question_id)
        WHERE a.twin_id IS NOT NULL GROUP BY a.twin_id HAVING count(*) = 2)"""
    (figures,) = duckdb.sql(
        f"""SELECT count(*), count(DISTINCT sequence), 100 * avg(answers), 100 * avg(boxes), 50 * avg(single),
        100 * avg(if(template = 'presence', 1/4, 1/12)) FROM {pairs}"""
    ).fetchall()
    assert (run["n"], run["sequences"]) == figures[:2]
    printed = [run["both_answers"], run["both_combined"], run["single"], different["both_answers"]]
    assert printed == pytest.approx(figures[2:], abs=0.006)
    # The interval by drawing whole sequences, with other draws.
    sums = np.array(duckdb.sql(f"SELECT count(*), sum(answers) FROM {pairs} GROUP BY sequence").fetchall(), float)
    drawn = sums[generator.integers(len(sums), size=(20000, len(sums)))].sum(axis=1)
    bounds = np.quantile(100 * drawn[:, 1] / drawn[:, 0], [0.025, 0.975])
    assert [run["both_answers_low"], run["both_answers_high"]] == pytest.approx(bounds, abs=0.7)
