"""Edges of labels hold what annotators wrote: compared with the annotation tables and with real label files."""

from __future__ import annotations

import re

import duckdb
import pytest
from environment import DOCS, ROOT

from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.rules import LoadRules
from jrdb_avr.schema.tables import ANNOTATIONS

SEQUENCE = "sample-plaza-01_0"

# Per relationship: the columns of an edge in Cypher, and every label by frame in SQL over the annotation tables.
LABELS = {
    "Performs": (
        "p.track, x.name",
        """SELECT track, action, frame, bool_or(difficulty < 3) FROM actions WHERE sequence = $s GROUP BY ALL""",
    ),
    "MemberOf": (
        "p.track, x.cluster",
        """SELECT track, cluster, frame, coalesce(difficulty < 3, false) FROM groups WHERE sequence = $s""",
    ),
    "Interacts": (
        "p.track, x.track, r.label",
        """WITH boxed AS (SELECT i.* FROM interactions i SEMI JOIN boxes_2d a USING (sequence, frame, track)
                         SEMI JOIN boxes_2d b ON (b.sequence, b.frame, b.track) = (i.sequence, i.frame, i.partner)
                         WHERE i.sequence = $s)
        SELECT track, partner, label, frame, coalesce(bool_or(difficulty < 3), false)
        FROM (SELECT track, partner, label, frame, difficulty FROM boxed
              UNION ALL SELECT partner, track, label, frame, difficulty FROM boxed) GROUP BY ALL""",
    ),
    "Handles": (
        "p.track, x.category_id, x.track, r.verb",
        """SELECT track, category_id, object, verb, frame, coalesce(bool_or(difficulty < 3), false)
        FROM handles SEMI JOIN boxes_2d USING (sequence, frame, track)
        WHERE sequence = $s AND category_id NOT IN
              (SELECT category_id FROM categories WHERE sequence = $s AND category IN ('pedestrian', 'person'))
        GROUP BY ALL""",
    ),
}


@pytest.fixture(scope="module")
def graph(sample_benchmark):
    with Graph.open(sample_benchmark.graph_path, read_only=True) as opened:
        yield opened


@pytest.fixture(scope="module")
def annotations(sample_benchmark):
    """DuckDB with a view of each annotation table."""
    with duckdb.connect() as connection:
        for layer in ANNOTATIONS:
            files = sample_benchmark.path / "annotations" / layer / "*.parquet"
            connection.execute(f"CREATE VIEW {layer} AS FROM read_parquet('{files}')")
        names = {"Performs": "action", "MemberOf": "cluster", "Interacts": "other, label"}
        for table, (_, labels) in LABELS.items():
            columns = names.get(table, "category_id, object, verb")
            connection.execute(
                f"CREATE TABLE labels_{table}(track, {columns}, frame, certain) AS {labels}", {"s": SEQUENCE}
            )
        yield connection


def edges(graph, table, columns, sequence=SEQUENCE):
    """The columns of each edge, its two frames, and its last columns: `certain`, or null for what may be."""
    last = "r.gap" if table.startswith("May") else "r.certain"
    text = f"MATCH (p:Person)-[r:{table}]->(x) WHERE r.sequence = $s RETURN {columns}, r.first, r.last, {last} AS last"
    return [tuple(row.values()) for row in graph.query(text, {"s": sequence}, ordered=False).to_pylist()]


@pytest.mark.parametrize("table", LABELS)
def test_edges_of_labels_are_the_labels_of_the_annotation_tables(graph, annotations, table):
    columns, labels = LABELS[table]
    expected = {row[:-1]: row[-1] for row in annotations.execute(labels, {"s": SEQUENCE}).fetchall()}
    found = {
        (*key, frame): certain
        for *key, first, last, certain in edges(graph, table, columns)
        for frame in range(first, last + 1)
    }
    assert found.keys() == expected.keys() and len(expected) > 500
    assert all(expected[key] for key, certain in found.items() if certain)
    # One of two poses is not certain either.
    assert table == "Performs" or found == expected


@pytest.mark.parametrize(
    ("labels", "possible", "expected"),
    [
        ("Performs", "MayPerform", {True, False}),
        ("MemberOf", "MayBelong", {True}),
        ("Interacts", "MayInteract", {False}),
        ("Handles", "MayHandle", {False}),
    ],
)
def test_what_may_hold_is_never_a_label(graph, labels, possible, expected):
    columns, _ = LABELS[labels]
    held = {(*key, f) for *key, first, last, _ in edges(graph, labels, columns) for f in range(first, last + 1)}
    kinds = set()
    for *key, first, last, gap in edges(graph, possible, columns):
        assert held.isdisjoint((*key, frame) for frame in range(first, last + 1))
        assert not gap or last - first < LoadRules().gap_frames
        kinds.add(gap)
    assert kinds == expected


def test_no_example_takes_what_may_hold_for_a_label():
    pages = [ROOT / "README.md", *DOCS.glob("*.md"), *(ROOT / "queries" / "explore").glob("*.cypher")]
    statements = {page.name: re.findall(r"(?:MATCH|FROM) [^;`]*", page.read_text("utf-8")) for page in pages}
    naming = {name for name, texts in statements.items() if re.search(r"\b(May[A-Z]|possible_)", " ".join(texts))}
    # It takes a closed gap for no change.
    assert naming == {"group_changes.cypher"}
