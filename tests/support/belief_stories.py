"""Episodes of beliefs written straight into the world tables, and plans for them."""

import json
import uuid
from hashlib import sha256

import pyarrow as pa

from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.plan import parse_plan

ALWAYS = 10_000_000
_TYPES = {"STRING": pa.string(), "INT64": pa.int64(), "DOUBLE": pa.float64(), "BOOLEAN": pa.bool_()}
_TYPES["UUID"] = pa.string()
_BOX = pa.struct([(name, pa.float64()) for name in "xywh"])
_EMPTY = {"STRING": "", "INT64": 0, "DOUBLE": 0.0, "BOOLEAN": True}
CIRCLE = tuple(470 * k for k in range(8))
"""Left columns of eight crops that show all round."""


class Story:
    """One episode, written a line at a time."""

    def __init__(self):
        self.rows = {"observations": [], "sightings": [], "attributes": [], "relations": []}
        self.nodes = {}
        self._writes = 0

    def look(self, frame, *lefts, width=480):
        for left in lefts:
            name = f"o{len(self.rows['observations']) + 1}"
            self.rows["observations"].append({"name": name, "frame": frame, "left": left % 3760, "width": width})
        return self

    def panorama(self, frame):
        return self.look(frame, 0, width=3760)

    def sees(self, entity, *frames, box=None, current=True, **attributes):
        """Sightings of an entity, with attributes at each frame; a list holds several values."""
        for frame in frames:
            if all(one["frame"] != frame for one in self.rows["observations"]):
                self.look(frame, 1000)
            self._writes += 1
            place = box or (100.0 + self._writes, 50.0, 40.0, 120.0)
            row = {"box": place, "angle": 10.0 + self._writes, "write": self._writes, "current": current}
            self.rows["sightings"].append({"entity": entity, "frame": frame, **row})
            for name, values in attributes.items():
                for value in values if isinstance(values, list) else [values]:
                    self.has(entity, name, value, frame)
        return self

    def has(self, entity, name, value, frame, current=True):
        number = float(value) if isinstance(value, int | float) else 0.0
        always = name in ("gender", "age")
        span = {"first": 0 if always else frame, "last": ALWAYS if always else frame}
        row = {"entity": entity, "name": name, "value": str(value), "number": number, "seen": frame}
        self.rows["attributes"].append({**row, **span, "current": current})
        return self

    def tie(self, source, name, target, *frames, current=True):
        for frame in frames:
            row = {"source": source, "target": target, "name": name, "frame": frame, "current": current}
            self.rows["relations"].append(row)
        return self

    def is_node(self, entity, node):
        self.nodes[entity] = node
        return self


def write(graph, stories):
    """Put episodes into the world tables of a graph: stories by key."""
    tables = {name: [] for name in (*WORLD_NODES, *WORLD_RELS)}
    for key, story in stories.items():
        tables["Episode"].append({"id": key})
        of_episode = {"episode": key, "episode_hash": hash_of(key)}
        at = {}
        for number, one in enumerate(story.rows["observations"], 1):
            name = f"{key}/{one['name']}"
            at.setdefault(one["frame"], name)
            row = {"id": name, **of_episode, "number": number, "frame": one["frame"], "left": one["left"]}
            tables["Observation"].append({**row, "width": one["width"]})
            tables["Made"].append({"from": key, "to": name})
        for number, name in enumerate(sorted({one["entity"] for one in story.rows["sightings"]})):
            row = {"id": f"{key}/{name}", **of_episode, "name": name, "number": number}
            tables["Entity"].append({**row, "node": story.nodes.get(name, ""), "kind": "person"})
            tables["Holds"].append({"from": key, "to": f"{key}/{name}"})
        for one in story.rows["sightings"]:
            box = dict(zip("xywh", one["box"], strict=True))
            edge = {"from": f"{key}/{one['entity']}", "to": at[one["frame"]], "episode": key, "who": one["entity"]}
            tables["Sighted"].append({**one, **edge, "box": box})
        for one in story.rows["attributes"]:
            edge = {"from": f"{key}/{one['entity']}", "to": at[one["seen"]], "episode": key, "who": one["entity"]}
            tables["Has"].append({**one, **edge})
        for one in story.rows["relations"]:
            edge = {"from": f"{key}/{one['source']}", "to": f"{key}/{one['target']}", "episode": key}
            span = {"first": one["frame"], "last": one["frame"], "observation": at[one["frame"]]}
            ends = {"who": one["source"], "whom": one["target"]}
            tables["Related"].append({**one, **edge, **span, **ends})
    for name, rows in tables.items():
        if rows:
            _add(graph, name, _table(name, rows))


def _add(graph, name, rows):
    """As `graph.copy`, which takes three times as long for a few rows, and has every plan looked at anew."""
    values = {c: f"CAST({c} AS UUID)" if c.endswith("_hash") else c for c in rows.column_names if c not in ENDS}
    made = ", ".join(f"{column}: {value}" for column, value in values.items())
    if name in WORLD_NODES:
        text = f"LOAD FROM $rows CREATE (:{name} {{{made}}})"
    else:
        source, target, _ = WORLD_RELS[name]
        rows = rows.rename_columns([ENDS.get(column, column) for column in rows.column_names])
        ends = f"(a:{source} {{id: source_id}}), (b:{target} {{id: target_id}})"
        text = f"LOAD FROM $rows MATCH {ends} CREATE (a)-[:{name} {{{made}}}]->(b)"
    with graph._writing():
        graph._run(text, {"rows": rows}, None)


ENDS = {"from": "source_id", "to": "target_id"}
"""The ends of an edge, under names that a statement may hold."""


def hash_of(key):
    """Half of an episode's SHA-256, written as a UUID."""
    return str(uuid.UUID(bytes=sha256(key.encode()).digest()[:16]))


def _table(name, rows):
    if name in WORLD_NODES:
        columns = [column.split()[:2] for column in WORLD_NODES[name].split(", ")]
    else:
        columns = [("from", "STRING"), ("to", "STRING"), *(c.split(" ", 1) for c in WORLD_RELS[name][2])]
    made = {}
    for column, kind in columns:
        values = [row.get(column, _EMPTY.get(kind)) for row in rows]
        made[column] = pa.array(values, _TYPES.get(kind, _BOX))
    return pa.table(made)


def planned(read="action", at="t1", times=None, nodes=None, edges=(), target=None, relation=None):
    """A plan as a dict. nodes: conditions by node, the root first; edges: (source, relation, target, time)."""
    nodes = nodes or {"a": [{"attribute": "gender", "value": "female"}]}
    times = {"t0": {"frame": 0}, "t1": {"frame": 30}} if times is None else times
    target = target or list(nodes)[-1]
    modes = {"start": "frame", "span": "span", "start_view": "frame_viewpoint"}
    modes |= {"seconds_between": "number", "count": "number"}
    answer = {"mode": modes.get(read, "multiple_choice"), "read": read, "of": target, "at": at}
    return {
        "root": next(iter(nodes)),
        "target": target,
        "times": times,
        "nodes": [{"id": node, "conditions": conditions} for node, conditions in nodes.items()],
        "edges": [{"source": a, "relation": r, "target": b, "at": t} for a, r, b, t in edges],
        "answer": answer if relation is None else answer | {"relation": relation},
    }


def parsed(plan):
    return parse_plan(json.dumps(plan))
