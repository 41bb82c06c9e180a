"""`stats` against DuckDB over the same files."""

import json
import re
from collections import Counter
from itertools import combinations

import duckdb
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from jrdb_avr.engine.commands.generate import stats
from jrdb_avr.engine.validate.statistics import TITLES, statistics
from jrdb_avr.schema.labels import ACTIONS, choice_text
from jrdb_avr.schema.templates import FAMILIES, TEMPLATES

JOINED = "questions JOIN answers USING (question_id)"
SAID = "MAP {" + ", ".join(f"'{choice_text(action)}': '{action}'" for action in ACTIONS) + "}"
"""Actions by what a choice says."""
ASKS = """CASE answer_mode WHEN 'multiple_choice' THEN 'choice' WHEN 'frame_viewpoint' THEN 'frame and angle'
    WHEN 'number' THEN if(json_extract_string(plan, '$.answer.read') = 'count', 'count', 'seconds')
    ELSE answer_mode END"""


@pytest.fixture(scope="module")
def tables(sample_benchmark):
    return statistics(sample_benchmark)


@pytest.fixture(scope="module")
def ask(sample_benchmark):
    connection = duckdb.connect()
    for name in ("questions", "answers", "rejected"):
        connection.execute(f"CREATE VIEW {name} AS SELECT * FROM '{sample_benchmark.question_path(name)}'")
    return lambda text: connection.sql(text).fetchall()


def columns(rows, *names):
    return [tuple(row[name] for name in names) for row in rows]


def test_counts(tables, ask):
    assert list(tables) == list(TITLES)
    counted = dict(ask("SELECT family, count(*) FROM questions GROUP BY ALL"))
    assert dict(columns(tables["family"], "family", "n")) == dict.fromkeys(FAMILIES.values(), 0) | counted
    assert columns(tables["template"], "family", "template", "asks", "mode", "n", "people", "sequences") == ask(
        f"SELECT family, template, {ASKS} AS asks, answer_mode, count(*), count(DISTINCT (sequence, target_track)), "
        f"count(DISTINCT sequence) FROM {JOINED} GROUP BY ALL ORDER BY ALL"
    )
    assert columns(tables["mode"], "mode", "n") == ask(
        "SELECT answer_mode, count(*) FROM questions GROUP BY ALL ORDER BY ALL"
    )
    assert columns(tables["sequence"], "sequence", "n", "people") == ask(
        f"SELECT sequence, count(*), count(DISTINCT target_track) FROM {JOINED} GROUP BY ALL ORDER BY ALL"
    )
    for name in ("family", "template", "mode", "sequence"):
        assert sum(row["share"] for row in tables[name]) == pytest.approx(1)
    assert sum(row["paper"] for row in tables["family"]) == 2098


def test_answers_and_positions(tables, ask):
    chosen = ask(
        f"SELECT template, coalesce(({SAID})[text], text) AS said, count(*) FILTER (text = "
        f"choices[(answer->>'choice')::int]), count(*) FROM (SELECT *, unnest(choices) AS text FROM {JOINED}) "
        "GROUP BY ALL ORDER BY ALL"
    )
    choices = [row for row in tables["answer"] if row["asks"] == "choice"]
    assert columns(choices, "template", "answer", "n", "offered") == chosen
    counts = [row for row in tables["answer"] if row["asks"] == "count"]
    assert columns(counts, "answer", "n") == ask(
        f"SELECT people::varchar, count(*) FROM (SELECT (answer->>'value')::double::int AS people FROM {JOINED} "
        f"WHERE {ASKS} = 'count') GROUP BY people ORDER BY people"
    )
    times = ask(
        f"""SELECT template, CASE WHEN wait < 3 THEN '[0, 3)' WHEN wait < 6 THEN '[3, 6)' WHEN wait < 10 THEN '[6, 10)'
        WHEN wait < 15 THEN '[10, 15)' WHEN wait < 21 THEN '[15, 21)' ELSE '[21, inf)' END AS bin, count(*) FROM (
            SELECT template, (coalesce(answer->>'frame', answer->>'start_frame')::int
                - regexp_extract(question, 'frame (\\d+)', 1)::int) / 15 AS wait
            FROM {JOINED} WHERE answer_mode IN ('frame', 'span', 'frame_viewpoint')
        ) GROUP BY ALL UNION ALL
        SELECT template, CASE WHEN gap < 5 THEN '[0, 5)' WHEN gap < 10 THEN '[5, 10)' WHEN gap < 20 THEN '[10, 20)'
        WHEN gap < 40 THEN '[20, 40)' ELSE '[40, inf)' END AS bin, count(*) FROM (
            SELECT template, (answer->>'value')::double AS gap FROM {JOINED} WHERE {ASKS} = 'seconds'
        ) GROUP BY ALL"""
    )
    timed = [row for row in tables["answer"] if row["asks"] not in ("choice", "count")]
    assert sorted(columns(timed, "template", "answer", "n")) == sorted(times)
    places = ask(
        f"SELECT template, (answer->>'choice')::int AS place, count(*) FROM {JOINED} "
        "WHERE answer_mode = 'multiple_choice' GROUP BY ALL ORDER BY ALL"
    )
    assert columns(tables["position"], "template", "position", "n") == places
    for table in ("answer", "position"):
        whole = {(row["template"], row.get("asks")) for row in tables[table]}
        assert sum(row["share"] for row in tables[table]) == pytest.approx(len(whole))


