"""The command line: help with an example everywhere, one-line errors, exit codes, and machine-readable output."""

import csv
import io
import json
import subprocess
import sys
from pathlib import Path

import click
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from processes import run
from worlds import load_world, person, write_root

from jrdb_avr.engine.cli import COMMANDS, group
from jrdb_avr.queries.graph.handle import build_graph
from jrdb_avr.queries.manifest import Manifest, SequenceEntry
from jrdb_avr.queries.runs import RunManifest, questions_hash, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import EndpointError
from jrdb_avr.schema.graph import scene_ddl
from jrdb_avr.schema.rules import LoadRules, rules_hash
from jrdb_avr.schema.tables import INTERVALS, QUESTIONS, RUNS

COMMAND = Path(sys.executable).with_name("jrdb-avr")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_parameter_has_help(name):
    command = group.get_command(click.Context(group), name)
    assert command.help
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"{name} {parameter.name}"


def test_the_group_lists_every_command():
    result = CliRunner().invoke(group, ["--help"])
    assert result.exit_code == 0
    for name, words in COMMANDS.items():
        assert f"  {name} " in result.output
        assert words.split(";")[0] in " ".join(result.output.split())


def test_the_version_is_told():
    done = subprocess.run([COMMAND, "--version"], capture_output=True, text=True, check=True)
    assert "jrdb-avr" in done.stdout


EVALUATE = ("evaluate", "--store", ".", "--model", "simulated", "--method")


@pytest.mark.parametrize(
    "arguments",
    [
        ("nonsense",),
        ("observe",),
        ("cypher", "--store", "S"),
        ("sql", "SELECT 1"),
        ("report",),
        ("score", "--iou", "2"),
        (*EVALUATE, "monolithic", "--history", "2"),
        (*EVALUATE, "agent", "--history", "2"),
        (*EVALUATE, "agent-no-world", "--advice", "off"),
        (*EVALUATE, "agent", "--prompts", "paper"),
    ],
)
def test_wrong_calls_are_exit_code_2(arguments):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert "Error:" in err
    assert "Traceback" not in err


# -- a small store ----------------------------------------------------------------------------------------------------

BOX = {"x": 10.0, "y": 20.0, "w": 30.0, "h": 90.0}


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    place = Store(tmp_path_factory.mktemp("store") / "S")
    rules = LoadRules()
    entry = SequenceEntry(("2d",), {})
    place.write_manifest(Manifest(None, rules, rules_hash(rules), {"s": entry}, {}))
    with build_graph(place.graph_path) as graph:
        for statement in scene_ddl():
            graph.execute(statement)
        graph.copy("Action", pa.table({"name": ["sitting", "\x1b[31mred"], "pose": [True, False]}))
    sequence = {"sequence": "s", "fps": 15.0, "frame_count": 31, "layers": ["2d"], "action_step": 15}
    sequence |= {"keyframes": [0, 15, 30], "visibility": "nothing"}
    place.write_interval("sequence", "s", pa.Table.from_pylist([sequence], schema=INTERVALS["sequence"]))
    frames = [
        {"sequence": "s", "frame": f, "seconds": f / 15, "keyframe": True, "annotated": True, "image": f == 15}
        for f in (0, 15, 30)
    ]
    place.write_interval("frames", "s", pa.Table.from_pylist(frames, schema=INTERVALS["frames"]))
    write_questions(place)
    write_run(place, "react-a", {"choice": 1}, synthetic=True)
    write_run(place, "react-b", {"choice": 2}, synthetic=False)
    return place


