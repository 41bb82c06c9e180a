"""Tables of the graph as Cypher statements: the scene and the keyframe layer (docs/graph.md).

The names of tables and columns are a public interface. The nodes of the scene have these keys: a `Person` has
`<sequence>/<track>`. A `SocialGroup` has `<sequence>/<cluster>`. A `Frame` has `<sequence>/<frame in six digits>`. An
`Object` has `<sequence>/<category id>:<track>`, because things of different categories may have the same track.

An edge `SeenIn` begins at a person or at a thing. If it begins at a thing, it describes only the box and the angle of
the box. Every relationship of the scene has the column `sequence`, because a query that filters a relationship by
`sequence` is ten times faster than a query that filters by a property of a node.

A relationship holds from its frame `first` to its frame `last`, both included. `first_s` and `last_s` are the times of
these frames in seconds. `Performs`, `MemberOf`, `Interacts` and `Handles` have the labels of annotators. `certain` is
false if the label leaves the fact unknown, for example because the label has the highest difficulty. Tables with names
that begin with `May` have facts that may be true, although no label states them. The module `schema.tables` explains
the column `gap` of these tables.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Final

import pyarrow as pa

from jrdb_avr.schema.tables import INTERVALS

SCENE_NODES: Final[dict[str, str]] = {
    "Sequence": "sequence STRING PRIMARY KEY, fps DOUBLE, frame_count INT64, layers STRING[], action_step INT64, "
    "visibility STRING",
    "Frame": "id STRING PRIMARY KEY, sequence STRING, frame INT64, seconds DOUBLE, keyframe BOOLEAN, "
    "annotated BOOLEAN, image BOOLEAN",
    "Person": "id STRING PRIMARY KEY, sequence STRING, track INT64, gender STRING, age STRING, ethnicity STRING, "
    "first_frame INT64, last_frame INT64",
    "Object": "id STRING PRIMARY KEY, sequence STRING, track INT64, category_id INT64, category STRING, "
    "first_frame INT64, last_frame INT64",
    # `bpc` and `ssc` are the annotators' abbreviations: what the bodies are on, and the salient surroundings.
    "SocialGroup": "id STRING PRIMARY KEY, sequence STRING, cluster INT64, venue STRING, aim STRING[], bpc STRING[], "
    "ssc STRING[], location STRING[], inter STRING[]",
    "Action": "name STRING PRIMARY KEY, pose BOOLEAN",
}

_TYPES: Final = {"string": "STRING", "double": "DOUBLE", "bool": "BOOLEAN", "int32": "INT64"}


def _sighting_columns() -> tuple[str, ...]:
    """Return the columns of `SeenIn`.

    They are the columns of `intervals_sightings` without track and group. One column holds the four numbers of the box.
    """
    fields = [field for field in INTERVALS["sightings"] if field.name not in ("track", "cluster", *"xywh")]
    columns = [f"{field.name} {_TYPES[str(field.type)]}" for field in fields]
    # The box is a struct, because the engine needs minutes to save a million lists of type DOUBLE[4].
    return (*columns[:2], "box STRUCT(x DOUBLE, y DOUBLE, w DOUBLE, h DOUBLE)", *columns[2:])


_SPAN: Final = ("first INT64", "last INT64", "first_s DOUBLE", "last_s DOUBLE")

SCENE_RELS: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "SeenIn": ("Person:Object", "Frame", _sighting_columns()),
    "Present": ("Person", "Sequence", ("sequence STRING", *_SPAN, "certain BOOLEAN")),
    "Absent": ("Person", "Sequence", ("sequence STRING", *_SPAN, "certain BOOLEAN")),
    "Performs": ("Person", "Action", ("sequence STRING", *_SPAN, "difficulty INT64", "certain BOOLEAN")),
    "MayPerform": ("Person", "Action", ("sequence STRING", *_SPAN, "gap BOOLEAN")),
    "MemberOf": ("Person", "SocialGroup", ("sequence STRING", *_SPAN, "certain BOOLEAN")),
    "MayBelong": ("Person", "SocialGroup", ("sequence STRING", *_SPAN, "gap BOOLEAN")),
    "Interacts": ("Person", "Person", ("label STRING", "sequence STRING", *_SPAN, "certain BOOLEAN")),
    "MayInteract": ("Person", "Person", ("label STRING", "sequence STRING", *_SPAN, "gap BOOLEAN")),
    "Handles": ("Person", "Object", ("verb STRING", "sequence STRING", *_SPAN, "certain BOOLEAN")),
    "MayHandle": ("Person", "Object", ("verb STRING", "sequence STRING", *_SPAN, "gap BOOLEAN")),
    "Beside": ("Person", "Person", ("label STRING", "sequence STRING", *_SPAN, "certain BOOLEAN")),
}
"""Relationship tables by name: tables at the start (separated by a colon), table at the end, and columns."""

LAYER_NODES: Final[dict[str, str]] = {
    "Moment": "id INT64 PRIMARY KEY, sequence STRING, track INT64, frame INT64, seen INT64, earlier INT64, "
    "later INT64, clear BOOLEAN, image BOOLEAN, ahead BOOLEAN, not_doing STRING[], distance DOUBLE, angle DOUBLE",
    "Name": "id INT64 PRIMARY KEY, sequence STRING, conditions STRING, general BOOLEAN",
    "Segment": "id INT64 PRIMARY KEY, sequence STRING, action STRING, first INT64, last INT64, start INT64, "
    "`end` INT64, quiet_from INT64, closed BOOLEAN, first_clear BOOLEAN, first_image BOOLEAN, first_ahead BOOLEAN, "
    "last_clear BOOLEAN, last_image BOOLEAN, last_ahead BOOLEAN, angle DOUBLE, held_from INT64, held_to INT64",
    "Absence": "id INT64 PRIMARY KEY, sequence STRING, leaves INT64, returns INT64, present_from INT64, "
    "clear BOOLEAN, image BOOLEAN, ahead BOOLEAN",
    "Keyframes": "sequence STRING PRIMARY KEY, rules_hash STRING, rules STRING",
}
"""Node tables of the keyframe layer. `seen` is 1 for a clear view, 0 for an absence, and null if neither is certain.

