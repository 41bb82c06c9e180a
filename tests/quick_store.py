"""The tables of small worlds without the graph and the manifest: all that searching a sequence reads."""

from pathlib import Path

import pytest
from worlds import write_root

from jrdb_avr.loaders import load
from jrdb_avr.loaders.layers import find_root
from jrdb_avr.loaders.load import Shard, load_shard
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import LoadRules


def quick_store(folder, world):
    """Write a world, load its sequences one by one, and return the store. Raises InputError for unusable worlds."""
    root = write_root(Path(folder) / "root", world)
    store = Store(Path(folder) / "store")
    with pytest.MonkeyPatch.context() as patch:
        # What a graph would be built from.
        patch.setattr(load, "stage_scene", lambda *arguments: None)
        for files in find_root(root).sequences:
            load_shard(Shard(files, str(store.path), LoadRules()))
    return store
