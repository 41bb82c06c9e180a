"""Habits at the command line: the store by its variable, next steps, nearest names, completion, statements in files."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from processes import run

COMMAND = Path(sys.executable).with_name("jrdb-avr")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.delenv("JRDB_AVR_STORE", raising=False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def touch(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def test_the_variable_and_the_short_option_name_the_store(sample_benchmark, here, monkeypatch):
    answers = [run("sql", "question_counts", *option, "--json") for option in (("-s", sample_benchmark.path), ())]
    assert answers[0][0] == 0 and answers[1][0] == 2 and "--store" in answers[1][2]
    monkeypatch.setenv("JRDB_AVR_STORE", str(sample_benchmark.path))
    assert run("sql", "question_counts", "--json") == answers[0]
    code, _, err = run("sql", "question_counts", "-s", here)
    assert (code == 1 and str(here) in err) or code == 0, "the option goes before the variable"


def test_alone_it_says_what_comes_next(here, monkeypatch):
    def steps():
        code, out, err = run()
        assert (code, err) == (0, "")
        return re.findall(r"^  jrdb-avr (\w+)", out, re.M), out

    assert steps()[0] == ["demo", "load"]
    touch(here / "S" / "store.json")
    found, out = steps()
    assert found == ["generate", "cypher"] and "generate --store S" in out
    touch(here / "S" / "questions" / "questions.parquet")
    assert steps()[0] == ["validate", "inspect", "evaluate"]
    touch(here / "S" / "runs" / "r" / "run.json")
    found, out = steps()
    assert found == ["runs", "evaluate"] and "runs show r --store S" in out
    touch(here / "S" / "runs" / "r" / "predictions.parquet")
    assert steps()[0] == ["score", "report", "evaluate"]
    monkeypatch.setenv("JRDB_AVR_STORE", "S")
    assert "--store" not in steps()[1]
    monkeypatch.setenv("JRDB_AVR_STORE", "T")
    found, out = steps()
    assert found == ["demo", "load"] and "T, which JRDB_AVR_STORE names, is no store yet" in out


@pytest.mark.parametrize(
    ("arguments", "near"),
    [
        (("evalute",), "evaluate"),
        (("runs", "mereg"), "merge"),
        (("report", "--table", "famly"), "family"),
        (("sql", "question_count"), "question_counts"),
        (("cypher", "MATCH (p:Persn) RETURN p"), "Person"),
        (("cypher", "MATCH ()-[r:Perform]->() RETURN r"), "Performs"),
        (("sql", "SELECT * FROM question"), "questions"),
        (("observe", "sample-plaza-01", "15", "180", "--out", "x.png"), "sample-plaza-01_0"),
        (
            ("evaluate", "--method", "react", "--model", "simulated:perfect", "--images", ".", "--template", "spam"),
            "span",
        ),
    ],
)
def test_the_nearest_name_is_told(sample_benchmark, here, monkeypatch, arguments, near):
    monkeypatch.setenv("JRDB_AVR_STORE", str(sample_benchmark.path))
    code, out, err = run(*arguments)
    assert code in (1, 2) and not out
    assert re.search(rf"did you mean \W?{near}\W", err, re.I), err


def complete(*words, **environment):
    """What the shell would offer for the last word."""
    line = {"_JRDB_AVR_COMPLETE": "bash_complete", "COMP_WORDS": " ".join(("jrdb-avr", *words))}
    line["COMP_CWORD"] = str(len(words))
    done = subprocess.run([COMMAND], env=os.environ | line | environment, capture_output=True, text=True, check=True)
    return [word.partition(",")[2] for word in done.stdout.split()]


@pytest.mark.slow
def test_the_shell_completes_runs_sequences_and_queries(here, sample_benchmark):
    store = here / "S"
    for name in ("react-a", "react-b", "agent"):
        touch(store / "runs" / name / "run.json")
    assert complete("trace", "--store", str(store), "re") == ["react-a", "react-b"]
    assert complete("runs", "show", "a", JRDB_AVR_STORE=str(store)) == ["agent"]
    # A store that cannot be read completes nothing, and says nothing.
    assert complete("observe", "s", JRDB_AVR_STORE=str(store)) == []
    assert complete("cypher", "who") == ["who_is_where"]
    found = complete("observe", "sample", JRDB_AVR_STORE=str(sample_benchmark.path))
    assert found == sorted(sample_benchmark.manifest().sequences)


@pytest.mark.slow
def test_statements_come_from_files_and_standard_input(sample_benchmark, here):
    (here / "mine.sql").write_text("SELECT count(*) AS n\nFROM questions -- of all\n")
    store = ("-s", sample_benchmark.path, "--json")
    code, out, _ = run("sql", "mine.sql", *store)
    assert code == 0 and json.loads(out)[0]["n"] > 0
    piped = subprocess.run(
        [COMMAND, "cypher", "-", *map(str, store)],
        input="MATCH (p:Person) RETURN count(*) AS n",
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(piped.stdout)[0]["n"] > 0
    (here / "bad.cypher").write_bytes(b"\xff\xfe\x00")
    (here / "long.sql").write_bytes(b"-" * 2_000_000)
    for language, name in (("sql", "none.sql"), ("cypher", "bad.cypher"), ("sql", "long.sql")):
        code, out, err = run(language, name, *store)
        assert (code, out, err.count("\n")) == (1, "", 1) and name in err
