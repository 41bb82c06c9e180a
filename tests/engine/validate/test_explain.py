"""`cypher --question`: each printed statement runs as a command of its own, and returns the rows of the explanation."""

import json
import shlex
import subprocess
import sys

import pytest
from processes import run

from jrdb_avr.engine.validate.explain import explain
from jrdb_avr.schema.templates import FORMS


@pytest.fixture(scope="module")
def asked(sample_benchmark):
    """The private row of a question of each template."""
    rows = {row["question_id"]: row for row in sample_benchmark.questions("answers").to_pylist()}
    return {row["template"]: rows[row["question_id"]] for row in sample_benchmark.questions("questions").to_pylist()}


def printed(store, question):
    """The text that the command prints, and its statements as shell commands by id."""
    code, out, err = run("cypher", "--question", question, "--store", store.path)
    assert (code, err) == (0, "")
    texts = out.split("\nStatement ")[1:]
    commands = {int(text.partition(":")[0]): "jrdb-avr " + text.partition("\n\njrdb-avr ")[2] for text in texts}
    commands = {number: text.partition("\n\n")[0] for number, text in commands.items()}
    return out, commands


@pytest.mark.parametrize("template", ["two_hop", "fork_join", "change", "presence", "distance", "action_search", "gap"])
def test_the_printed_statements_return_the_rows_of_the_explanation(sample_benchmark, asked, template):
    question = asked[template]["question_id"]
    code, out, _ = run("cypher", "--question", question, "--store", sample_benchmark.path, "--json")
    rows = json.loads(out)
    wanted = {statement["id"]: statement for row in rows for statement in row["statements"]}
    text, commands = printed(sample_benchmark, question)
    assert code == 0 and commands.keys() == wanted.keys()
    for number, command in commands.items():
        _, *arguments = shlex.split(command.replace(" \\\n", " "))
        code, out, err = run(*arguments, "--json")
        assert (code, json.loads(out)) == (0, wanted[number]["rows"]), err
    # Tables are as wide as the terminal, and the path of the store is not divided.
    lines = [line for line in text.splitlines() if not set("┏┃┡│└").intersection(line) and "--store" not in line]
    assert max(map(len, lines)) <= 80
    names = [row["kind"] + row["variant"] for row in rows]
    stored = {proof["kind"] + proof["variant"]: proof for proof in json.loads(asked[template]["proofs"])}
    assert sorted(names) == sorted(stored)
    assert all(row["outcome"] == stored[name]["outcome"] for row, name in zip(rows, names, strict=True))


def test_a_shell_runs_a_printed_statement(sample_benchmark, asked):
    _, commands = printed(sample_benchmark, asked["change"]["question_id"])
    program = shlex.join([sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()"])
    text = f'jrdb-avr() {{ {program} "$@"; }}\n{commands[1]} --json'
    shell = subprocess.run(["bash", "-c", text], capture_output=True, text=True, check=True)
    assert json.loads(shell.stdout) == explain(sample_benchmark, asked["change"]["question_id"]).statements[0].rows


def test_each_proof_names_the_statements_that_decide_it(sample_benchmark, asked):
    assert asked.keys() == FORMS.keys()
    for row in asked.values():
        explained = explain(sample_benchmark, row["question_id"])
        names = {statement.id: statement.name for statement in explained.statements}
        used = {f"{proof.kind} {proof.variant}": {names[i] for i in ids} for proof, ids in explained.proofs}
        kinds = {name.partition("_")[0] for name in used["anchor match"]}
        assert {"condition"} < kinds <= {"people", "condition", "relation"}
        assert used["evidence clear views"] == {"seen"}
        assert not used["view.single any angle"] and not used["rederive annotations"]
        assert "time.drop all keyframes" not in used or used["time.drop all keyframes"]
        # A proof that leaves a condition out uses only the other conditions.
        for name, statements in used.items():
            if name.startswith("anchor without"):
                assert statements < used["anchor match"] or len(statements) == 1
        described = json.loads(row["bindings"])["a"]
        tables = [s.rows for s in explained.statements if s.name == "people_at"]
        assert any(described in {cells["who"] for cells in rows} for rows in tables)


@pytest.mark.parametrize("question", ["0" * 16, "no id", "\x1b[31m"])
def test_an_unknown_question_is_one_line_that_says_where_the_ids_are(sample_benchmark, question):
    code, out, err = run("cypher", "--question", question, "--store", sample_benchmark.path)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert err.startswith("jrdb-avr: no question") and "jrdb-avr sql 'FROM questions'" in err and "\x1b" not in err


def test_a_question_goes_without_a_query(sample_benchmark, asked):
    question = ("cypher", "--question", asked["gap"]["question_id"])
    for more in (("RETURN 1",), ("--list",), ("--param", "a=1"), ("--parquet", "rows.parquet")):
        assert run(*question, *more, "--store", sample_benchmark.path)[0] == 2
    assert run(*question)[0] == 2
