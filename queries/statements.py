"""The Cypher and SQL statements in the files of this folder, as text."""

from __future__ import annotations

from functools import cache
from importlib.resources import files


@cache
def read_statement(path: str) -> str:
    """The text of a file below `queries/`, as `reads/scene/poses.cypher`."""
    return files("jrdb_avr.queries").joinpath(path).read_text("utf-8")
