"""Explicit types for the parameters of Cypher statements.

The engine derives the type of a parameter from its value. The value 5 becomes INT8, a list takes the type of its items,
and an empty list gets no type. So this module replaces `$name` by a cast such as `CAST($name AS INT64)`. The type of
the Python value decides the type in the cast. Quoted texts, quoted names and comments stay unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

from jrdb_avr.schema.errors import QueryError

_TOKEN = re.compile(
    r"""(?P<skip>'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|`[^`]*`|//[^\n]*|/\*.*?\*/)"""
    r"""|(?P<count>\b(?:LIMIT|SKIP)\s+)?\$(?P<name>[A-Za-z_][A-Za-z0-9_]*)""",
    re.DOTALL | re.IGNORECASE,
)

_INT64: Final = 2**63

_SCALARS: Final = {bool: "BOOL", int: "INT64", float: "DOUBLE", str: "STRING"}
_FIELD: Final = re.compile("[A-Za-z_][A-Za-z0-9_]*")


def bind(cypher: str, params: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Write the types of the parameters into a statement, and convert the values for the engine.

    Args:
        cypher: Statement. A semicolon at the end is removed.
        params: Values of the parameters, by name. A value is None, bool, int (64 bits), float, str, a numpy scalar, a
            list or dict of such values, or an Arrow table (for `LOAD FROM $name`).

    Returns:
        The statement with typed parameters, and the values to pass to the engine.

    Raises:
        QueryError: If there is a second statement, a parameter has no value, a value has no parameter, or the
            engine cannot take a value.
    """
    values = {name: _plain(name, value) for name, value in params.items()}
    kinds = [(n, _type(n, value) if isinstance(value, int | list | dict) else None) for n, value in values.items()]
    return _typed(cypher, tuple(kinds)), values


# Use a cache, because a call takes 0.1 to 1 ms without it, which is up to half the time of a small query.
@lru_cache(1024)
def _typed(cypher: str, kinds: tuple[tuple[str, str | None], ...]) -> str:
    """Return the statement with a CAST around each parameter that needs a type.

    `kinds` has, for each parameter, its name and its type. The type is None if the parameter needs no CAST.
    """
    cypher = cypher.strip().removesuffix(";")
    if ";" in strip_literals(cypher):
        raise QueryError("one statement at a time: there is a ';' inside")
    types = dict(kinds)
    used: set[str] = set()

    def typed(match: re.Match[str]) -> str:
        name = match["name"]
        if name is None:
            return match[0]
        used.add(name)
        # LIMIT and SKIP do not accept a CAST. They convert the parameter to an integer themselves.
        kind = None if match["count"] else types.get(name)
        return f"CAST(${name} AS {kind})" if kind else match[0]

    text = _TOKEN.sub(typed, cypher)
    if used != types.keys():
        missing = ", ".join(f"${name}" for name in sorted(used - types.keys()))
        extra = ", ".join(sorted(types.keys() - used))
        raise QueryError(f"give a value for {missing}" if missing else f"the statement has no parameter {extra}")
    return text


def parameters(cypher: str) -> list[str]:
    """Return the names of the parameters in a statement, in alphabetical order."""
    return sorted({match["name"] for match in _TOKEN.finditer(cypher) if match["name"]})


# Use a cache, because a call takes as long as a call of `_typed` without it.
@lru_cache(1024)
def strip_literals(cypher: str) -> str:
    """Return a statement with each quoted text, quoted name and comment replaced by spaces of the same length."""
    return _TOKEN.sub(lambda match: match[0] if match["name"] else " " * len(match[0]), cypher)


def unwrap_scalar(value: Any) -> Any:
    """Convert a numpy scalar, such as a cell of a data frame, to a Python value. Return other values unchanged."""
    return value.item() if hasattr(value, "dtype") and getattr(value, "ndim", 1) == 0 else value


def _plain(name: str, value: Any) -> Any:
    if value is None or isinstance(value, bool | str | float) or type(value).__module__.startswith("pyarrow"):
        return value
    if isinstance(value, int):
        if not -_INT64 <= value < _INT64:
            raise QueryError(f"${name}: {int(value)} does not fit into 64 bits")
        return int(value)
    if isinstance(value, list | tuple):
        return [_plain(name, item) for item in value]
    if isinstance(value, dict):
        return {key: _plain(name, item) for key, item in value.items()}
    if value is not (converted := unwrap_scalar(value)):
        return _plain(name, converted)
    raise QueryError(f"${name}: a {type(value).__name__} cannot be bound")


def _type(name: str, value: Any) -> str | None:
    """Return the name of the engine's type for a Python value, or None if the value is None or an empty dictionary."""
    if kind := next((kind for scalars, kind in _SCALARS.items() if isinstance(value, scalars)), None):
        return kind
    match value:
        case dict():
            parts = [f"{_field(name, key)} {_type(name, item) or 'STRING'}" for key, item in value.items()]
            return f"STRUCT({', '.join(parts)})" if parts else None
        case list() if value and all(isinstance(item, dict) for item in value):
            if any(item.keys() != value[0].keys() for item in value):
                raise QueryError(f"${name}: all rows need the same keys")
            columns = [f"{_field(name, key)} {_common(name, [item[key] for item in value])}" for key in value[0]]
            return f"STRUCT({', '.join(columns)})[]"
        case list():
            return f"{_common(name, value)}[]"
        case _:
            return None


def _common(name: str, items: list[Any]) -> str:
    kinds = {kind for item in items if (kind := _type(name, item)) is not None}
    if kinds == {"INT64", "DOUBLE"}:
        return "DOUBLE"
    if len(kinds) > 1:
        raise QueryError(f"${name}: values of one list need one type, not {', '.join(sorted(kinds))}")
    return kinds.pop() if kinds else "STRING"


def _field(name: str, key: Any) -> str:
    if not isinstance(key, str) or not _FIELD.fullmatch(key):
        raise QueryError(f"${name}: {key!r} cannot be a field's name: use letters, digits and '_'")
    return key
