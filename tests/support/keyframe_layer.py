"""The keyframe layer of one sequence without a stored graph: in memory, made by the functions that fill the stored one.

with searched(store, sequence, rules) as context: ...          # a SearchContext, whose statements run
result = search(store, sequence, rules, candidates=None)       # what a worker of generation returns
"""

import contextlib
from dataclasses import replace
from unittest import mock

import pyarrow as pa

from jrdb_avr.engine.generate import context as contexts
from jrdb_avr.engine.generate.context import SearchContext
from jrdb_avr.engine.generate.keyframe_graph import derived_tables
from jrdb_avr.engine.generate.keyframes import keyframe_tables
from jrdb_avr.engine.generate.scene import load_scene
from jrdb_avr.engine.generate.sequence import SequenceJob, search_sequence
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, SCENE_NODES, table_ddl


@contextlib.contextmanager
def searched(store, sequence, rules):
    """A sequence prepared for search, with its layer in memory."""
    context = SearchContext.of(load_scene(store, sequence), rules)
    with Graph.memory() as graph:
        for statement in table_ddl({"Person": SCENE_NODES["Person"]} | KEYFRAME_NODES, KEYFRAME_RELS):
            graph.execute(statement)
        tracks = pa.array(context.scene.tracks)
        persons = {"id": pa.array([f"{sequence}/{track}" for track in tracks]), "track": tracks}
        columns = [column.split() for column in SCENE_NODES["Person"].split(", ")]
        types = {"STRING": pa.string(), "INT64": pa.int64()}
        none = [persons.get(name, pa.nulls(len(tracks), types[kind])) for name, kind, *_ in columns]
        graph.copy("Person", pa.table(none, [name for name, *_ in columns]))
        for name, rows in keyframe_tables(context, 0):
            if len(rows):
                graph.copy(name, rows)
        context = replace(context, graph=graph)
        for name, rows in derived_tables(context).items():
            if len(rows):
                graph.copy(name, rows)
        yield context


def search(store, sequence, rules, candidates=None):
    """What a worker of generation returns for a sequence."""
    with searched(store, sequence, rules) as context:
        graph = lambda path: contextlib.nullcontext(context.graph)  # noqa: E731
        with mock.patch.object(contexts, "worker_graph", graph):
            return search_sequence(SequenceJob(store.path, sequence, 0, rules, candidates))
