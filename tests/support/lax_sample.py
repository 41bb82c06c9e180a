"""The sample benchmark under laxer rules, with the keyframe layer of these and without questions."""

import shutil

from jrdb_avr.engine.generate.keyframe_graph import ensure_layer
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import Rules

LAX_RULES = Rules(min_wait_s=2.0, long_wait_s=4.0, search_wait_s=1.0, turn_deg=8.5, gap_min_s=1.0, count_min=2)
"""Under which half a minute of the sample holds candidates of every template."""


def lax_sample(once, benchmark):
    """The store; `once` and `benchmark` are the fixtures `once` and `sample_benchmark`. Not to be written to."""

    def make(folder):
        shutil.copytree(benchmark.path, folder / "store", ignore=shutil.ignore_patterns("questions"))
        ensure_layer(Store(folder / "store"), LAX_RULES, 1)

    return Store(once("lax", make) / "store")
