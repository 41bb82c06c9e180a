"""The keyframe layer of one sequence without a stored graph: in memory, made by the functions that fill the stored one.

with searched(store, sequence, rules) as context: ...          # a SearchContext, whose statements run
result = search(store, sequence, rules, candidates=None)       # what a worker of generation returns
with layers_in_memory(): generate(store, rules, workers=1)      # of a store without a graph: faster where it is small
"""

import contextlib

import pyarrow as pa
import pytest

from jrdb_avr.engine.generate import run
from jrdb_avr.engine.generate.context import LayerJob, SearchContext
from jrdb_avr.engine.generate.keyframe_graph import derived_tables
from jrdb_avr.engine.generate.keyframes import keyframe_tables
from jrdb_avr.engine.generate.scene import load_scene
from jrdb_avr.engine.generate.sequence import SequenceJob, search_sequence
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.keyframes import SPAN
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, SCENE_NODES, table_ddl
from jrdb_avr.schema.panorama import CROP, Box, crop_left, to_crop
from jrdb_avr.schema.rules import LoadRules, Rules

ANY_VIEW = Rules(load=LoadRules(visibility="any"))
"""Rules under which generation does not judge who is in clear view, and covered people do not exist."""

WORLDS = 40
"""Scenes in one graph: to make a graph takes as long as to fill it, and so does to copy into a large one."""


class _SharedGraph:
    """A graph in memory for several scenes, each in a range of ids of its own, as in a store."""

    def __init__(self):
        self.graph = Graph.memory(prepares=True)
        self.scenes = 0
        self.persons = set()
        for statement in table_ddl({"Person": SCENE_NODES["Person"]} | KEYFRAME_NODES, KEYFRAME_RELS):
            self.graph.execute(statement)

    def add(self, scene, rules):
        """The scene prepared for search, its rows in the graph."""
        context = SearchContext(scene, rules, self.scenes * SPAN, self.graph)
        self.scenes += 1
        tracks = {f"{scene.sequence}/{track}": track for track in scene.tracks.tolist()}
        new = sorted(tracks.keys() - self.persons)
        self.persons |= tracks.keys()
        columns = [column.split() for column in SCENE_NODES["Person"].split(", ")]
        types = {"STRING": pa.string(), "INT64": pa.int64()}
        known = {"id": new, "track": [tracks[person] for person in new]}
        rows = [pa.array(known.get(name, [None] * len(new)), types[kind]) for name, kind, *_ in columns]
        self._copy("Person", pa.table(rows, [name for name, *_ in columns]))
        for tables in (keyframe_tables, lambda context: derived_tables(context).items()):
            for name, rows in tables(context):
                self._copy(name, rows)
        return context

    def _copy(self, name, rows):
        if len(rows):
            self.graph.copy(name, rows)


_shared = []


@contextlib.contextmanager
def searched(store, sequence, rules):
    """A sequence prepared for search, with its layer in memory."""
    scene = load_scene(store, sequence)
    # One in which a copy failed is of no use to others.
    current = _shared.pop() if _shared and _shared[0].scenes < WORLDS else _SharedGraph()
    context = current.add(scene, rules)
    _shared[:] = [current]
    yield context


def layer_rows(store):
    """Every row of a stored layer, by table."""
    with Graph.open(store.graph_path, read_only=True) as graph:
        found = {name: graph.query(f"MATCH (n:{name}) RETURN n.*", ordered=False) for name in KEYFRAME_NODES}
        for name, (source, target, columns) in KEYFRAME_RELS.items():
            listed = "".join(f", r.{column.split()[0]}" for column in columns)
            text = f"MATCH (a:{source})-[r:{name}]->(b:{target}) RETURN a.id, b.id{listed}"
            found[name] = graph.query(text, ordered=False)
    return {name: sorted(map(repr, rows.to_pylist())) for name, rows in found.items()}


def search(store, sequence, rules, candidates=None):
    """What a worker of generation returns for a sequence."""
    with layers_in_memory():
        return search_sequence(SequenceJob(store.path, sequence, 0, rules, candidates))


@contextlib.contextmanager
def layers_in_memory():
    """A context in which generation by one worker makes the layer of each sequence in memory while it is searched."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LayerJob, "searching", lambda job: searched(Store(job.store), job.sequence, job.rules))
        patch.setattr(run, "ensure_layer", lambda store, *_: dict.fromkeys(store.manifest().sequences, 0))
        patch.setattr(run, "hold_graph", lambda *_: contextlib.nullcontext())
        yield


def all_steps(context):
    """Return where relations lead from visible people: frame, source, relation, outcome, target."""
    text = """
        MATCH (:Moment)-[s:Step]->(b:Moment) WHERE b.id >= $low AND b.id < $low + 4294967296
        WITH DISTINCT s.relation AS relation, s.bit AS bit
        MATCH (a:Moment) WHERE a.id >= $low AND a.id < $low + 4294967296 AND coalesce(a.seen, 1) = 1
          AND a.track IS NOT NULL
        OPTIONAL MATCH (a)-[k:Step]->(b:Moment) WHERE k.relation = relation
        RETURN a.frame AS frame, a.track AS source, relation,
               CASE WHEN b.track IS NOT NULL THEN 'defined' WHEN b.id IS NOT NULL THEN b.nowhere
                    WHEN bitwise_and(a.open, bit) > 0 THEN 'unknown' ELSE 'empty' END AS outcome, b.track AS target
        ORDER BY frame, source, relation"""
    return context.graph.query(text, {"low": context.low})


def visible_share(box: Box, angle_deg: float) -> float:
    """Share, [0, 1], of the box's width that the crop at `angle_deg` shows. A box without width: 0."""
    if not box.w > 0:
        return 0.0
    seen = to_crop(box, crop_left(angle_deg))
    return max(0.0, min(seen.x + seen.w, float(CROP)) - max(seen.x, 0.0)) / box.w
