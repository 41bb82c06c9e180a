"""Reader of the Cypher and SQL statement files in the subfolders of this folder."""

from __future__ import annotations

from functools import cache
from importlib.resources import files


@cache
def read_statement(path: str) -> str:
    """Return the text of a statement file. `path` is relative to `queries/`, such as `reads/scene/value.cypher`."""
    return files("jrdb_avr.queries").joinpath(path).read_text("utf-8")
