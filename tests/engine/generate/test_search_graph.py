"""The graph holds what the interval tables hold: every table is compared, row by row, with DuckDB over the files."""

from __future__ import annotations

import random
from collections import Counter

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from random_worlds import lively_world, random_world, sociable_world
from worlds import load_world

from jrdb_avr.loaders import graph as scene
from jrdb_avr.loaders.graph import STAGE, build_scene, stage_scene
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.graph import SCENE_NODES, SCENE_RELS
from jrdb_avr.schema.tables import INTERVALS

PERSON = "sequence || '/' || track"
FRAME = "sequence || '/' || lpad(frame::VARCHAR, 6, '0')"
PAIR = "sequence || '/' || source, sequence || '/' || target"
THING = "sequence || '/' || category_id || ':' || object"
SPAN = "first, last, first_s, last_s"
SURE = f"{SPAN}, certain"
MAY = f"{SPAN}, gap"

# Per table of the graph, its rows as SQL over the interval files, columns in the order of the DDL.
SQL = {
    "Sequence": "SELECT sequence, fps, frame_count, layers, action_step, visibility FROM sequence",
    "Frame": f"SELECT {FRAME}, sequence, frame, seconds, keyframe, annotated, image FROM frames",
    "Person": f"SELECT {PERSON}, sequence, track, gender, age, ethnicity, first_frame, last_frame FROM persons",
    "Object": f"SELECT {THING}, sequence, object, category_id, category, first_frame, last_frame FROM objects",
    "SocialGroup": """
        SELECT sequence || '/' || cluster, sequence, cluster,
               max(value) FILTER (attribute = 'venue'),
               list(value ORDER BY value) FILTER (attribute = 'aim'),
               list(value ORDER BY value) FILTER (attribute = 'bpc'),
               list(value ORDER BY value) FILTER (attribute = 'ssc'),
               list(value ORDER BY value) FILTER (attribute = 'location'),
               list(value ORDER BY value) FILTER (attribute = 'inter')
        FROM (SELECT DISTINCT sequence, cluster FROM memberships)
        LEFT JOIN (SELECT * FROM group_info WHERE chosen) USING (sequence, cluster) GROUP BY sequence, cluster""",
    "SeenIn": f"""
        SELECT {PERSON}, {FRAME}, sequence, frame, {{'x': x, 'y': y, 'w': w, 'h': h}}, angle, occlusion, no_eval, clear,
               covered, face_visible, listed, interactions_listed, handles_listed, pose, posed, group_size,
               group_size_min, group_size_max, sector, located, distance, distance_word, distance_word_other,
               cx, cy, cz, heading, robot_view_listed, person_view_listed FROM sightings
        UNION ALL
        SELECT {THING}, {FRAME}, sequence, frame, {{'x': x, 'y': y, 'w': w, 'h': h}}, angle{", NULL" * 24}
        FROM object_sightings""",
    "Present": f"SELECT {PERSON}, sequence, sequence, {SPAN}, certain FROM presences",
    "Absent": f"SELECT {PERSON}, sequence, sequence, {SPAN}, certain FROM absences",
    "Performs": f"SELECT {PERSON}, action, sequence, {SPAN}, difficulty, certain FROM actions",
    "MayPerform": f"SELECT {PERSON}, action, sequence, {MAY} FROM possible_actions",
    "MemberOf": f"SELECT {PERSON}, sequence || '/' || cluster, sequence, {SURE} FROM memberships",
    "MayBelong": f"SELECT {PERSON}, sequence || '/' || cluster, sequence, {MAY} FROM possible_memberships",
    "Interacts": f"SELECT {PAIR}, label, sequence, {SURE} FROM interactions",
    "MayInteract": f"SELECT {PAIR}, label, sequence, {MAY} FROM possible_interactions",
    "Handles": f"SELECT {PERSON}, {THING}, verb, sequence, {SURE} FROM handles",
    "MayHandle": f"SELECT {PERSON}, {THING}, verb, sequence, {MAY} FROM possible_handles",
    "Beside": f"SELECT {PAIR}, label, sequence, {SURE} FROM beside",
}


