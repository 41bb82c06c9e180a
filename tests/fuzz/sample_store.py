"""A small store with a graph, questions and a run, made once per folder from the sample world."""

from __future__ import annotations

from pathlib import Path

from scored_runs import stored_failures

from jrdb_avr.loaders.load import load
from jrdb_avr.loaders.synthetic.write import Order, sequence_name, write_sequence
from jrdb_avr.queries.store import Store

_made: dict[str, Store] = {}


def sample_store(folder):
    """(store, name of its one sequence). Its questions and its run are of a world of their own."""
    name = sequence_name(0)
    if str(folder) not in _made:
        place = Path(folder) / "sample"
        if not (place / "store" / "runs").exists():
            write_sequence(Order(str(place / "root"), name, 1, 240, 8, "none"))
            store = Store(place / "store")
            load(place / "root", store, workers=1)
            stored_failures(place / "store")
        _made[str(folder)] = Store(place / "store")
    return _made[str(folder)], name