def write_questions(place):
    ids = [f"{n:016x}" for n in range(4)]
    common = {"sequence": "s", "family": "unique_anchor", "template": "change", "question": "Which pose?"}
    rows = [{"question_id": q, **common, "choices": ["a", "b"], "answer_mode": "multiple_choice"} for q in ids]
    place.write_questions("questions", pa.Table.from_pylist(rows, schema=QUESTIONS["questions"]), {})
    sequences = [{"sequence": "s", "fps": 15.0, "frame_count": 31, "frames": [15]}]
    place.write_questions("sequences", pa.Table.from_pylist(sequences, schema=QUESTIONS["sequences"]), {})
    schema = QUESTIONS["answers"]
    blank = {field.name: "" if field.type == pa.string() else 0 for field in schema}
    answers = [blank | {"question_id": q, "answer": '{"choice":1}'} for q in ids]
    place.write_questions("answers", pa.Table.from_pylist(answers, schema=schema), {})
    evidence = [{"sequence": "s", "track": 0, "frame": 15, **BOX}]
    place.write_questions("evidence", pa.Table.from_pylist(evidence, schema=QUESTIONS["evidence"]), {})


def write_run(place, name, answer, synthetic, questions=None):
    """A run of four questions: two answered with evidence, one whose box could not be read, one that failed."""
    ids = [f"{n:016x}" for n in range(4)]
    schema = RUNS["predictions"]
    blank = {field.name: "" if field.type == pa.string() else 0 for field in schema}
    rows = []
    for n, question in enumerate(ids):
        box = {f"evidence_{key}": BOX[key] if n < 2 else None for key in "xywh"}
        status = ("answered", "answered", "invalid", "error")[n]
        row = {"run_id": name, "question_id": question, "status": status, "answer": json.dumps(answer)}
        rows.append(blank | row | box | {"evidence_frame": 15 if n < 2 else None})
    place.write_run(name, "predictions", pa.Table.from_pylist(rows, schema=schema))
    digest = questions or questions_hash(place)
    manifest = RunManifest(name, "react", name[-1], digest, tuple(ids), synthetic, {"budget": 24}, "2020-01-01")
    write_run_manifest(place, manifest)


# -- asking -----------------------------------------------------------------------------------------------------------


def test_json_is_one_array_and_nothing_else(store):
    for arguments in (
        ("cypher", "MATCH (a:Action) RETURN a.name AS name, a.pose AS pose ORDER BY name"),
        ("cypher", "MATCH (a:Action) WHERE a.name = 'none' RETURN a.name AS name ORDER BY name"),
        ("cypher", "MATCH (a:Action) RETURN a"),
        ("sql", "SELECT question_id, choices FROM questions ORDER BY 1"),
        ("sql", "SELECT * FROM reviews"),
        ("sql", "SELECT 'nan'::DOUBLE AS x, 'inf'::DOUBLE AS y, DATE '2020-01-01' AS d, 1.50::DECIMAL(9, 2) AS m"),
        ("sql", "SELECT 1 AS a, 2 AS a"),
        ("sql", "question_counts"),
        ("cypher", "sequences"),
    ):
        code, out, err = run(*arguments, "--store", store.path, "--json")
        assert (code, err) == (0, "")
        rows = json.loads(out)
        assert isinstance(rows, list)
        assert all(isinstance(row, dict) for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["--json", "--csv", None])
@pytest.mark.parametrize("value", ["'infinity'::DATE", "'infinity'::TIMESTAMP", "['200000-01-01'::TIMESTAMP]"])
def test_a_time_that_python_cannot_hold_is_one_line(store, form, value):
    code, out, err = run("sql", f"SELECT {value} AS x", "--store", store.path, *([form] if form else []))
    assert (code, out) == (1, "")
    assert "cast it to text" in err


def test_what_parquet_cannot_hold_is_one_line(store, tmp_path):
    place = tmp_path / "x.parquet"
    code, out, err = run("sql", "SELECT INTERVAL 1 DAY AS x", "--store", store.path, "--parquet", place)
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert "cast the column to text" in err
    assert not list(tmp_path.glob("*x.parquet*"))


@pytest.mark.parametrize(
    "arguments", [("cypher", "RETURN '\udcff' AS x"), ("sql", "SELECT $a AS x", "--param", "a=\udcff")]
)
def test_a_statement_that_is_no_text_is_a_wrong_call(store, arguments):
    code, _, err = run(*arguments, "--store", store.path)
    assert (code, "UTF-8" in err) == (2, True)