@pytest.fixture(scope="module")
def looks(ask):
    """Fewest crops per question: sets of columns at which a crop may begin, smallest first."""
    boxes = {}
    for question, frame, center in ask(
        """SELECT question_id, (box->>'frame')::int, ((box->>'x')::double + (box->>'w')::double / 2 + 3760) % 3760
        FROM (SELECT question_id, unnest(from_json(needed, '["JSON"]')) AS box FROM answers)"""
    ):
        boxes.setdefault((question, frame), set()).add(center)
    found = {}
    for (question, _), centers in boxes.items():
        shown = [{c for c in centers if (c - int(first)) % 3760 <= 480} for first in centers]
        sizes = (size for size in range(1, 9) if any(set().union(*s) == centers for s in combinations(shown, size)))
        found[question] = found.get(question, 0) + next(sizes)
    return found


EDGES = {
    "time_gap_s": "['0', '(0, 5)', '[5, 10)', '[10, 20)', '[20, 40)', '[40, 80)', '80+']"
    "[1 + (v > 0)::int + (v >= 5)::int + (v >= 10)::int + (v >= 20)::int + (v >= 40)::int + (v >= 80)::int]",
    "separation_deg": "['[0, 10)', '[10, 20)', '[20, 45)', '[45, 90)', '[90, 135)', '135+']"
    "[1 + (v >= 10)::int + (v >= 20)::int + (v >= 45)::int + (v >= 90)::int + (v >= 135)::int]",
    "hops": "if(v >= 3, '3+', v::int::varchar)",
    "words": "['0-29', '30-39', '40-49', '50-59', '60-79', '80-99', '100-119', '120+']"
    "[1 + (v >= 30)::int + (v >= 40)::int + (v >= 50)::int + (v >= 60)::int + (v >= 80)::int + (v >= 100)::int"
    " + (v >= 120)::int]",
    "people_in_scene": "['0-9', '10-19', '20-29', '30-39', '40-59', '60-79', '80+']"
    "[1 + (v >= 10)::int + (v >= 20)::int + (v >= 30)::int + (v >= 40)::int + (v >= 60)::int + (v >= 80)::int]",
}

VALUES = {
    "hops": "CASE WHEN family = 'chain_3hop' THEN 3 WHEN starts_with(family, 'chain') THEN 2 "
    "WHEN template = 'later_action' THEN 2 ELSE 0 END",
    "words": "length(question) - length(replace(question, ' ', '')) + 1",
}
"""Measures that no column holds; a fork-join counts as two hops."""


def test_measures(tables, ask, looks):
    measured = {
        name: ask(f"SELECT template, question_id, ({VALUES.get(name, name)})::double FROM {JOINED} ORDER BY ALL")
        for name in EDGES
    }
    # The largest of all angles between two needed boxes, by the cosine of their difference.
    measured["apart_deg"] = ask(
        f"""WITH boxes AS (
            SELECT question_id, ((box->>'x')::double + (box->>'w')::double / 2) / 3760 * 2 * pi() AS angle
            FROM (SELECT question_id, unnest(from_json(needed, '["JSON"]')) AS box FROM answers)
        ), apart AS (
            SELECT a.question_id, degrees(acos(least(1, min(cos(a.angle - b.angle))))) AS v
            FROM boxes a JOIN boxes b USING (question_id) GROUP BY ALL
        ) SELECT template, question_id, v FROM {JOINED} JOIN apart USING (question_id) ORDER BY ALL"""
    )
    measured["crops"] = [(template, one, looks[one]) for template, one, _ in measured["hops"]]
    for name, rows in measured.items():
        values = {}
        for template, _, value in rows:
            values.setdefault(template, []).append(value)
        printed = [row for row in tables["spread"] if row["what"] == name]
        assert [row["template"] for row in printed] == sorted(values)
        for row in printed:
            own = np.array(values[row["template"]])
            expected = (len(own), own.min(), np.median(own), own.mean(), own.max())
            # Near 0 the cosine tells angles no finer than this.
            assert [row[key] for key in ("n", "min", "median", "mean", "max")] == pytest.approx(expected, abs=1e-5)
    for name, bins in EDGES.items():
        printed = {row["bin"]: row["n"] for row in tables["distribution"] if row["what"] == name}
        counted = dict(
            ask(
                f"SELECT {bins} AS bin, count(*) FROM (SELECT {VALUES.get(name, name)} AS v FROM {JOINED}) GROUP BY ALL"
            )
        )
        assert printed == dict.fromkeys(printed, 0) | counted
    printed = [row["n"] for row in tables["distribution"] if row["what"] == "apart_deg"]
    turns = [turn for _, _, turn in measured["apart_deg"]]
    assert printed == np.histogram(turns, [0, 10, 20, 45, 90, 135, 181])[0].tolist()
    printed = {row["bin"]: row["n"] for row in tables["distribution"] if row["what"] == "crops"}
    for crops in range(6):
        assert printed[str(crops)] == sum(count == crops for count in looks.values())
    assert printed["6-7"] == sum(count in (6, 7) for count in looks.values())
    assert printed["12+"] == sum(count >= 12 for count in looks.values())


