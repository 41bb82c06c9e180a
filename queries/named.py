"""Named queries: the files of `queries/results/*.sql` and of four folders of Cypher, by their stem.

The first comment line of a file is the question that it answers. A comment line `param NAME: TYPE`, or with a default
`param NAME: TYPE = VALUE`, declares a parameter: text, integer or number. Where a query takes a `frame`, `seconds` may
replace it: frame / 15, as in questions.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final

import msgspec

from jrdb_avr.queries.graph.parameters import scalar
from jrdb_avr.schema.errors import QueryError, did_you_mean
from jrdb_avr.schema.rules import FPS

FOLDERS: Final = {"cypher": ("explore", "generators", "necessity", "search"), "sql": ("results",)}

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_COMMENT = re.compile(r"^(?://|--)\s?(.*)$")
_QUESTION_ID = re.compile(r"(?=[0-9e]{16}$)[0-9]+e[0-9]+")
_PARAMETER = re.compile(r"^param\s+(\w+):\s*(text|integer|number)(?:\s*=\s*(.*))?$")


@dataclass(frozen=True)
class NamedQuery:
    """A query from a file: its text, what it answers, the types of its parameters, and the defaults of some."""

    name: str
    text: str
    answers: str
    types: dict[str, str]
    defaults: dict[str, Any]

    @property
    def takes(self) -> str:
        """The parameters in words, as in 'sequence (text), frame (integer; or seconds), count (integer, 20)'."""
        words = []
        for name, kind in self.types.items():
            more = "; or seconds" if name == "frame" else f", {self.defaults[name]}" if name in self.defaults else ""
            words.append(f"{name} ({kind}{more})")
        return ", ".join(words)

    def values(self, params: dict[str, Any]) -> dict[str, Any]:
        """Values for every parameter. Raises QueryError, with the remedy, where one is missing, unknown or of
        another type."""
        values = dict(params)
        if "frame" in self.types and "seconds" in values and "frame" not in values:
            values["frame"] = round(_checked("seconds", "number", values.pop("seconds")) * FPS)
        if unknown := sorted(values.keys() - self.types.keys()):
            raise QueryError(f"{self.name} has no parameter {unknown[0]!r}; it takes {self.takes or 'none'}")
        if missing := [name for name in self.types if name not in values and name not in self.defaults]:
            needed = " ".join(f"--param {name}={_EXAMPLES[self.types[name]]}" for name in missing)
            raise QueryError(f"{self.name} needs {needed}; it takes {self.takes}")
        return {
            name: _checked(name, kind, values[name]) if name in values else self.defaults[name]
            for name, kind in self.types.items()
        }


_EXAMPLES: Final = {"text": "TEXT", "integer": "INTEGER", "number": "NUMBER"}


def _checked(name: str, kind: str, value: Any) -> Any:
    """The value, if it is of the type. Raises QueryError."""
    if kind == "text" and isinstance(value, int | float) and not isinstance(value, bool):
        return str(value)
    value = scalar(value)
    fits: tuple[type, ...] = {"text": (str,), "integer": (int,), "number": (int, float)}[kind]
    endless = isinstance(value, float) and not math.isfinite(value)
    if not isinstance(value, fits) or isinstance(value, bool) or endless:
        raise QueryError(f"{name} is {_EXAMPLES[kind].lower()}, not {str(value)[:60]!r}: give {name}={_EXAMPLES[kind]}")
    return value


def named_queries(language: str) -> dict[str, NamedQuery]:
    """The queries of a language ("cypher" or "sql") by name, sorted."""
    folders = [files("jrdb_avr.queries").joinpath(folder) for folder in FOLDERS[language]]
    found = [entry for folder in folders for entry in folder.iterdir() if entry.name.endswith(f".{language}")]
    queries = [_read(entry.name.removesuffix(f".{language}"), entry.read_text("utf-8")) for entry in found]
    return {query.name: query for query in sorted(queries, key=lambda query: query.name)}


def find_query(language: str, text: str, params: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The statement and parameters for `text`: the name of a query, or a statement.

    Raises QueryError for a single word that is no query's name (naming the nearest), and for wrong parameters of one.
    """
    if not _NAME.fullmatch(text.strip()):
        return text, params
    known = named_queries(language)
    name = text.strip()
    query = known.get(name)
    if query is None:
        raise QueryError(f"no query is named {name!r}{did_you_mean(name, known)} --list shows all")
    return query.text, query.values(params)


def parse_value(text: str) -> Any:
    """A parameter's value: JSON where it is JSON, else the text as it stands. A question's id stays text even where it
    looks like a number with an exponent.

    >>> parse_value("15"), parse_value("female"), parse_value("[1, 2]"), parse_value("0012345678901e23")
    (15, 'female', [1, 2], '0012345678901e23')
    """
    if _QUESTION_ID.fullmatch(text):
        return text
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError):
        return text


def _read(name: str, text: str) -> NamedQuery:
    lines = [match[1].strip() for line in text.splitlines() if (match := _COMMENT.match(line.strip()))]
    found = [match for line in lines if (match := _PARAMETER.match(line))]
    types = {match[1]: match[2] for match in found}
    defaults = {match[1]: parse_value(match[3].strip()) for match in found if match[3] is not None}
    return NamedQuery(name, text, lines[0] if lines else "", types, defaults)
