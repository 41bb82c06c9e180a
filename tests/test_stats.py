"""`stats` against DuckDB over the same files."""

import json

import duckdb
import pytest
from click.testing import CliRunner

from jrdb_avr.engine.commands.stats import command
from jrdb_avr.engine.stats import TITLES, statistics


@pytest.fixture(scope="module")
def tables(sample_benchmark):
    return statistics(sample_benchmark)


@pytest.fixture(scope="module")
def ask(sample_benchmark):
    connection = duckdb.connect()
    for name in ("questions", "answers", "rejected"):
        connection.execute(f"CREATE VIEW {name} AS SELECT * FROM '{sample_benchmark.question_path(name)}'")
    return lambda text: connection.sql(text).fetchall()


def test_counts(tables, ask):
    assert list(tables) == list(TITLES)
    for name, columns in (("family", "family"), ("template", "family, template, answer_mode")):
        counted = [tuple(row.values())[:-1] for row in tables[name]]
        assert counted == ask(f"SELECT {columns}, count(*) FROM questions GROUP BY ALL ORDER BY ALL")
        assert sum(row["share"] for row in tables[name]) == pytest.approx(1)
    people = ask(
        "SELECT sequence, count(*), count(DISTINCT target_track) FROM questions JOIN answers USING (question_id) "
        "GROUP BY ALL ORDER BY ALL"
    )
    assert [(row["sequence"], row["n"], row["people asked about"]) for row in tables["sequence"]] == people


def test_answers_and_positions(tables, ask):
    chosen = ask(
        "SELECT template, choices[(answer->>'choice')::int] AS text, count(*) FROM questions JOIN answers "
        "USING (question_id) WHERE answer_mode = 'multiple_choice' GROUP BY ALL ORDER BY ALL"
    )
    printed = [(r["template"], r["answer"], r["n"]) for r in tables["answer"] if not r["answer"].startswith("[")]
    assert sorted(printed) == chosen
    places = ask(
        "SELECT template, (answer->>'choice')::int AS place, count(*) FROM questions JOIN answers USING (question_id) "
        "WHERE answer_mode = 'multiple_choice' GROUP BY ALL ORDER BY ALL"
    )
    assert [(r["template"], r["position"], r["n"]) for r in tables["position"]] == places
    offsets = ask(
        """SELECT template, CASE WHEN wait < 3 THEN '[0, 3)' WHEN wait < 6 THEN '[3, 6)' WHEN wait < 10 THEN '[6, 10)'
        WHEN wait < 15 THEN '[10, 15)' WHEN wait < 21 THEN '[15, 21)' ELSE '[21, inf)' END AS bin, count(*) FROM (
            SELECT template, (coalesce(answer->>'frame', answer->>'start_frame')::int
                - regexp_extract(question, 'frame (\\d+)', 1)::int) / 15 AS wait
            FROM questions JOIN answers USING (question_id) WHERE answer_mode IN ('frame', 'span', 'frame_viewpoint')
        ) GROUP BY ALL ORDER BY ALL"""
    )
    printed = [(r["template"], r["answer"], r["n"]) for r in tables["answer"] if r["answer"].startswith("[")]
    assert sorted(printed) == offsets


def test_spread_and_refusals(tables, ask):
    for name in ("time_gap_s", "separation_deg", "people_in_scene"):
        expected = ask(
            f"SELECT template, min({name}), median({name}), max({name}) "
            "FROM questions JOIN answers USING (question_id) GROUP BY ALL ORDER BY ALL"
        )
        printed = [(r["template"], r["min"], r["median"], r["max"]) for r in tables["spread"] if r["what"] == name]
        assert printed == expected
    refused = ask(
        "SELECT family, template, rule, sum(candidates)::int FROM rejected WHERE kind = 'count' "
        "GROUP BY ALL ORDER BY ALL"
    )
    assert [tuple(row.values()) for row in tables["refusal"]] == refused


def test_distractors_are_the_wrong_choices(tables, ask):
    wrong = ask("SELECT template, 3 * count(*) FROM questions WHERE len(choices) = 4 GROUP BY ALL ORDER BY ALL")
    found = {}
    for row in tables["distractor"]:
        found[row["template"]] = found.get(row["template"], 0) + row["n"]
    assert sorted(found.items()) == wrong


def test_the_blind_check_covers_every_template(tables, ask):
    counts = dict(ask("SELECT template, count(*) FROM questions GROUP BY ALL"))
    assert {row["template"]: row["n"] for row in tables["blind"]} == counts
    assert tables["lacking"] == []


def test_a_missing_layer_is_named(benchmark_copy):
    import msgspec

    manifest = benchmark_copy.manifest()
    name = min(manifest.sequences)
    entry = manifest.sequences[name]
    entry = msgspec.structs.replace(entry, layers=tuple(layer for layer in entry.layers if layer != "3d"))
    benchmark_copy.write_manifest(msgspec.structs.replace(manifest, sequences=manifest.sequences | {name: entry}))
    assert statistics(benchmark_copy)["lacking"] == [
        {"family": "unique_anchor", "template": "distance", "layer": "3d", "sequences without": 1, "sequences": 3}
    ]


def test_json_is_one_array_of_rows(sample_benchmark, tables):
    result = CliRunner().invoke(command, ["--store", str(sample_benchmark.path), "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.output)
    assert len(rows) == sum(map(len, tables.values())) and {row["table"] for row in rows} == {
        k for k, v in tables.items() if v
    }


def test_tables_for_people(sample_benchmark):
    result = CliRunner().invoke(command, ["--store", str(sample_benchmark.path)])
    assert result.exit_code == 0 and "Answering without looking" in result.output