def test_what_became_of_the_candidates(tables, ask):
    refused = ask("SELECT family, template, rule, sum(candidates)::int FROM rejected GROUP BY ALL ORDER BY ALL")
    rows = ask(
        """SELECT template, sum(n)::int, (sum(n) FILTER (WHERE late))::int, (sum(n) FILTER (WHERE asked))::int FROM (
            SELECT template, count(*) AS n, true AS late, true AS asked FROM questions GROUP BY ALL UNION ALL
            SELECT template, candidates, rule IN ('unconfirmed', 'selection'), false
            FROM rejected
        ) GROUP BY ALL"""
    )
    counted = {template: tuple(n or 0 for n in numbers) for template, *numbers in rows}
    assert {
        row["template"]: (row["candidates"], row["proven"], row["questions"]) for row in tables["shortfall"]
    } == dict.fromkeys(FAMILIES, (0, 0, 0)) | counted
    most = {}
    for _, template, rule, count in refused:
        most[template] = max(most.get(template, (0, "")), (count, rule))
    for row in tables["shortfall"]:
        if row["candidates"] > row["questions"] and " refused " in (row["why"] or ""):
            count, _ = most[row["template"]]
            named, percent = re.search(r"; (\S+) refused (\d+) %", row["why"]).groups()
            assert (count, named) in [(n, rule) for _, name, rule, n in refused if name == row["template"]]
            assert int(percent) == pytest.approx(100 * count / row["candidates"], abs=0.5)


def test_the_blind_check_covers_every_template(tables, ask):
    counts = {
        (name, asks): n
        for name, asks, n in ask(f"SELECT template, {ASKS} AS asks, count(*) FROM {JOINED} GROUP BY ALL")
    }
    found = Counter()
    for row in tables["blind"]:
        found[row["template"], row["asks"]] += row["n"]
    assert found == counts
    assert {row["form"] for row in tables["blind"]} <= set(TEMPLATES)


def test_a_missing_layer_is_named(benchmark_copy):
    manifest = benchmark_copy.manifest()
    name = min(manifest.sequences)
    entry = manifest.sequences[name]
    entry = msgspec.structs.replace(entry, layers=tuple(layer for layer in entry.layers if layer != "3d"))
    benchmark_copy.write_manifest(msgspec.structs.replace(manifest, sequences=manifest.sequences | {name: entry}))
    tables = statistics(benchmark_copy)
    (row,) = (row for row in tables["layer"] if row["layer"] == "3d")
    assert row == {"layer": "3d", "sequences_with": 1, "sequences": 2}
    (row,) = (row for row in tables["shortfall"] if row["template"] == "distance")
    assert row["why"].startswith("skipped, the layer 3d is missing in 1 of 2 sequences")


def test_json_is_one_array_of_rows(sample_benchmark, tables):
    result = CliRunner().invoke(stats, ["--store", str(sample_benchmark.path), "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.output)
    assert len(rows) == sum(map(len, tables.values())) and {row["table"] for row in rows} == {
        k for k, v in tables.items() if v
    }


def test_the_papers_table_of_generators(sample_benchmark, ask):
    """A line per family, equal to what DuckDB counts."""
    result = CliRunner().invoke(stats, ["--store", str(sample_benchmark.path), "--latex"])
    assert result.exit_code == 0, result.output
    lines = [line.removesuffix(r"\\").split("&") for line in result.output.splitlines() if "&" in line]
    head, *lines = [[cell.strip() for cell in line] for line in lines]
    assert head == ["generator", "questions", "templates", "answer mode", "hops", "words"]
    joined = "string_agg(DISTINCT replace({0}, '_', ' '), ', ' ORDER BY replace({0}, '_', ' '))"
    counted = ask(
        f"SELECT replace(replace(family, '_', ' '), 'hop', '-hop'), count(*)::varchar, {joined.format('template')}, "
        f"string_agg(DISTINCT {VALUES['hops']}, ', ' ORDER BY {VALUES['hops']}), avg({VALUES['words']}) "
        "FROM questions GROUP BY family ORDER BY family"
    )
    assert [(*line[:3], line[4]) for line in lines if line[1] != "0"] == [row[:4] for row in counted]
    assert [float(line[5]) for line in lines if line[1] != "0"] == pytest.approx([row[4] for row in counted], abs=0.01)
    assert {line[0]: line[3] for line in lines if line[1] != "0"}["chain hybrid"] == "frame viewpoint"
    assert len(lines) == 7 and result.output.count(r"\midrule") == 1
    assert CliRunner().invoke(stats, ["--store", "S", "--latex", "--json"]).exit_code == 2


def test_tables_for_people(sample_benchmark):
    result = CliRunner().invoke(stats, ["--store", str(sample_benchmark.path)])
    assert result.exit_code == 0 and "Answering without looking" in result.output
