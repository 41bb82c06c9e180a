"""Named queries: the files of `queries/explore/*.cypher` and `queries/results/*.sql`, asked for by their stem.

The first comment line of a file says what it answers; a line `param NAME = VALUE` in a comment gives a parameter its
default. Values on the command line are JSON where they can be read as JSON, else text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final

import msgspec

from jrdb_avr.schema.errors import QueryError

FOLDERS: Final = {"cypher": "explore", "sql": "results"}

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_COMMENT = re.compile(r"^(?://|--)\s?(.*)$")
_DEFAULT = re.compile(r"^param\s+(\w+)\s*=\s*(.*)$")


@dataclass(frozen=True)
class NamedQuery:
    """A query from a file: its text, what it answers, and its parameters' defaults."""

    name: str
    text: str
    answers: str
    defaults: dict[str, Any]


def named_queries(language: str) -> dict[str, NamedQuery]:
    """The queries of a language ("cypher" or "sql") by name, sorted."""
    folder = files("jrdb_avr.queries").joinpath(FOLDERS[language])
    found = sorted(entry.name for entry in folder.iterdir() if entry.name.endswith(f".{language}"))
    return {
        name.rpartition(".")[0]: _read(name.rpartition(".")[0], folder.joinpath(name).read_text("utf-8"))
        for name in found
    }


def find_query(language: str, text: str, given: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The statement and parameters meant by `text`: a named query, or the text itself.

    Raises QueryError for a single word that is no query's name.
    """
    if not _NAME.fullmatch(text.strip()):
        return text, given
    known = named_queries(language)
    query = known.get(text.strip())
    if query is None:
        raise QueryError(f"no query is named {text.strip()!r}; there are: {', '.join(known) or 'none'}")
    return query.text, {**query.defaults, **given}


def parse_value(text: str) -> Any:
    """A parameter's value: JSON where it is JSON, else the text as it stands.

    >>> parse_value("15"), parse_value("female"), parse_value("[1, 2]")
    (15, 'female', [1, 2])
    """
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError):
        return text


def _read(name: str, text: str) -> NamedQuery:
    lines = [match[1].strip() for line in text.splitlines() if (match := _COMMENT.match(line.strip()))]
    defaults = {match[1]: parse_value(match[2].strip()) for line in lines if (match := _DEFAULT.match(line))}
    return NamedQuery(name, text, lines[0] if lines else "", defaults)
