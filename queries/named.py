"""Named queries: statements in files. A user runs a statement by the name of its file without the suffix.

SQL queries are in `queries/results`, and Cypher queries are in `queries/explore`, `generators` and `search`. The first
comment line of a file says what the query returns. A comment line `param NAME: TYPE` declares a parameter of the type
text, integer or number. `param NAME: TYPE = VALUE` declares a parameter with a default. The parameter `sequence` of a
Cypher query is a text without a declaration. `queries/store.py` gives the values of rules, such as `wait`. If a query
has the parameter `frame`, the caller may give `seconds` instead. The number of seconds is the frame divided by 15, as
in the texts of questions.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Final

import msgspec

from jrdb_avr.queries.graph.parameters import parameters, unwrap_scalar
from jrdb_avr.schema.errors import QueryError, did_you_mean
from jrdb_avr.schema.rules import FPS

FOLDERS: Final = {"cypher": ("explore", "generators", "search"), "sql": ("results",)}

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_COMMENT = re.compile(r"^(?://|--)\s?(.*)$")
_QUESTION_ID = re.compile(r"(?=[0-9e]{16}$)[0-9]+e[0-9]+")
_PARAMETER = re.compile(r"^param\s+(\w+):\s*(text|integer|number)(?:\s*=\s*(.*))?$")


@dataclass(frozen=True)
class NamedQuery:
    """Query that was read from a file.

    Attributes:
        name: Name of the query.
        text: Statement with its comments.
        answers: First comment line, which says what the query returns.
        types: Type of each parameter (text, integer or number), by name.
        defaults: Default of each optional parameter, by name.
    """

    name: str
    text: str
    answers: str
    types: dict[str, str]
    defaults: dict[str, Any]

    @property
    def takes(self) -> str:
        """Types and defaults of the parameters as text, such as 'frame (integer; or seconds), count (integer, 20)'."""
        parts = []
        for name, kind in self.types.items():
            more = "; or seconds" if name == "frame" else f", {self.defaults[name]}" if name in self.defaults else ""
            parts.append(f"{name} ({kind}{more})")
        return ", ".join(parts)

    def values(self, params: dict[str, Any]) -> dict[str, Any]:
        """Return the value of every parameter. A parameter without a given value has its default.

        Args:
            params: Given values, by the name of the parameter.

        Returns:
            Values by the name of the parameter.

        Raises:
            QueryError: If a value is missing, has the wrong type, or does not belong to a parameter.
        """
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
    """Return a parameter's value if it has the type `kind`, otherwise raise QueryError.

    If `kind` is "text", a number is converted to text.
    """
    if kind == "text" and isinstance(value, int | float) and not isinstance(value, bool):
        return str(value)
    value = unwrap_scalar(value)
    fits: tuple[type, ...] = {"text": (str,), "integer": (int,), "number": (int, float)}[kind]
    infinite = isinstance(value, float) and not math.isfinite(value)
    if not isinstance(value, fits) or isinstance(value, bool) or infinite:
        raise QueryError(f"{name} is {_EXAMPLES[kind].lower()}, not {str(value)[:60]!r}: give {name}={_EXAMPLES[kind]}")
    return value


def named_queries(language: str) -> dict[str, NamedQuery]:
    """Return a dictionary from the name of each query in a language to the query, in alphabetical order.

    The language is "cypher" or "sql".
    """
    folders = [files("jrdb_avr.queries").joinpath(folder) for folder in FOLDERS[language]]
    entries = [entry for folder in folders for entry in folder.iterdir() if entry.name.endswith(f".{language}")]
    queries = [_parse(entry.name.removesuffix(f".{language}"), entry.read_text("utf-8"), language) for entry in entries]
    return {query.name: query for query in sorted(queries, key=lambda query: query.name)}


def find_query(language: str, text: str, params: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Return the statement to run for the text that a user gave.

    Args:
        language: "cypher" or "sql".
        text: Name of a query, or a statement.
        params: Values of parameters, by name.

    Returns:
        The statement, and the value of each parameter of the statement. If `text` is a statement, the function returns
        `text` and `params` unchanged.

    Raises:
        QueryError: If `text` is a single word but not the name of a query, or if `params` do not fit the query.
    """
    if not _NAME.fullmatch(text.strip()):
        return text, params
    queries = named_queries(language)
    name = text.strip()
    query = queries.get(name)
    if query is None:
        raise QueryError(f"no query is named {name!r}{did_you_mean(name, queries)} --list shows all")
    return query.text, query.values(params)


def parse_value(text: str) -> Any:
    """Decode the text that a user typed as the value of a parameter. Return the text itself if it is not JSON.

    The id of a question stays a text, even if it looks like a number with an exponent.

    >>> parse_value("15"), parse_value("female"), parse_value("[1, 2]"), parse_value("0012345678901e23")
    (15, 'female', [1, 2], '0012345678901e23')
    """
    if _QUESTION_ID.fullmatch(text):
        return text
    try:
        return msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeEncodeError):
        return text


def _parse(name: str, text: str, language: str) -> NamedQuery:
    lines = [match[1].strip() for line in text.splitlines() if (match := _COMMENT.match(line.strip()))]
    declared = [match for line in lines if (match := _PARAMETER.match(line))]
    types = {"sequence": "text"} if language == "cypher" and "sequence" in parameters(text) else {}
    types |= {match[1]: match[2] for match in declared}
    defaults = {match[1]: parse_value(match[3].strip()) for match in declared if match[3] is not None}
    return NamedQuery(name, text, lines[0] if lines else "", types, defaults)
