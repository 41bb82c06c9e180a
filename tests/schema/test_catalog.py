"""The tables by name: what `cypher` and `sql` really have, and diagrams of them; the rules by name."""

import pytest
from processes import run

from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.catalog import column_rows, graph_diagram, graph_tables, named, store_diagram, store_tables
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import Rules, override, rule_rows


def test_the_graph_has_these_tables_and_columns(sample_benchmark):
    tables = {table.name: table for table in graph_tables()}
    with Graph.open(sample_benchmark.graph_path, read_only=True) as graph:

        def rows(call):
            return graph.query(f"CALL {call} RETURN *", ordered=False).to_pylist()

        assert tables.keys() == {row["name"] for row in rows("show_tables()")}
        for name, table in tables.items():
            found = {row["name"]: row["type"] for row in rows(f"table_info('{name}')")}
            assert found == {own: kind.replace("BOOLEAN", "BOOL") for own, kind in table.columns.items()}, name


def test_the_store_has_these_views(sample_benchmark):
    rows = sample_benchmark.sql("SELECT table_name AS t, column_name AS c FROM information_schema.columns").to_pylist()
    ours = {(row["table"], row["column"]) for row in column_rows(store_tables())}
    assert ours <= {(row["t"], row["c"]) for row in rows}
    assert {table for table, _ in ours} >= {"questions", "intervals_actions", "annotations_poses", "scores"}


def test_diagrams_name_every_table_and_end():
    tables = graph_tables()
    lines = graph_diagram(tables).splitlines()
    assert lines[0] == "graph LR"
    assert '  Object -- "SeenIn {' in "\n".join(lines)
    nodes = {table.name for table in tables if table.ends is None}
    assert nodes == {line.strip() for line in lines[1:] if "--" not in line}
    assert all(end in nodes for table in tables if table.ends for side in table.ends for end in side)
    drawn = store_diagram(named(store_tables(), ["questions", "runs"]))
    assert "  questions ||--o{ answers : question_id\n" in drawn and "  runs ||--o{ scores : run_id\n" in drawn
    assert "list" in drawn and "<" not in drawn


def test_tables_are_chosen_by_name_or_part():
    assert {table.part for table in named(graph_tables(), ["beliefs"])} == {"beliefs"}
    with pytest.raises(InputError, match="no table 'Persn': did you mean Person"):
        named(graph_tables(), ["Persn"])
    assert "Performs" in run("schema", "graph")[1]
    assert run("schema", "tables", "--mermaid", "--csv")[0] == 2


def test_every_rule_is_listed_with_its_meaning_and_can_be_overridden():
    rows = rule_rows()
    assert all(row["meaning"].endswith(".") and len(row["meaning"]) > 15 for row in rows)
    assert {"load.gap_frames", "shift_s"} <= {row["rule"] for row in rows}
    for row in rows:
        value = row["value"]
        text = str(list(value)).replace("'", '"') if isinstance(value, tuple) else str(value)
        assert override(Rules(), {row["rule"]: text}) == Rules(), row["rule"]
    with pytest.raises(InputError, match=r"did you mean load\.gap_frames"):
        override(Rules(), {"load.gap_frame": "3"})
    code, out, _ = run("rules", "list", "--csv")
    assert (code, len(out.splitlines())) == (0, len(rows) + 1)
