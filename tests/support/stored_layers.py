"""Rows of a stored keyframe layer."""

from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS


def layer_rows(store):
    """Every row of a stored layer, by table, without the stamp."""
    with Graph.open(store.graph_path, read_only=True) as graph:
        found = {}
        for name, columns in LAYER_NODES.items():
            listed = ", ".join(f"n.{column.split()[0]}" for column in columns.split(", "))
            found[name] = graph.query(f"MATCH (n:{name}) RETURN {listed}", ordered=False)
        for name, (source, target, columns) in LAYER_RELS.items():
            listed = "".join(f", r.{column.split()[0]}" for column in columns)
            key = "name" if target == "Action" else "id"
            text = f"MATCH (a:{source})-[r:{name}]->(b:{target}) RETURN a.id, b.{key}{listed}"
            found[name] = graph.query(text, ordered=False)
    del found["Keyframes"]
    return {name: sorted(repr(tuple(row.values())) for row in rows.to_pylist()) for name, rows in found.items()}
