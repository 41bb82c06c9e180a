"""The candidates of every template, and what the perturbed programs read, joined by DuckDB over the interval tables.

The statements of `queries` over the keyframe layer and the SQL beside them (see `sql_search`) must give the same rows:
descriptions, people, times, relations, answers, and what each candidate says of itself.

    $ pytest tests/engine/generate/test_generators_sql.py -k three_hop
"""

import contextlib
import random
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from effort import DEEP
from keyframe_layer import searched
from lax_sample import LAX_RULES, lax_sample
from lively_worlds import lively_world, sociable_world
from other_words import in_other_words
from quick_store import memory_store
from random_worlds import random_world
from scene_tables import scene_tables
from sql_search import SQL, Search, all_steps

import jrdb_avr
from jrdb_avr.engine.generate.context import LayerJob
from jrdb_avr.engine.generate.keyframe_graph import stored_layer
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import Rules

CYPHER = Path(jrdb_avr.__file__).parent / "queries"
FILES = {
    folder: sorted(path.stem for path in (CYPHER / folder).glob("*.cypher"))
    for folder in ("generators", "necessity", "search")
}
STRICT = {
    "wait": 45,
    "long_wait": 150,
    "search_wait": 30,
    "turn_degrees": 20,
    "least_gap": 75,
    "least_people": 4,
    "changed": 1.5,
    "same": 0.5,
}
"""The rules as they stand in the specification: frames, degrees, people and metres."""
LAX = STRICT | {"wait": 30, "long_wait": 60, "search_wait": 15, "turn_degrees": 8.5, "least_gap": 15, "least_people": 2}
SHIFT = 45


@pytest.fixture(scope="module")
def searches(once, sample_benchmark, tmp_path_factory):
    """One sequence of the sample under the rules, the other under the laxer ones, and one of made-up tables, in which
    facts of every kind are uncertain everywhere."""
    made_up = Store(tmp_path_factory.mktemp("made-up"))
    for kind, table in scene_tables("yard-1_0", np.random.default_rng(1), frames=241, people=10).items():
        made_up.write_interval(kind, "yard-1_0", table)
    lax = lax_sample(once, sample_benchmark)
    with contextlib.ExitStack() as stack:

        def stored(store, sequence, rules):
            low = stored_layer(store, rules)[sequence]
            return stack.enter_context(LayerJob(store.path, sequence, low, rules).searching())

        first, second = sorted(sample_benchmark.manifest().sequences)
        made = [
            Search(sample_benchmark, stored(sample_benchmark, first, Rules()), STRICT),
            Search(lax, stored(lax, second, LAX_RULES), LAX),
            Search(made_up, stack.enter_context(searched(made_up, "yard-1_0", LAX_RULES)), LAX),
        ]
        yield made
        for search in made:
            search.database.close()


def test_there_is_sql_for_every_statement():
    for folder, names in FILES.items():
        assert names == sorted(path.stem for path in (SQL / folder).glob("*.sql"))


def agreed(searches, file, found, **values):
    """How many rows DuckDB finds in all, none of them other than Cypher's; `found` gives those of a search."""
    rows = 0
    for search in searches:
        number, only_sql, only_cypher = search.differences(file, found(search), **values)
        assert (only_sql, only_cypher) == ([], [])
        rows += number
    return rows


@pytest.mark.parametrize("name", FILES["generators"])
def test_duckdb_finds_the_same_candidates_as_the_generator(searches, name):
    assert agreed(searches, f"generators/{name}", partial(Search.found, folder="generators", name=name)) >= 10


def test_duckdb_judges_every_candidate_of_presence_alike(searches):
    assert agreed(searches, "presence", Search.judged_presence) >= 10_000


@pytest.mark.parametrize("name", FILES["necessity"])
def test_duckdb_reads_the_same_from_perturbed_programs(searches, name):
    rows = 0
    for by in (-SHIFT, SHIFT) if name.endswith("shift") else (None,):
        values = {} if by is None else {"by": by}
        read = partial(Search.found, folder="necessity", name=name, **values)
        rows += agreed(searches, f"necessity/{name}", read, moved_by=by or 0)
    assert rows >= 50


# -- any world --------------------------------------------------------------------------------------------------------


def test_duckdb_leads_everybody_to_the_same_people_and_names_the_same_anchors(tmp_path):
    counts, outcomes, world = Counter(), Counter(), {}
    for number, make in enumerate([random_world, lively_world, sociable_world] * (20 if DEEP else 2)):
        make = in_other_words(make) if number % 2 else make
        world |= make(random.Random(number), f"yard-{number:02d}")
    store = memory_store(tmp_path, world)
    for sequence in store.sequences:
        with searched(store, sequence, Rules()) as context:
            search = Search(store, context, STRICT, ("people", "relations", "descriptions"))
            for folder, name in [("explore", "descriptions"), *(("search", name) for name in FILES["search"])]:
                counts[name] += agreed([search], f"{folder}/{name}", partial(Search.found, folder=folder, name=name))
            steps = all_steps(context)
            agreed([search], "all_steps", lambda _, steps=steps: steps)
            outcomes.update(steps["outcome"].to_pylist())
            search.database.close()
    assert min(counts.values()) >= 300
    assert set(outcomes) == {"defined", "empty", "ambiguous", "unknown"}
