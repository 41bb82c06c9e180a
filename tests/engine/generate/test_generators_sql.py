"""The candidates of every template, and what the perturbed programs read, joined by DuckDB over the interval tables.

The generators' Cypher and the SQL beside it (see `sql_search`) must give the same rows: descriptions, people, times,
relations, answers, and what each candidate says of itself.

    $ pytest tests/test_generators_sql.py -k three_hop
"""

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from scene_tables import scene_tables
from sql_search import JUDGED, OF_PATHS, SQL, Search

import jrdb_avr
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import Rules

pytestmark = pytest.mark.usefixtures("known_plans")

CYPHER = Path(jrdb_avr.__file__).parent / "queries"
GENERATORS = sorted(path.stem for path in (SQL / "generators").glob("*.sql"))
NECESSITY = sorted(path.stem for path in (SQL / "necessity").glob("*.sql"))
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
LAX_RULES = Rules(min_wait_s=2.0, long_wait_s=4.0, search_wait_s=1.0, turn_deg=8.5, gap_min_s=1.0, count_min=2)
"""Under which half a minute of the sample holds candidates of every template."""
SHIFT = 45
HOPS = {"two_hop": 2, "three_hop": 3}


@pytest.fixture(scope="module")
def searches(sample_benchmark, tmp_path_factory):
    """One sequence of the sample under the rules, the others under the laxer ones, and one of made-up tables, in which
    facts of every kind are uncertain everywhere."""
    store, made_up = sample_benchmark, Store(tmp_path_factory.mktemp("made-up"))
    for kind, table in scene_tables("yard-1_0", np.random.default_rng(1), frames=241, people=10).items():
        made_up.write_interval(kind, "yard-1_0", table)
    first, *others = sorted(path.stem for path in (store.path / "intervals" / "sightings").glob("*.parquet"))
    made = [Search(store, first, Rules(), STRICT)]
    made += [Search(store, sequence, LAX_RULES, LAX) for sequence in others]
    made.append(Search(made_up, "yard-1_0", LAX_RULES, LAX))
    yield made
    for search in made:
        search.close()


def test_there_is_sql_for_every_query():
    judged = {query for queries in JUDGED.values() for query in queries}
    for folder, written in (("generators", GENERATORS), ("necessity", NECESSITY)):
        queries = {path.stem for path in (CYPHER / folder).glob("*.cypher")}
        assert queries - judged == set(written) - set(JUDGED)


@pytest.mark.parametrize("name", GENERATORS)
def test_duckdb_finds_the_same_candidates_as_the_generator(searches, name):
    rows = 0
    for search in searches:
        number, only_sql, only_cypher = search.differences("generators", name, search.generated(name))
        assert (only_sql, only_cypher) == ([], [])
        rows += number
    assert rows >= 10


@pytest.mark.parametrize("name", NECESSITY)
def test_duckdb_reads_the_same_from_perturbed_programs(searches, name):
    template, _, kind = name.rpartition("_")
    variants = {
        "shift": [("moved_by", "by", -SHIFT), ("moved_by", "by", SHIFT)],
        "skip": [("skipped", "skipped", hop) for hop in range(1, HOPS.get(template, 0))],
        "drop": [None],
    }[kind]
    rows = 0
    for search in searches:
        with search.paths(template) if template in OF_PATHS else nullcontext() as found:
            for variant in variants:
                macro, parameter, value = variant or (None, None, None)
                read = search.perturbed(name, found, **({parameter: value} if variant else {}))
                changed = {macro: value} if variant else {}
                number, only_sql, only_cypher = search.differences("necessity", name, read, **changed)
                assert (only_sql, only_cypher) == ([], [])
                rows += number
    assert rows >= 50
