"""Catalogs of the tables of the graph and of the store, shown as rows or as Mermaid diagrams."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import InputError, did_you_mean
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, SCENE_RELS, column_types
from jrdb_avr.schema.tables import column, views


@dataclass(frozen=True)
class CatalogTable:
    """Table of the graph or of the store, with its columns.

    Attributes:
        name: Name of the table.
        part: Group that the table belongs to. The graph has the groups "scene", "keyframes" and "beliefs".
            The store has the groups "annotations", "intervals", "questions" and "runs".
        columns: Type of each column, by the name of the column.
        meanings: Meaning of each column, by the name of the column. Empty for tables of the graph.
        ends: Names of the node tables at the start of a relationship, and names of the node tables at its end. None
            if the table is not a relationship.
    """

    name: str
    part: str
    columns: Mapping[str, str]
    meanings: Mapping[str, str]
    ends: tuple[tuple[str, ...], tuple[str, ...]] | None = None


def graph_tables() -> list[CatalogTable]:
    """Return the node tables and relationship tables of the scene, the keyframe layer and the beliefs of agents."""
    parts = {
        "scene": (SCENE_NODES, SCENE_RELS),
        "keyframes": (LAYER_NODES, LAYER_RELS),
        "beliefs": (WORLD_NODES, WORLD_RELS),
    }
    tables = []
    for part, (nodes, relations) in parts.items():
        tables += [CatalogTable(name, part, column_types(text), {}) for name, text in nodes.items()]
        for name, (start, end, columns) in relations.items():
            ends = tuple(start.split(":")), tuple(end.split(":"))
            tables.append(CatalogTable(name, part, column_types(columns), {}, ends))
    return tables


def store_tables() -> list[CatalogTable]:
    """Return the Parquet tables of the store. The command `sql` has a view for each table."""
    tables = []
    for name, schema, _ in views():
        part = name.split("_")[0]
        if part not in ("annotations", "intervals"):
            part = "runs" if "run_id" in schema.names else "questions"
        meanings = {field.name: column(name, field.name)[1] for field in schema}
        tables.append(CatalogTable(name, part, {field.name: str(field.type) for field in schema}, meanings))
    return tables


def named(tables: Iterable[CatalogTable], names: Iterable[str]) -> list[CatalogTable]:
    """Select tables by their own name or by the name of their part.

    Args:
        tables: Tables to select from.
        names: Names of tables or of parts, such as "scene". If there are no names, all tables are selected.

    Returns:
        The selected tables, in the order of `tables`.

    Raises:
        InputError: If a name is neither that of a table nor that of a part.
    """
    tables, names = list(tables), list(names)
    valid = {word for table in tables for word in (table.name, table.part)}
    if unknown := [name for name in names if name not in valid]:
        raise InputError(f"no table {unknown[0][:80]!r}{did_you_mean(unknown[0], valid)}", field="table")
    return [table for table in tables if not names or table.name in names or table.part in names]


def table_rows(tables: Iterable[CatalogTable]) -> list[dict[str, str]]:
    """Return one row for each table, with its name, its part, the tables at both ends, and the names of its columns.

    The tables at the ends are "" if the table is not a relationship.
    """
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
    """Return one row for each column of each table, with the names of the table and the column, and the type.

    A row also has the meaning of the column if the columns of the table have documented meanings.
    """
    return [
        {"table": table.name, "column": name, "type": kind}
        | ({"meaning": table.meanings[name]} if table.meanings else {})
        for table in tables
        for name, kind in table.columns.items()
    ]


def graph_diagram(tables: Iterable[CatalogTable]) -> str:
    """Return a Mermaid flowchart with a box for each node table and an arrow for each relationship table."""
    lines = ["graph LR"]
    for table in tables:
        if table.ends is None:
            lines.append(f"  {table.name}")
            continue
        columns = f" {{{', '.join(table.columns)}}}" if table.columns else ""
        lines += [f'  {a} -- "{table.name}{columns}" --> {b}' for a in table.ends[0] for b in table.ends[1]]
    return "\n".join([*lines, ""])


_KEYS: Final = {"question_id": "questions", "run_id": "runs"}
"""Names of the store's main tables by their key column. Other tables with this column refer to the main table."""


def store_diagram(tables: Iterable[CatalogTable]) -> str:
    """Return a Mermaid entity diagram of the tables and their columns.

    Lines lead from the tables `questions` and `runs` to the tables with the key column `question_id` or `run_id`.
    """
    tables = list(tables)
    names = {table.name for table in tables}
    lines = ["erDiagram"]
    for table in tables:
        # Join the words of a type by underscores, because Mermaid accepts only one word.
        columns = [f"    {'_'.join(re.findall('[A-Za-z0-9]+', kind))} {name}" for name, kind in table.columns.items()]
        lines += [f"  {table.name} {{", *columns, "  }"]
    for table in tables:
        keys = [(key, target) for key, target in _KEYS.items() if key in table.columns and target in names]
        lines += [f"  {target} ||--o{{ {table.name} : {key}" for key, target in keys if target != table.name]
    return "\n".join([*lines, ""])
