"""Cypher and SQL of users: a table or a QueryError, soon, and a store in which no byte has changed.

Statements are the kept queries and a corpus of attempts at everything but reading, with tokens changed. Words are
checked of all statements; one in some runs, in the child process that statements of users run in.
"""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from pathlib import Path
from random import Random

import limits
from sample_store import contents, sample_store

from jrdb_avr.queries.graph.guard import check_cypher, query_graph
from jrdb_avr.queries.named import FOLDERS
from jrdb_avr.queries.sql import query_tables
from jrdb_avr.schema.errors import AvrError, QueryError

PER_CASE = 100
RUN_EVERY = 12
TIMEOUT_S = 4.0

_TOKEN = re.compile(r"\s+|\w+|'(?:[^'\\]|\\.)*'|.", re.DOTALL)
WORDS = (
    *(
        "MATCH",
        "RETURN",
        "WHERE",
        "WITH",
        "UNWIND",
        "OPTIONAL MATCH",
        "ORDER BY",
        "LIMIT",
        "UNION",
        "DISTINCT",
        "SELECT",
    ),
    *(
        "FROM",
        "JOIN",
        "GROUP BY",
        "CREATE",
        "SET",
        "DELETE",
        "COPY",
        "LOAD FROM",
        "CALL",
        "ATTACH",
        "INSTALL",
        "PRAGMA",
    ),
    *("EXPORT DATABASE", "DETACH DELETE", "MERGE", "DROP TABLE", "INSERT INTO", "READ_CSV('/etc/passwd')", "USE x"),
    *("'", '"', "`", ";", "--", "//", "/*", "*/", "\\", "\0", "\r", "$", "$1", "$frame", "{", "}", "(", ")", "[", "]"),
    *("NULL", "true", "0", "-1", "1e308", "9223372036854775808", "1/0", "''", "'x'", "[1, 2]", "range(0, 1000000000)"),
    *("collect(n)", "count(*)", "size([])", "all(x IN [1] WHERE x)", "repeat('x', 1000000000)", "n", "p.track", "*"),
    *("é", "\u202e", "\ud800", "\u2028", "😀", "p" * 300),
)
PARAMETERS = ({}, {"frame": 15}, {"frame": "x", "sequence": "s"}, {"a": float("nan")}, {"frame": [1, {"b": None}]})


@cache
def corpus(language):
    """Kept queries of a language, and lines of attempts."""
    folders = [files("jrdb_avr.queries").joinpath(folder) for folder in FOLDERS[language]]
    kept = [
        entry.read_text("utf-8") for folder in folders for entry in folder.iterdir() if entry.name.endswith(language)
    ]
    tried = (Path(__file__).parent / "corpus" / f"statements.{language}").read_text("utf-8").splitlines()
    return sorted(kept) + tried * 4


def statement(rng, language):
    """A statement with some tokens changed, left out, doubled or taken from another one."""
    tokens = _TOKEN.findall(rng.choice(corpus(language)))
    for _ in range(rng.choice((0, 1, 1, 2, 4, 10))):
        at = rng.randrange(len(tokens) + 1)
        match rng.randrange(4):
            case 0:
                tokens[at : at + 1] = [rng.choice(WORDS)]
            case 1:
                tokens.insert(at, f" {rng.choice(WORDS)} ")
            case 2:
                del tokens[at : at + rng.randrange(1, 4)]
            case 3:
                other = _TOKEN.findall(rng.choice(corpus(language)))
                begin = rng.randrange(len(other))
                tokens[at:at] = other[begin : begin + rng.randrange(1, 12)]
    return "".join(tokens)


def prepare(folder):
    """Make the store."""
    sample_store(folder)


def run_case(seed, number, folder, save):
    """Some statements; how many."""
    rng = Random(f"{seed} statements {number}")
    store, sequence = sample_store(folder)
    before = contents(store.path)
    for n in range(PER_CASE):
        language = rng.choice(("cypher", "sql"))
        text, parameters = statement(rng, language), rng.choice(PARAMETERS)
        if rng.random() < 0.5:
            parameters = {"sequence": sequence, "frame": 15, "count": 3}
        limits.begin()
        try:
            _try(store, language, text, parameters, n % RUN_EVERY == 0)
        except QueryError as error:
            assert str(error) and "\n" not in str(error).strip(), error
        except AvrError as error:
            save("statement.txt", text.encode("utf-8", "surrogatepass"))
            raise AssertionError(f"{type(error).__name__}: {error}") from error
        except Exception:
            save("statement.txt", text.encode("utf-8", "surrogatepass"))
            raise
    assert contents(store.path) == before, "a statement changed the store"
    return PER_CASE


def _try(store, language, text, parameters, runs):
    if language == "cypher":
        check_cypher(text)
        if runs:
            query_graph(store.graph_path, text, parameters, timeout_s=TIMEOUT_S)
    elif runs:
        query_tables(store.path, text, parameters, timeout_s=TIMEOUT_S)