def test_a_path_that_is_no_text_is_one_line(tmp_path):
    root = write_root(tmp_path / "root", {"yard-1": {"2d": {0: [person(1, (1, 60, 50, 200))]}}})
    code, out, err = run("load", root, "--store", tmp_path / "s\udcff")
    assert (code, out, len(err.splitlines())) == (1, "", 1)


def test_rows_are_the_same_in_every_form(store, tmp_path):
    ask = ("sql", "SELECT question_id, family FROM questions ORDER BY 1", "--store", store.path)
    rows = json.loads(run(*ask, "--json")[1])
    assert len(rows) == 4
    assert list(csv.DictReader(io.StringIO(run(*ask, "--csv")[1]))) == rows
    code, out, _ = run(*ask, "--parquet", tmp_path / "rows.parquet")
    assert (code, out) == (0, "")
    assert pq.read_table(tmp_path / "rows.parquet").to_pylist() == rows
    table = run(*ask)[1]
    assert all(row["question_id"] in table for row in rows)
    assert run(*ask, "--json", "--csv")[0] == 2


def test_parameters_and_names(store):
    # The sum of a range is an integer beyond 64 bits in DuckDB, and a number in JSON.
    ask = ("sql", "SELECT $a + sum(x) AS x, $b AS y FROM range(3) t(x)", "--store", store.path, "--json")
    assert json.loads(run(*ask, "--param", "a=3", "--param", "b=some=text")[1]) == [{"x": 6, "y": "some=text"}]
    assert run(*ask, "--param", "a")[0] == 2
    found = run(
        "cypher", "who_is_where", "--store", store.path, "--param", "sequence=s", "--param", "frame=3", "--json"
    )
    assert (found[0], json.loads(found[1])) == (0, [])
    code, out, _ = run("cypher", "--list", "--json")
    assert code == 0
    assert {"who_is_where", "timeline", "busiest_frames", "groups"} <= {row["name"] for row in json.loads(out)}


def test_a_frame_without_labels_names_the_nearest(tmp_path):
    store = load_world(tmp_path, {"yard-1": {"2d": {frame: [person(1, (100, 60, 50, 200))] for frame in (0, 15)}}})
    for when, rows, hint in (
        ("frame=15", 1, ""),
        ("frame=9", 0, "--param frame=15\n"),
        ("seconds=0.2", 0, "frame=0\n"),
    ):
        asked = ("who_is_where", "--store", store.path, "--param", "sequence=yard-1", "--param", when)
        code, out, err = run("cypher", *asked, "--json")
        assert (code, len(json.loads(out))) == (0, rows) and err.endswith(hint) and bool(err) == bool(hint)


def test_terminal_escapes_are_stripped_from_tables(store):
    code, out, _ = run("cypher", "MATCH (a:Action) RETURN a.name AS name", "--store", store.path)
    assert code == 0
    assert "\x1b" not in out
    assert "[31mred" in out


# -- errors -----------------------------------------------------------------------------------------------------------


def test_errors_are_one_line(store, tmp_path):
    (tmp_path / "empty").mkdir()
    for arguments in (
        ("cypher", "LOAD FROM '/etc/passwd' RETURN *", "--store", store.path),
        ("cypher", "MATCH (n RETURN n", "--store", store.path),
        ("cypher", "no_such_query", "--store", store.path),
        ("cypher", "sequences", "--store", tmp_path / "none"),
        ("cypher", "sequences", "--store", tmp_path / "empty"),
        ("sql", "SELECT * FROM read_csv('/etc/passwd')", "--store", store.path),
        ("sql", "SELEC", "--store", store.path),
        ("sql", "question_counts", "--store", tmp_path / "none"),
        ("observe", "nowhere", "0", "180", "--store", store.path, "--out", tmp_path / "x.png"),
        ("observe", "s", "0", "180", "--store", store.path, "--out", tmp_path / "x.png"),
        ("observe", "s", "15", "nan", "--store", store.path, "--out", tmp_path / "x.png"),
        ("observe", "s", "15", "-90", "--store", store.path, "--out", tmp_path / "x.png"),
        ("observe", "s", "15", "180", "--store", tmp_path / "none", "--out", tmp_path / "x.png"),
        ("score", "nobody", "--store", store.path),
        ("score", "../S", "--store", store.path),
        ("report", "nobody", "--store", store.path),
        ("report", "--store", tmp_path / "none"),
        ("score", "--store", tmp_path / "empty"),
        ("view", "--store", tmp_path / "none"),
        ("view", "--answers", "--store", tmp_path / "none"),
        ("play", "--store", tmp_path / "none"),
    ):
        code, out, err = run(*arguments)
        assert (code, out) == (1, ""), arguments
        assert err.count("\n") == 1, (arguments, err)
        assert err.startswith("jrdb-avr: ")
    assert not (tmp_path / "x.png").exists()


