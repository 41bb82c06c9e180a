"""A world model for tests: questions, observations without pictures, writes, and every row of the world tables."""

import contextlib

import numpy as np
import pyarrow as pa

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.beliefs.record import replayed
from jrdb_avr.queries.graph.handle import build_graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.graph import scene_ddl
from jrdb_avr.schema.method import Observation, Panorama, Question
from jrdb_avr.schema.panorama import FOV_DEG, Box, crop_left
from jrdb_avr.schema.plan import AnswerSpec, Condition, Edge, Node, Plan, Time
from jrdb_avr.schema.tables import RUNS

NOTHING = np.zeros((1, 1, 3), np.uint8)
PLAN = Plan(
    "a",
    "b",
    {"t0": Time(frame=15), "t1": Time(frame=30)},
    (
        Node(
            "a",
            (
                Condition(attribute="gender", value="female"),
                Condition(attribute="group_size", value=3, at="t0"),
                Condition(object="bag", verb="holding", at="t0"),
                Condition(action="walking", at="t1"),
                Condition(interaction="hugging", at="t0"),
            ),
        ),
        Node("b"),
    ),
    (Edge("a", "conversation", "b", "t0"),),
    AnswerSpec("multiple_choice", "presence", "b", ("t0", "t1")),
)
BOX = Box(10.0, 20.0, 30.0, 40.0)

SCENE = (
    "CREATE (:Person {id: 'secret/1', sequence: 'secret', track: 1, gender: 'female'})",
    "CREATE (:Person {id: 'secret/2', sequence: 'secret', track: 2})",
    "CREATE (:Frame {id: 'secret/000000', sequence: 'secret', frame: 0})",
    "MATCH (p:Person {id: 'secret/1'}), (f:Frame {id: 'secret/000000'}) "
    "CREATE (p)-[:SeenIn {sequence: 'secret', frame: 0, box: {x: 1.0, y: 2.0, w: 3.0, h: 4.0}}]->(f)",
    "MATCH (p:Person {id: 'secret/1'}), (q:Person {id: 'secret/2'}) "
    "CREATE (p)-[:Interacts {sequence: 'secret', label: 'conversation'}]->(q)",
)
"""Two people of a scene, who are to be kept from agents."""


def question(number):
    return Question(f"{number:016x}", "s", "Who?", (), "number")


def look(frame, angle=180.0):
    return Observation("s", frame, f"{frame:06d}", frame / 15, angle, FOV_DEG, int(crop_left(angle)), NOTHING)


def whole(frame):
    return Panorama("s", frame, f"{frame:06d}", frame / 15, b"")


def begin(graph, number=0, run="run"):
    """An episode, and the list of its writes."""
    writes = []
    return WorldModel(graph, run).episode(question(number), writes.append), writes


def rows_of(graph, table, keep=lambda row: True):
    """All rows of a world table, sorted; edges with the ids of their ends."""
    if table in WORLD_NODES:
        columns = [column.split()[0] for column in WORLD_NODES[table].split(", ")]
        listed = ", ".join(f"n.{name} AS {name}" for name in columns)
        found = graph.query(f"MATCH (n:{table}) RETURN {listed}", ordered=False)
    else:
        source, target, columns = WORLD_RELS[table]
        names = [column.split()[0] for column in columns]
        listed = "".join(f", r.{name} AS {name}" for name in names)
        found = graph.query(
            f"MATCH (a:{source})-[r:{table}]->(b:{target}) RETURN a.id AS source, b.id AS target{listed}",
            ordered=False,
        )
    return sorted((row for row in found.to_pylist() if keep(row)), key=repr)


def tables_of(graph, keep=lambda row: True):
    return {table: rows_of(graph, table, keep) for table in (*WORLD_NODES, *WORLD_RELS)}


def belongs(key):
    """Whether a row is of the episode `key`."""

    def keep(row):
        return row.get("episode", row.get("id", row.get("source", ""))).startswith(key)

    return keep


# -- a scene, and writes beside it ------------------------------------------------------------------------------------


@contextlib.contextmanager
def beside_scene(folder):
    """World tables in a graph of their own, beside a scene."""
    path = folder / "graph.kuzu"
    with build_graph(path) as graph:
        for statement in (*scene_ddl(), *SCENE):
            graph.execute(statement)
    with WorldGraph.open(path) as world:
        yield world


def believe(world, number=0):
    """Two people who talk, in an episode of their own."""
    episode, _ = begin(world, number)
    name = episode.observed(look(15), 1)
    for i, person in enumerate(("p1", "p2")):
        given = {"id": person, "kind": "person", "observation": name, "box": []}
        assert episode.add("add_entity", given, 1, Box(10 + 100 * i, 10, 50, 90)).accepted
        told = {"entity": person, "name": "gender", "value": "female", "observation": name}
        assert episode.add("add_attribute", told, 1).accepted
    joined = {"source": "p1", "name": "conversation", "target": "p2", "observation": name}
    assert episode.add("add_relation", joined, 1).accepted
    return episode


def add(episode, name="p1", observation="o1", box=BOX, step=1, **more):
    given = {"id": name, "kind": "person", "observation": observation, "box": [1, 2, 3, 4], **more}
    return episode.add("add_entity", given, step, box)


def say(episode, name, value, entity="p1", observation="o1", step=1):
    given = {"entity": entity, "name": name, "value": value, "observation": observation}
    return episode.add("add_attribute", given, step)


def join(episode, name, source="p1", target="p2", observation="o1", step=1):
    given = {"source": source, "name": name, "target": target, "observation": observation}
    return episode.add("add_relation", given, step)


def seen_twice(episode, *frames, people=("p1", "p2")):
    """Observations of frames in which all people are sighted."""
    for frame in frames:
        name = episode.observed(look(frame), 0)
        for person in people:
            assert add(episode, person, name).accepted


def edges_of(graph, table, key):
    return sorted(rows_of(graph, table, belongs(key)), key=lambda row: row["write"])


def replay(writes, key):
    """The rows of the tables as the record alone gives them."""
    run, question_id = key.split("/")
    columns = ("number", "step", "tool", "arguments", "accepted", "reason", "fact")
    rows = [{"run_id": run, "question_id": question_id, **{c: getattr(w, c) for c in columns}} for w in writes]
    tables = replayed(pa.Table.from_pylist(rows, RUNS["world"]))
    renamed = {"from": "source", "to": "target"}
    return {
        name: sorted(
            ({renamed.get(column, column): value for column, value in row.items()} for row in rows.to_pylist()),
            key=repr,
        )
        for name, rows in tables.items()
    }
