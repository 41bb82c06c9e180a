"""The project's modules as Python reads them: each is parsed once for all tests of a process."""

import ast
from functools import cache
from pathlib import Path

import jrdb_avr

ROOT = Path(jrdb_avr.__file__).parent
FOLDERS = ("schema", "loaders", "queries", "engine", "agent")


@cache
def paths():
    """Every module of the five folders."""
    return sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py"))


@cache
def parsed(path):
    """Its syntax tree."""
    return ast.parse(path.read_text("utf-8"))


@cache
def imports(path):
    """Its statements of import, wherever they stand: an expression holds none."""
    found, open_ = [], [parsed(path)]
    while open_:
        node = open_.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            inner = getattr(node, field, ())
            open_ += inner if isinstance(inner, list) else ()
    return found