def test_terminal_escapes_are_stripped_from_errors(monkeypatch):
    def fail(**options):
        raise EndpointError("a server says \x1b]0;title\x07\x9b2J\r so")

    monkeypatch.setattr("jrdb_avr.engine.cli.group", fail)
    code, _, err = run("report")
    assert (code, err) == (1, "jrdb-avr: a server says ]0;title2J so\n")


@pytest.mark.slow
def test_a_closed_pipe_is_no_traceback(store):
    ask = f"'{COMMAND}' sql 'SELECT range FROM range(200000)' --csv --store '{store.path}' | head -1"
    done = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=True)
    assert done.stdout == "range\n"
    assert done.stderr == ""


# -- scores -----------------------------------------------------------------------------------------------------------


def test_score_and_report(store):
    code, out, err = run("score", "--store", store.path, "--json")
    assert (code, err) == (0, "")
    scored = {row["run"]: row for row in json.loads(out)}
    expected = {"n": 4, "answer": 75.0, "evidence": 50.0, "combined": 50.0, "invalid": 25.0, "errors": 25.0, "iou": 0.5}
    assert expected.items() <= scored["react-a"].items()
    assert scored["react-b"]["answer"] == 0.0
    kept = pq.read_table(store.run_path("react-a") / "scores.parquet")
    assert kept.schema.names == RUNS["scores"].names
    assert kept.num_rows == 4
    assert kept.schema.metadata[b"evidence_iou"] == b"0.5"

    rows = json.loads(run("report", "--store", store.path, "--json")[1])
    assert [(row["run"], row["label"], row["hallucination"]) for row in rows] == [
        ("react-a", "synthetic", 33.33),
        ("react-b", "", None),
    ]
    assert rows[0]["settings"] == {"budget": 24}
    code, out, err = run("report", "react-b", "--store", store.path)
    assert code == 0
    assert "n/a" in out and "too few" not in out and err.count("too few sequences for an interval") == 1
    assert "synthetic" not in out + err
    code, out, err = run("report", "--store", store.path, "--markdown")
    assert out.splitlines()[1].startswith("|:--")
    assert len(out.splitlines()) == 4
    assert "IoU 0.5" in err
    assert "synthetic" in err
    rows = list(
        csv.DictReader(io.StringIO(run("report", "react-a", "--store", store.path, "--csv", "--iou", "0.9")[1]))
    )
    assert (rows[0]["iou"], rows[0]["answer"]) == ("0.9", "75.0")


def test_a_run_of_other_questions_is_refused(store):
    write_run(store, "other", {"choice": 1}, False, questions="0" * 64)
    try:
        for command in ("score", "report"):
            code, out, err = run(command, "other", "--store", store.path)
            assert (code, out) == (1, "")
            assert "another questions file" in err
            # Of all runs, it is left out and named.
            code, out, err = run(command, "--store", store.path, "--json")
            assert code == 0
            assert [row["run"] for row in json.loads(out)] == ["react-a", "react-b"]
            assert "other" in err
        assert not (store.run_path("other") / "scores.parquet").exists()
    finally:
        for path in store.run_path("other").iterdir():
            path.unlink()
        store.run_path("other").rmdir()
