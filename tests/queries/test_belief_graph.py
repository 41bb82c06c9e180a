"""The session on the world tables: what a failed write leaves, where the file is, and what it leaves of the scene."""

import os

import pytest
from processes import run_program
from world_calls import believe, beside_scene, scene_in, tables_of

from jrdb_avr.queries.beliefs import graph as beliefs
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.graph import handle
from jrdb_avr.queries.graph.file import check_fingerprint
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import LockedError, QueryError, StoreError
from jrdb_avr.schema.graph import SCENE_NODES, SCENE_RELS


@pytest.fixture
def scene(tmp_path):
    return scene_in(tmp_path)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A handle on a graph that holds a scene and an agent's beliefs."""
    with beside_scene(tmp_path_factory.mktemp("world")) as world:
        believe(world)
        yield world


def scene_rows(path):
    with Graph.open(path, read_only=True) as graph:
        asked = [f"MATCH (n:{table}) RETURN n" for table in SCENE_NODES]
        asked += [f"MATCH ()-[r:{table}]->() RETURN r" for table in SCENE_RELS]
        return [sorted(map(repr, graph.query(cypher, ordered=False).to_pylist())) for cypher in asked]


def test_a_write_that_fails_leaves_nothing(world):
    before = tables_of(world.graph)
    make = "CREATE (:Entity {id: $id})"
    with pytest.raises(QueryError):
        world.write([(make, {"id": "new"}), (make, {"id": "new"})])
    with pytest.raises(QueryError):
        world.write([(make, {"id": "new"}), ("CREATE (:Entity {nothing: 3})", {})])
    assert tables_of(world.graph) == before


def test_the_tables_lie_beside_the_scene_and_leave_it_alone(scene):
    before, seal = scene_rows(scene), check_fingerprint(scene)
    with WorldGraph.open(scene) as world:
        believe(world)
        written = tables_of(world.graph)
    assert scene_rows(scene) == before
    assert check_fingerprint(scene) == seal, "the seal still fits, as the file has only grown"
    with WorldGraph.open(scene) as world:
        assert tables_of(world.graph) == written
    with Graph.open(scene, read_only=True) as graph:
        found = graph.query("MATCH (p:Person)-[:Interacts]->(q:Person) RETURN p.track, q.track", ordered=False)
        assert found.to_pylist() == [{"p.track": 1, "q.track": 2}]


@pytest.mark.slow
def test_a_file_of_its_own_is_made_from_nothing(tmp_path):
    path = tmp_path / "new" / "world.kuzu"
    with WorldGraph.open(path) as world:
        believe(world)
        written = tables_of(world.graph)
    with WorldGraph.open(path) as world:
        believe(world, 1)
        both = tables_of(world.graph)
    assert all(row in both[table] for table in written for row in written[table])
    assert len(both["Entity"]) == 2 * len(written["Entity"])


def test_tables_that_cannot_all_be_made_are_not_made(scene, monkeypatch):
    statements = [*beliefs.table_ddl(WORLD_NODES, WORLD_RELS)]
    with monkeypatch.context() as patch:
        patch.setattr(beliefs, "table_ddl", lambda nodes, rels: [*statements[:-1], "CREATE NODE TABLE"])
        with pytest.raises(QueryError):
            beliefs.open_graph(scene)
    with Graph.open(scene, read_only=True) as graph:
        tables = graph.query("CALL show_tables() RETURN name AS name", ordered=False)["name"].to_pylist()
    assert set(tables) == {*SCENE_NODES, *SCENE_RELS}
    beliefs.open_graph(scene).close()


def test_a_file_that_is_no_graph_is_refused(tmp_path):
    path = tmp_path / "world.kuzu"
    path.write_text("no graph")
    with pytest.raises(StoreError, match="give another file, or remove this one"):
        WorldGraph.open(path)
    assert path.read_text() == "no graph"


def test_a_graph_has_one_writer(scene):
    with WorldGraph.open(scene):
        code = f"from jrdb_avr.queries.beliefs.graph import WorldGraph; WorldGraph.open({str(scene)!r})"
        done = run_program(code)
    assert f"process {os.getpid()}" in done.stderr.decode().splitlines()[-1]
    with Graph.open(scene, read_only=True), pytest.raises(LockedError):
        WorldGraph.open(scene)


def test_closing_twice_is_harmless_and_what_comes_later_is_told():
    world = WorldGraph.memory()
    world.close()
    world.close()
    with pytest.raises(QueryError, match="closed"):
        world.read("MATCH (n:Entity) RETURN count(*) AS n", {})


def test_statements_of_many_texts_do_not_pile_up(monkeypatch):
    """The engine keeps what a connection has planned, so connections change, but never within a transaction."""
    assert handle._PREPARED == 256
    monkeypatch.setattr(handle, "_PREPARED", 32)
    with WorldGraph.memory() as world:
        make = "CREATE (:Entity {{id: $id, name: 'n{}'}})"
        for part in range(3):
            world.write([(make.format(f"{part}x{n}"), {"id": f"{part}/{n}"}) for n in range(25)])
            for n in range(14):
                asked = f"MATCH (n:Entity {{id: $id}}) WHERE n.name <> 'm{part}x{n}' RETURN count(*) AS n"
                assert world.read(asked, {"id": f"{part}/{n}"}) == [{"n": 1}]
            assert max(map(len, (world.graph._shared.plans, world.graph._prepared))) <= 32
            assert world.graph._planned <= 32 + 2 * 25
        with pytest.raises(QueryError):
            world.write([(make.format(n), {"id": f"{n % 39}"}) for n in range(40)])
        assert world.read("MATCH (n:Entity) RETURN count(*) AS n", {}) == [{"n": 75}]
