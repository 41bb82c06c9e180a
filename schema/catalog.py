"""Tables of the graph and of the store by name, as rows, as Mermaid diagrams and as a reference page.

`python -m jrdb_avr.schema.catalog > docs/tables.md` writes the reference page.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import pyarrow as pa

from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import InputError, did_you_mean
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, SCENE_NODES, SCENE_RELS
from jrdb_avr.schema.tables import ABOUT, column, views

_NESTED: Final = re.compile(r",\s*(?![^()]*\))")
"""A comma between columns, not one inside a struct."""


@dataclass(frozen=True)
class CatalogTable:
    """A table: its columns with their types, and what each means where that is written down.

    part: of the graph "scene", "keyframes" or "beliefs", of the store "annotations", "intervals", "questions" or
    "runs".
    ends: of a relationship the names of the tables that it leads from and to.
    """

    name: str
    part: str
    columns: Mapping[str, str]
    meanings: Mapping[str, str]
    ends: tuple[tuple[str, ...], tuple[str, ...]] | None = None


def graph_tables() -> list[CatalogTable]:
    """The tables of the graph: nodes and relationships of the scene, its keyframes and the agents' beliefs."""
    parts = {
        "scene": (SCENE_NODES, SCENE_RELS),
        "keyframes": (KEYFRAME_NODES, KEYFRAME_RELS),
        "beliefs": (WORLD_NODES, WORLD_RELS),
    }
    found = []
    for part, (nodes, relations) in parts.items():
        found += [CatalogTable(name, part, _columns(_NESTED.split(text)), {}) for name, text in nodes.items()]
        for name, (start, end, columns) in relations.items():
            ends = tuple(start.split(":")), tuple(end.split(":"))
            found.append(CatalogTable(name, part, _columns(columns), {}, ends))
    return found


def _columns(texts: Iterable[str]) -> dict[str, str]:
    pairs = (text.replace(" PRIMARY KEY", "").strip().split(" ", 1) for text in texts)
    return {name.strip("`"): kind for name, kind in pairs}


def store_tables() -> list[CatalogTable]:
    """The Parquet tables of the store, which are the views of `sql`."""
    parts = {"question_id": "questions", "run_id": "runs"}
    return [
        CatalogTable(
            name,
            next(
                (part for part in ("annotations", "intervals") if name.startswith(f"{part}_")),
                next((part for key, part in reversed(parts.items()) if key in schema.names), "questions"),
            ),
            {field.name: str(field.type) for field in schema},
            {field.name: column(name, field.name)[1] for field in schema},
        )
        for name, schema, _ in views()
    ]


def named(tables: Iterable[CatalogTable], names: Iterable[str]) -> list[CatalogTable]:
    """The tables of these names, or of the parts of these names; all without names. Raises InputError for another."""
    tables, names = list(tables), list(names)
    known = {word for table in tables for word in (table.name, table.part)}
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"no table {unknown[0][:80]!r}{did_you_mean(unknown[0], known)}", field="table")
    return [table for table in tables if not names or table.name in names or table.part in names]


def table_rows(tables: Iterable[CatalogTable]) -> list[dict[str, str]]:
    """A row per table, with its columns."""
    return [
        {
            "table": table.name,
            "part": table.part,
            "from": ", ".join(table.ends[0]) if table.ends else "",
            "to": ", ".join(table.ends[1]) if table.ends else "",
            "columns": ", ".join(table.columns),
        }
        for table in tables
    ]


def column_rows(tables: Iterable[CatalogTable]) -> list[dict[str, str]]:
    """A row per column of each table."""
    return [
        {"table": table.name, "column": name, "type": kind}
        | ({"meaning": table.meanings[name]} if table.meanings else {})
        for table in tables
        for name, kind in table.columns.items()
    ]


def graph_diagram(tables: Iterable[CatalogTable]) -> str:
    """A Mermaid flowchart: nodes, and an arrow for each relationship between two of them."""
    lines = ["graph LR"]
    for table in tables:
        if table.ends is None:
            lines.append(f"  {table.name}")
            continue
        columns = f" {{{', '.join(table.columns)}}}" if table.columns else ""
        lines += [f'  {a} -- "{table.name}{columns}" --> {b}' for a in table.ends[0] for b in table.ends[1]]
    return "\n".join([*lines, ""])


_KEYS: Final = {"question_id": "questions", "run_id": "runs"}
"""Columns by which tables of a store are joined, and the table that each is the key of."""


def store_diagram(tables: Iterable[CatalogTable]) -> str:
    """A Mermaid entity diagram: tables with their columns, joined by the ids of questions and runs."""
    tables = list(tables)
    names = {table.name for table in tables}
    lines = ["erDiagram"]
    for table in tables:
        # A type is one word there.
        columns = [f"    {'_'.join(re.findall('[A-Za-z0-9]+', kind))} {name}" for name, kind in table.columns.items()]
        lines += [f"  {table.name} {{", *columns, "  }"]
    for table in tables:
        keys = [(key, target) for key, target in _KEYS.items() if key in table.columns and target in names]
        lines += [f"  {target} ||--o{{ {table.name} : {key}" for key, target in keys if target != table.name]
    return "\n".join([*lines, ""])


def tables_page() -> str:
    """Return the reference page of all tables, in Markdown."""
    lines = [
        "# Tables of a store",
        "",
        "Every table is a view in `jrdb-avr sql`; `SHOW TABLES` and `DESCRIBE intervals_actions` work there too. A",
        "table that is not written yet is an empty view. Written by `python -m jrdb_avr.schema.catalog`.",
        "",
        "`sightings_keypoints` is `intervals_sightings` with one column more: `keypoints`, those of",
        "`annotations_poses` at the same frame, or null.",
        "",
    ]
    for name, schema, private in views():
        secret = " Private: never opened by the process that talks to a model." if private else ""
        lines += [f"## `{name}`", "", f"{ABOUT[name]}{secret}", "", "| column | type | meaning |", "|--|--|--|"]
        lines += [f"| `{field.name}` | {_type(field)} | {column(name, field.name)[1]} |" for field in schema]
        lines.append("")
    return "\n".join(lines)


def _type(field: pa.Field) -> str:
    return f"{field.type}".replace(" not null", "").replace("item: ", "") + (" or null" if field.nullable else "")


if __name__ == "__main__":
    print(tables_page())