def in_files(store, tables=tuple(SQL)):
    """{table: its rows}."""
    with duckdb.connect() as connection:
        for kind in INTERVALS:
            connection.execute(f"CREATE VIEW {kind} AS FROM '{store.path}/intervals/{kind}/*.parquet'")
        return {table: Counter(map(repr, connection.execute(SQL[table]).fetchall())) for table in tables}


def in_graph(graph, table):
    if table in SCENE_NODES:
        columns = [column.split()[0] for column in SCENE_NODES[table].split(", ")]
        text = f"MATCH (n:{table}) RETURN {', '.join(f'n.{c}' for c in columns)}"
    else:
        _, target, columns = SCENE_RELS[table]
        keys = {"Sequence": "sequence", "Action": "name"}
        columns = ["a.id", f"b.{keys.get(target, 'id')}", *(f"r.{c.split()[0]}" for c in columns)]
        text = f"MATCH (a)-[r:{table}]->(b) RETURN {', '.join(columns)}"
    rows = graph.query(text, ordered=False)
    return Counter(repr(tuple(column[i].as_py() for column in rows.columns)) for i in range(rows.num_rows))


def build(store, sequences):
    with build_graph(store.graph_path) as graph:
        return build_scene(graph, store, sequences)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store of two worlds that fill every table between them."""
    world = sociable_world(random.Random(7), "yard-1_0") | random_world(random.Random(26), "hall-2_0")
    return load_world(tmp_path_factory.mktemp("scene"), world)


def scene_tables(store, sequence="yard-1_0", name=None):
    """Interval tables of a sequence by kind, under another name if one is given."""
    tables = {kind: store.interval(kind, sequence) for kind in INTERVALS}
    names = {kind: pa.array([name or sequence] * table.num_rows) for kind, table in tables.items()}
    return {kind: table.set_column(0, "sequence", names[kind]) for kind, table in tables.items()}


def check_all(store):
    with Graph.open(store.graph_path, read_only=True) as graph:
        for table, expected in in_files(store).items():
            assert in_graph(graph, table) == expected, table


def test_every_table_holds_what_the_files_hold(store):
    check_all(store)
    expected = in_files(store)
    assert all(expected.values())
    rows = store.manifest().graph
    assert {table: rows[table] for table in SQL} == {table: found.total() for table, found in expected.items()}


def test_the_tables_are_all_there_are():
    assert SQL.keys() | {"Action"} == SCENE_NODES.keys() | SCENE_RELS.keys()


def test_nothing_staged_is_left(store):
    assert not (store.path / STAGE).exists()


def test_the_folder_may_be_called_anything(tmp_path):
    names = ("a b", "it's", 'say "x" {a,b}', "[ab]*?", "back\\slash ünï", "-x $HOME")
    store = load_world(tmp_path.joinpath(*names), lively_world(random.Random(0), "yard-1_0"))
    with Graph.open(store.graph_path, read_only=True) as graph:
        found = graph.query("MATCH (p:Person)-[s:SeenIn]->(f:Frame) RETURN count(*) AS n")["n"][0].as_py()
    assert found == sum(store.interval("sightings", name).num_rows for name in ("yard-1_0",)) > 0


def test_a_relative_store_is_built_where_it_is(store, tmp_path, monkeypatch):
    tables = scene_tables(store)
    monkeypatch.chdir(tmp_path)
    store = Store("here")
    for kind, table in tables.items():
        store.write_interval(kind, "yard-1_0", table)
    rows = build(store, ["yard-1_0"])
    assert rows["SeenIn"] == tables["sightings"].num_rows + tables["object_sightings"].num_rows
    assert (tmp_path / "here" / "graph.kuzu").exists()


def test_rows_staged_by_workers_are_the_ones_copied(store, tmp_path):
    tables = scene_tables(store)
    store = Store(tmp_path)
    stage_scene(store, "yard-1_0", tables)
    # There are no interval files: the stage is all that there is to read.
    assert build(store, ["yard-1_0"])["Beside"] == tables["beside"].num_rows


@pytest.mark.parametrize("rows", [pytest.param(1, marks=pytest.mark.slow), 20])
def test_batches_of_any_size_give_the_same_graph(tmp_path, monkeypatch, rows):
    monkeypatch.setattr(scene, "BATCH_ROWS", rows)
    store = load_world(tmp_path, lively_world(random.Random(0), "b.c") | lively_world(random.Random(2), "d-e_0"))
    assert in_files(store)["SeenIn"].total() > rows
    check_all(store)


WORDS = ("", "it's", "a/b", "ü\u2028", "back\\slash", "null", 'say "x"', "a,b]", "x" * 100)


def test_words_of_files_are_kept_as_they_are(store, tmp_path):
    written = Store(tmp_path)
    for kind, table in worded(scene_tables(store, "hall-2_0")).items():
        written.write_interval(kind, "hall-2_0", table)
    build(written, ["hall-2_0"])
    check_all(written)


def worded(tables):
    """The tables of a sequence with these words in the columns that hold a file's own words."""
    for kind, column in (
        *(("actions", "action"), ("possible_actions", "action"), ("handles", "verb"), ("objects", "category")),
        *(("interactions", "label"), ("sightings", "occlusion"), ("persons", "gender")),
    ):
        rows = tables[kind]
        texts = pa.array([WORDS[i % len(WORDS)] for i in range(rows.num_rows)])
        tables[kind] = rows.set_column(rows.schema.get_field_index(column), rows.schema.field(column), texts)
    # Of three attributes.
    tables["group_info"] = tables["group_info"].take([0, 2, 4]).set_column(3, "value", pa.array(WORDS[:3]))
    return tables


