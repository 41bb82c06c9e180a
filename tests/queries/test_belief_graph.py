"""The handle on the world tables: what it refuses, where it lives, and what it leaves of the scene."""

import os

import pytest
from processes import run_program
from world_calls import SCENE, believe, beside_scene, tables_of

from jrdb_avr.queries.beliefs import graph as beliefs
from jrdb_avr.queries.beliefs.graph import WorldGraph, check_world
from jrdb_avr.queries.graph import handle
from jrdb_avr.queries.graph.file import check_fingerprint
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.errors import LockedError, QueryError, StoreError
from jrdb_avr.schema.graph import SCENE_NODES, SCENE_RELS, scene_ddl


@pytest.fixture
def scene(tmp_path):
    """A graph with a scene in which two people are to be kept from agents, and without world tables."""
    path = tmp_path / "graph.kuzu"
    with build_graph(path) as graph:
        for statement in (*scene_ddl(), *SCENE):
            graph.execute(statement)
    return path


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


AROUND = {
    "a scene table": "MATCH (n:Person) RETURN n.id ORDER BY n.id",
    "in small letters": "MATCH (n:person) RETURN n.track ORDER BY n.track",
    "quoted": "MATCH (n:`Person`) RETURN n.id ORDER BY n.id",
    "quoted, in a comment's shadow": "MATCH (n: /* Entity */ `Person`) RETURN n.id ORDER BY n.id",
    "behind a comment": "MATCH (n: /* the */ Person) RETURN n.id ORDER BY n.id",
    "behind a line comment": "MATCH (n: // Entity\nPerson) RETURN n.id ORDER BY n.id",
    "by its key": "MATCH (n:Person {id: 'secret/1'}) RETURN n.track ORDER BY n.track",
    "no label": "MATCH (n) RETURN count(*) AS n",
    "no label, a key": "MATCH (n {id: 'secret/1'}) RETURN count(*) AS n",
    "no label behind an edge": "MATCH (:Entity)-[:Sighted]->(o), (m) RETURN count(*) AS n",
    "an edge without a label": "MATCH ()-[r]->() RETURN count(*) AS n",
    "arrows alone": "MATCH (a)-->(b) RETURN count(*) AS n",
    "a walk of any length": "MATCH (a)-[*1..3]->(b) RETURN count(*) AS n",
    "a shortest path": "MATCH (a)-[r* SHORTEST 1..3]->(b) RETURN count(*) AS n",
    "a second label": "MATCH (n:Entity:Person) RETURN count(*) AS n",
    "an alternative": "MATCH (n:Entity|:Person) RETURN count(*) AS n",
    "an alternative edge": "MATCH (a:Entity)-[:Related|Interacts]->(b:Entity) RETURN count(*) AS n",
    "an alternative edge with a colon": "MATCH (a:Entity)-[:Related|:Interacts]->(b:Entity) RETURN count(*) AS n",
    "a label as a predicate": "MATCH (n:Entity) WHERE n:Person RETURN count(*) AS n",
    "label()": "MATCH (n) WHERE label(n) = 'Person' RETURN n.id ORDER BY n.id",
    "a subquery": "MATCH (n:Entity) WHERE EXISTS { MATCH (p:Person) } RETURN n.id ORDER BY n.id",
    "a subquery without a label": "MATCH (n:Entity) WHERE COUNT { MATCH (p) } > 3 RETURN n.id ORDER BY n.id",
    "a subquery in a subquery": "MATCH (n:Entity) WHERE EXISTS { MATCH (n)-[:Related]->(m:Entity) "
    "WHERE EXISTS { MATCH (:Person)-[:SeenIn]->(:Frame) } } RETURN n.id ORDER BY n.id",
    "a union": "MATCH (n:Entity) RETURN n.id AS id UNION ALL MATCH (p:Person) RETURN p.id AS id",
    "an optional match": "MATCH (n:Entity) OPTIONAL MATCH (p:Person) RETURN p.id ORDER BY p.id",
    "the list of tables": "CALL show_tables() RETURN *",
    "a table's columns": "CALL table_info('Person') RETURN *",
    "a file": "LOAD FROM '/etc/passwd' RETURN *",
    "rows of the caller": "LOAD FROM people RETURN *",
    "a copy out": "COPY (MATCH (p:Person) RETURN p.*) TO '/tmp/people.csv'",
    "two statements": "MATCH (n:Entity) RETURN count(*) AS n; MATCH (p:Person) RETURN count(*) AS n",
    "an export": "EXPORT DATABASE '/tmp/all'",
    "another database": "ATTACH '/tmp/x.kuzu' AS x (dbtype kuzu)",
    "letters that look alike": "MATCH (n:\u0420erson) RETURN n.id ORDER BY n.id",
    "an escape": "MATCH (n:Entity {id: '\\' RETURN 1 //'}) RETURN n.id ORDER BY n.id",
    "a key that is none": "RETURN {a: n:Person} AS x ORDER BY x",
    "a write": "CREATE (:Entity {id: 'x'})",
    "a change": "MATCH (n:Entity) SET n.kind = 'x'",
}

