"""Files that a user names, in the encodings and places in which users have them."""

import json
import os
import re
from pathlib import Path

import pytest
from processes import COMMAND, run, run_program
from scored_runs import stored_failures

from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.schema.errors import InputError

TEXTS = ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be")
METHOD = ("--method", "monolithic", "--model", "simulated", "--images", ".")
LINE = json.dumps({"question_id": "scores", "answer": {"choice": 1}})


def saved(text, encoding):
    mark = "" if encoding in ("utf-8-sig", "utf-16", "utf-32") else "\ufeff"
    return (mark + text).encode(encoding)


@pytest.mark.parametrize("encoding", TEXTS)
def test_text_is_read_by_its_mark(tmp_path, encoding):
    assert to_utf8(saved("é\n", encoding), tmp_path) == "é\n".encode()
    assert to_utf8("é\n".encode(), tmp_path) == "é\n".encode()


@pytest.mark.parametrize("data", [b"a\x00b", b"\x00a\x00b", b"\xff\xfe\x00\xd8x", b"\xef\xbb\xbf\xff"])
def test_other_bytes_are_refused_in_a_line(tmp_path, data):
    with pytest.raises(InputError, match=r"mine.txt.*save it as UTF-8") as error:
        to_utf8(data, tmp_path / "mine.txt")
    assert "\n" not in str(error.value)


FILES = {
    # name: (text, command, what it prints)
    "q.sql": ("SELECT count(*) AS n FROM questions", ("sql", "q.sql", "--csv"), "n\n13\n"),
    "mine.jsonl": (LINE, ("score", "--jsonl", "mine.jsonl", "--csv"), "\nmine,"),
    "decisions.json": (
        '{"questions_sha256": "0", "decisions": []}',
        ("inspect", "--import", "decisions.json", "--reviewer", "ada"),
        "is about another questions file",
    ),
    "ids.txt": ("0123456789abcdef\n", ("evaluate", *METHOD, "--questions", "ids.txt"), "'0123456789abcdef'"),
    "runs.toml": ("[[run]]\nmodl = 'x'", ("evaluate", "--matrix", "runs.toml"), "no option 'modl'"),
    "prices.toml": ("[x]\ninput = 1", ("evaluate", *METHOD, "--prices", "prices.toml"), "no price of simulated"),
}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_every_command_reads_marked_files(tmp_path, monkeypatch, encoding):
    *_, store = stored_failures(tmp_path / "S")
    monkeypatch.chdir(tmp_path)
    for name, (text, command, shown) in FILES.items():
        (tmp_path / name).write_bytes(saved(text, encoding))
        _, out, err = run(*command, "--store", store.path)
        assert shown in out + err, (name, err)


def test_a_marked_cypher_file_is_read(tmp_path, sample_benchmark):
    (tmp_path / "q.cypher").write_bytes(saved("RETURN 'é' AS text", "utf-16"))
    assert run("cypher", tmp_path / "q.cypher", "--csv", "--store", sample_benchmark.path)[1] == "text\né\n"


def test_links_and_standard_input_are_files_like_others(tmp_path):
    *_, store = stored_failures(tmp_path / "S")
    (tmp_path / "mine.jsonl").write_text(LINE)
    (tmp_path / "linked.jsonl").symlink_to("mine.jsonl")
    assert run("score", "--jsonl", tmp_path / "linked.jsonl", "--store", store.path)[0] == 0
    for command, text in ((("score", "other", "--jsonl", "/dev/stdin"), LINE), (("sql", "/dev/stdin"), "SELECT 1")):
        assert run_program(COMMAND, *command, "--store", store.path, stdin=text.encode()).returncode == 0, command
    os.mkfifo(tmp_path / "pipe")
    assert read_input(tmp_path / "pipe") == b""
    for path in (tmp_path, Path("/dev/zero"), tmp_path / "none", Path("a\0b")):
        with pytest.raises(InputError, match=re.escape(str(path))):
            read_input(path)