def test_columns_without_any_value_and_empty_tables(store, tmp_path):
    tables = scene_tables(store, name="s")
    for kind in ("group_info", "handles", "interactions", "actions"):
        tables[kind] = tables[kind].schema.empty_table()
    rows = tables["sightings"]
    for name in ("face_visible", "distance", "pose", "group_size"):
        place = rows.schema.get_field_index(name)
        rows = rows.set_column(place, rows.schema.field(place), pa.nulls(rows.num_rows, rows.schema.field(place).type))
    tables["sightings"] = rows
    store = Store(tmp_path)
    for kind, table in tables.items():
        store.write_interval(kind, "s", table)
    found = build(store, ["s"])
    assert found["Handles"] == found["Interacts"] == found["Performs"] == 0
    with Graph.open(store.graph_path, read_only=True) as graph:
        assert in_graph(graph, "SeenIn") == in_files(store, ["SeenIn"])["SeenIn"]
        groups = graph.query("MATCH (g:SocialGroup) RETURN g.venue AS v, g.aim AS a ORDER BY g.id").to_pylist()
    assert groups
    assert all(group == {"v": None, "a": None} for group in groups)


def test_a_file_to_copy_from_must_have_a_plain_name(tmp_path):
    pq.write_table(pa.table({"name": ["x"], "pose": [True]}), tmp_path / "ok.parquet")
    with Graph.memory() as graph:
        graph.execute(f"CREATE NODE TABLE Action({SCENE_NODES['Action']})")
        graph.copy_files("Action", tmp_path, ["ok.parquet"])
        assert graph.query("MATCH (a:Action) RETURN count(*) AS n")["n"].to_pylist() == [1]
        for name in ("*.parquet", "../x.parquet", "it's", "a b"):
            with pytest.raises(QueryError, match="plain name"):
                graph.copy_files("Action", tmp_path, [name])