CHANGES = {
    "a new person": "CREATE (:Person {id: 'x'})",
    "a person's fact": "MATCH (n:Person) SET n.gender = 'male'",
    "a deletion": "MATCH (n:Person) DETACH DELETE n",
    "a deletion without a label": "MATCH (n) DETACH DELETE n",
    "an edge to the scene": "MATCH (n:Entity), (f:Frame) CREATE (n)-[:Sighted]->(f)",
    "a merge": "MERGE (:Person {id: 'x'})",
    "a table": "CREATE NODE TABLE Mine(id STRING PRIMARY KEY)",
    "a table gone": "DROP TABLE Person",
    "a table changed": "ALTER TABLE Person DROP gender",
    "a macro": "CREATE MACRO f(x) AS x + 1",
    "rows of a file": "COPY Person FROM '/tmp/people.csv'",
    "the transaction": "COMMIT",
    "the log": "CHECKPOINT",
}


@pytest.mark.parametrize("way", AROUND)
def test_no_statement_reads_the_scene(world, way):
    with pytest.raises(QueryError) as refused:
        world.query(AROUND[way])
    assert "secret" not in str(refused.value).replace("'secret/1'", "")


@pytest.mark.parametrize("way", CHANGES)
def test_no_statement_changes_the_scene(world, way):
    with pytest.raises(QueryError):
        world.write([(CHANGES[way], {})])


def test_statements_on_the_world_tables_pass(world):
    believed = world.query(
        "// who was seen\nMATCH (:Episode {id: $id})-[:Holds]->(n:Entity)-[s:Sighted]->(o:Observation) "
        "WHERE EXISTS { MATCH (n)-[r:Has]->(:Observation) WHERE r.name = 'gender: Person' OR r.name = 'gender' } "
        "RETURN n.name AS name, {frame: s.frame, box: s.box} AS seen ORDER BY name",
        {"id": "run/" + "0" * 16},
    ).to_pylist()
    assert [row["name"] for row in believed] == ["p1", "p2"]
    assert believed[0]["seen"]["frame"] == 15


def test_values_are_parameters_and_nothing_else(world):
    for text in ("x' OR 1 = 1 //", "`) MATCH (p:Person) RETURN p.id //", "$id"):
        found = world.query("MATCH (n:Entity) WHERE n.name = $name RETURN count(*) AS n", {"name": text})
        assert found["n"].to_pylist() == [0]


def test_a_write_that_fails_leaves_nothing(world):
    before = tables_of(world)
    make = "CREATE (:Entity {id: $id})"
    with pytest.raises(QueryError):
        world.write([(make, {"id": "new"}), (make, {"id": "new"})])
    with pytest.raises(QueryError):
        world.write([(make, {"id": "new"}), ("MATCH (n:Person) SET n.track = 3", {})])
    assert tables_of(world) == before


def test_the_tables_lie_beside_the_scene_and_leave_it_alone(scene):
    before, seal = scene_rows(scene), check_fingerprint(scene)
    with WorldGraph.open(scene) as world:
        believe(world)
        written = tables_of(world)
    assert scene_rows(scene) == before
    assert check_fingerprint(scene) == seal, "the seal still fits, as the file has only grown"
    with WorldGraph.open(scene) as world:
        assert tables_of(world) == written
    with Graph.open(scene, read_only=True) as graph:
        found = graph.query("MATCH (p:Person)-[:Interacts]->(q:Person) RETURN p.track, q.track", ordered=False)
        assert found.to_pylist() == [{"p.track": 1, "q.track": 2}]


@pytest.mark.slow
def test_a_file_of_its_own_is_made_from_nothing(tmp_path):
    path = tmp_path / "new" / "world.kuzu"
    with WorldGraph.open(path) as world:
        believe(world)
        written = tables_of(world)
    with WorldGraph.open(path) as world:
        believe(world, 1)
        both = tables_of(world)
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
        world.query("MATCH (n:Entity) RETURN count(*) AS n")


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
                assert world.query(asked, {"id": f"{part}/{n}"})["n"].to_pylist() == [1]
            assert max(map(len, (world.graph._shared.plans, world.graph._prepared))) <= 32
            assert world.graph._planned <= 32 + 2 * 25
        with pytest.raises(QueryError):
            world.write([(make.format(n), {"id": f"{n % 39}"}) for n in range(40)])
        assert world.query("MATCH (n:Entity) RETURN count(*) AS n")["n"].to_pylist() == [75]


def test_a_label_of_thousands_of_alternatives_is_looked_through():
    assert check_world(f"MATCH (n:{'|:'.join(['Entity'] * 1100)}) RETURN n.id") == {"entity"}
    with pytest.raises(QueryError, match="'Person' is no table"):
        check_world(f"MATCH (n:{'|'.join(['Entity'] * 1100)}|Person) RETURN n.id")


def test_check_world_names_what_is_there():
    assert check_world("MATCH (n:Entity)-[:Has|:Sighted]->(:Observation) RETURN n.id") == {
        "entity",
        "has",
        "sighted",
        "observation",
    }
    assert len(WORLD_NODES) + len(WORLD_RELS) == 14
