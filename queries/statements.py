"""Texts of the Cypher and SQL statements in the files below this folder."""

from __future__ import annotations

from functools import cache
from importlib.resources import files


@cache
def read_statement(path: str) -> str:
    """Return the text of a file below `queries/`, such as `reads/scene/value.cypher`."""
    return files("jrdb_avr.queries").joinpath(path).read_text("utf-8")
