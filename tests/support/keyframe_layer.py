"""The keyframe layer of one sequence without a stored graph: in memory, made by the functions that fill the stored one.

with searched(store, sequence, rules) as context: ...          # a SearchContext, whose statements run
result = search(store, sequence, rules, candidates=None)       # what a worker of generation returns
with layers_in_memory(): generate(store, rules, workers=1)      # of a store without a graph: faster where it is small
"""

import contextlib
from types import SimpleNamespace

import pyarrow as pa
import pytest

from jrdb_avr.engine.generate import run
from jrdb_avr.engine.generate.context import LayerJob, SearchContext
from jrdb_avr.engine.generate.keyframe_graph import derived_tables
from jrdb_avr.engine.generate.keyframes import keyframe_tables
from jrdb_avr.engine.generate.scene import load_scene
from jrdb_avr.engine.generate.sequence import SequenceJob, search_sequence
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, SCENE_NODES, table_ddl


@contextlib.contextmanager
def searched(store, sequence, rules):
    """A sequence prepared for search, with its layer in memory."""
    with Graph.memory() as graph:
        context = SearchContext(load_scene(store, sequence), rules, 0, graph)
        for statement in table_ddl({"Person": SCENE_NODES["Person"]} | KEYFRAME_NODES, KEYFRAME_RELS):
            graph.execute(statement)
        tracks = pa.array(context.scene.tracks)
        persons = {"id": pa.array([f"{sequence}/{track}" for track in tracks]), "track": tracks}
        columns = [column.split() for column in SCENE_NODES["Person"].split(", ")]
        types = {"STRING": pa.string(), "INT64": pa.int64()}
        none = [persons.get(name, pa.nulls(len(tracks), types[kind])) for name, kind, *_ in columns]
        graph.copy("Person", pa.table(none, [name for name, *_ in columns]))
        for name, rows in keyframe_tables(context):
            if len(rows):
                graph.copy(name, rows)
        for name, rows in derived_tables(context).items():
            if len(rows):
                graph.copy(name, rows)
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
        patch.setattr(run, "Graph", SimpleNamespace(open=lambda path, read_only: contextlib.nullcontext()))
        yield
