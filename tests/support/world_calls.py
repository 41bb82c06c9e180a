"""Calls that a model makes to a world model: sound ones, a played episode, and hostile ones."""

import contextlib
import math

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
from jrdb_avr.schema.relations import FIRST_LEFT, SAME_GROUP
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


VICTIM = "run/" + f"{999:016x}"
"""Key of an episode that no other may touch."""
INJECTED = (
    "'}) DETACH DELETE n //",
    "`",
    "\\",
    "$id",
    "p1'",
    "{id}",
    "secret/1",
    VICTIM,
    f"{VICTIM}/p1",
    f"{VICTIM}/o1",
)
ODD = ("", " ", "\x00", "\ud800", "\u202e", "p" * 33, "x" * 5000, "о1", "nan", "o01", "o0", "o-1", "1")
JUNK = (
    *(None, True, 0, -1, 10**400, 2**63, -(2**70), 0.5, math.nan, math.inf, -math.inf, 1e308),
    *([], [[]], {}, {"a": {"b": [None, "\ud800"]}}, [1, 2, 3, 4], {1: 2}, (1,), b"x", {"x"}),
    *INJECTED,
    *ODD,
)
RELATIONS = ("conversation", "Walking_Together", SAME_GROUP, FIRST_LEFT, "front left, close", "front, far", "stands by")
ATTRIBUTES = (
    ("gender", "female"),
    ("gender", "Male"),
    ("age", "young adulthood"),
    ("action", "walking"),
    ("action", "standing"),
    ("Action", "holding something"),
    ("group_size", 3),
    ("distance_m", 2.5),
    ("sector", "left"),
    ("object", "holding: bag"),
    ("interaction", "hugging"),
    ("coat", "red'); MATCH (n) DETACH DELETE n"),
    ("steps", 4),
    ("gender", "secret"),
    ("object", "bag"),
)
EDGES = (-1.0, 0.0, 5.0, 480.0, 3760.0, 1e300, math.nan, math.inf, -math.inf)
SCAFFOLD = [
    ("observed", 15, 180.0),
    ("observed", 30, 0.0),
    ("observed", 15, 350.0),
    *(("add_entity", {"id": p, "kind": "person", "observation": "o1", "box": []}, BOX) for p in ("p1", "p2")),
    ("add_entity", {"id": "p3", "kind": "person", "observation": "o2", "box": []}, BOX),
]
"""Observations and people that calls may name, so that many of them are grounded."""


def calls_of(rng, most=30):
    """Calls: good ones, good ones with one part replaced, added or left out, and junk."""
    return [*SCAFFOLD, *(_call(rng) for _ in range(most))]


def _call(rng):
    observation = rng.choice(("o1", "o1", "o2", "o2", "o3", "o3", "o4", f"{VICTIM}/o1"))
    one, two = rng.sample(("p1", "p2", "p3"), 2)
    name, value = rng.choice(ATTRIBUTES)
    match rng.randrange(12):
        case 0:
            return "observed", rng.choice((0, 15, 30)), rng.choice((0.0, 180.0, 350.0, None))
        case 1:
            return "noted", rng.choice(JUNK), rng.random() < 0.5, _text(rng)
        case 2:
            return "refused", rng.choice(JUNK), _text(rng)
        case 3 | 4 | 5:
            good = {"id": one, "kind": "person", "observation": observation, "box": [1, 2, 3, 4]}
            if rng.random() < 0.5:
                good["node"] = rng.choice(("a", "b", None, "c"))
            odd = (Box(*rng.choices(EDGES, k=4)), "the box is unreadable", Box(470.0, 0.0, 10.0, 480.0000000001))
            return "add_entity", _wild(rng, good), BOX if rng.random() < 0.7 else rng.choice(odd)
        case 6 | 7 | 8:
            good = {"entity": one, "name": name, "value": value, "observation": observation}
            return "add_attribute", _wild(rng, good)
        case _:
            good = {"source": one, "name": rng.choice(RELATIONS), "target": two, "observation": observation}
            return "add_relation", _wild(rng, good)


def _wild(rng, good):
    junk = rng.choice((_text(rng), *JUNK))
    match rng.randrange(10):
        case 0:
            return junk
        case 1 | 2:
            return good | {rng.choice(sorted(good.keys() - {"box"})): junk}
        case 3:
            return good | {_text(rng): junk}
        case 4:
            return {key: value for key, value in good.items() if key != rng.choice(sorted(good))}
    return good


def _text(rng):
    return "".join(chr(rng.choice((rng.randrange(128), rng.randrange(0x110000)))) for _ in range(rng.randrange(12)))


def play(episode, calls):
    """Make the calls, each in a step of its own; what was said to each write."""
    said = []
    for step, (tool, *values) in enumerate(calls, 1):
        match tool:
            case "observed":
                frame, angle = values
                episode.observed(whole(frame) if angle is None else look(frame, angle), step)
            case "noted":
                episode.noted("get_graph", values[0], step, *values[1:])
            case "refused":
                said.append(episode.refused("final_answer", *values, step))
            case _:
                said.append(episode.add(tool, values[0], step, *values[1:]))
    return said
