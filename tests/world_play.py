"""A world model for tests: questions, observations without pictures, and every row of the world tables."""

import numpy as np

from jrdb_avr.agent.world import World
from jrdb_avr.schema.method import Observation, Panorama, Question
from jrdb_avr.schema.panorama import FOV_DEG, crop_left
from jrdb_avr.schema.world import WORLD_NODES, WORLD_RELS

NOTHING = np.zeros((1, 1, 3), np.uint8)


def question(number):
    return Question(f"{number:016x}", "s", "family", "template", "Who?", (), "number")


def look(frame, angle=180.0):
    return Observation("s", frame, f"{frame:06d}", frame / 15, angle, FOV_DEG, int(crop_left(angle)), NOTHING)


def whole(frame):
    return Panorama("s", frame, f"{frame:06d}", frame / 15, b"")


def begin(graph, number=0, run="run"):
    """An episode, and the list of its writes."""
    writes = []
    return World(graph, run).episode(question(number), writes.append), writes


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