`earlier` and `later` are `seen` of the same person when the proof time.shift moves the time. `not_doing` are actions
that are certainly false.
"""

LAYER_RELS: Final[dict[str, tuple[str, str, tuple[str, ...]]]] = {
    "At": ("Person", "Moment", ()),
    "Describes": ("Name", "Moment", ()),
    "Leads": ("Moment", "Moment", ("relation STRING",)),
    "Doing": ("Moment", "Action", ()),
    "Acts": ("Person", "Segment", ()),
    "Leaves": ("Person", "Absence", ()),
}

_ARROW: Final[dict[str, pa.DataType]] = {
    "STRING[]": pa.list_(pa.string()),
    # As text, which the engine reads.
    "UUID": pa.string(),
    "STRUCT(x DOUBLE, y DOUBLE, w DOUBLE, h DOUBLE)": pa.struct([(name, pa.float64()) for name in "xywh"]),
}
"""Types of columns that Arrow does not know by the same name."""

STORAGE_VERSION: Final = 13
"""Version of the tables of the graph. A graph with another version must be built again."""


def scene_ddl() -> list[str]:
    """Return the statements that create the tables of the scene, node tables first."""
    return table_ddl(SCENE_NODES, SCENE_RELS)


def table_ddl(nodes: Mapping[str, str], rels: Mapping[str, tuple[str, str, tuple[str, ...]]]) -> list[str]:
    """Return the statements that create the given tables, node tables first.

    Args:
        nodes: Columns of each node table, in the form of `SCENE_NODES`.
        rels: Ends and columns of each relationship table, in the form of `SCENE_RELS`.

    Returns:
        One Cypher statement per table.
    """
    statements = [f"CREATE NODE TABLE `{name}`({columns})" for name, columns in nodes.items()]
    for name, (source, target, columns) in rels.items():
        ends = [f"FROM {start} TO {target}" for start in source.split(":")]
        statements.append(f"CREATE REL TABLE `{name}`({', '.join([*ends, *columns])})")
    return statements


def column_types(columns: str | Iterable[str]) -> dict[str, str]:
    """Return the type of each column by name, from columns in the form of `SCENE_NODES` or of `SCENE_RELS`."""
    # A comma inside the type of a struct separates no columns.
    texts = re.split(r",\s*(?![^()]*\))", columns) if isinstance(columns, str) else columns
    pairs = (text.replace(" PRIMARY KEY", "").strip().split(" ", 1) for text in texts)
    return {name.strip("`"): kind for name, kind in pairs}


def row_schema(table: str, nodes: Mapping[str, str], rels: Mapping[str, tuple[str, str, tuple[str, ...]]]) -> pa.Schema:
    """Return the columns of the rows that are copied into a table of the graph.

    Args:
        table: Name of the table.
        nodes: Columns of node tables, in the form of `SCENE_NODES`. The first column is the key.
        rels: Ends and columns of relationship tables, in the form of `SCENE_RELS`, each between two tables of `nodes`.

    Returns:
        The names and types. Rows of edges begin with the keys of both ends.
    """
    if table in nodes:
        types = column_types(nodes[table])
    else:
        source, target, columns = rels[table]
        keys = (next(iter(column_types(nodes[name]).values())) for name in (source, target))
        types = dict(zip(("from", "to"), keys, strict=True)) | column_types(columns)
    return pa.schema([(name, _ARROW.get(kind) or pa.type_for_alias(kind.lower())) for name, kind in types.items()])
