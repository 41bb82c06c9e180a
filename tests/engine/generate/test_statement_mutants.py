"""Each statement matters: with one operator changed, facts or questions differ, or the statement fails."""

import random
import re
from pathlib import Path

import pytest
from keyframe_layers import make_prover
from random_worlds import lively_world, random_world, sociable_world
from test_cypher_facts import check_facts
from worlds import load_world

import jrdb_avr
from jrdb_avr.engine.generate import cypher_facts, facts, propose
from jrdb_avr.engine.generate.perturb import NoAnswerError
from jrdb_avr.engine.generate.pool import fill_pool
from jrdb_avr.engine.generate.propose import Search
from jrdb_avr.engine.generate.stored_layer import layer_jobs
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

RULES = Rules()
QUERIES = Path(jrdb_avr.__file__).parent / "queries"
SWAPS = {">=": "<", "<=": ">", "<>": "=", " = ": " <> ", " < ": " > ", " > ": " < "}
OPERATOR = re.compile("|".join(map(re.escape, SWAPS)))
FACTS = ("condition_", "relation_", "people_at", "onsets")


def mutant_of(text):
    """The statement with the last operator of its first test changed: those before may only name the sequence."""
    begin = text.rindex("WHERE") if "phase" in text else text.index("WHERE")
    end = min(at for word in ("RETURN", "WITH", "OPTIONAL") if (at := text.find(word, begin)) > 0)
    found = list(OPERATOR.finditer(text, begin, end))[-1]
    return text[: found.start()] + SWAPS[found[0]] + text[found.end() :]


def change_statement(monkeypatch, path):
    text = mutant_of(read_statement(path))
    assert text != read_statement(path)
    for module in (cypher_facts, facts, propose):
        monkeypatch.setattr(module, "read_statement", lambda name: text if name == path else read_statement(name))


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    rng, layers = random.Random(23), {}
    for number in range(15):
        make = (random_world, lively_world, sociable_world)[number % 3]
        layers |= make(rng, f"yard-2020-01-01_{number}")
    return load_world(tmp_path_factory.mktemp("mutants"), layers)


def names(folder, *prefixes):
    return [path.stem for path in sorted((QUERIES / folder).glob("*.cypher")) if path.stem.startswith(prefixes)]


@pytest.mark.parametrize(
    "path",
    [*(f"necessity/{name}.cypher" for name in names("necessity", *FACTS[:3]))]
    + [f"search/{name}.cypher" for name in names("search", "")],
)
def test_a_changed_statement_of_facts_changes_facts(worlds, monkeypatch, path):
    change_statement(monkeypatch, path)
    with Graph.open(worlds.graph_path, read_only=True) as graph, pytest.raises((AssertionError, QueryError)):
        compared = check_facts(graph, sorted(worlds.manifest().sequences), random.Random(5))
        assert len(compared) == 15


def pools(store, form):
    """The keys of the questions of one form of a template in the sequences of a store."""
    keys = set()
    with Graph.open(store.graph_path, read_only=True) as graph:
        for job in layer_jobs(store, RULES):
            search = Search(graph, job.sequence, job.layer(graph), RULES)
            prover = make_prover(search)
            keys |= {one.key for one, _ in fill_pool(search, [TEMPLATES[form]], prover)}
    return keys


@pytest.mark.parametrize("name", names("generators", ""))
def test_a_changed_generator_changes_questions(sample_benchmark, monkeypatch, name):
    form = "presence" if name == "described" else name
    before = pools(sample_benchmark, form)
    change_statement(monkeypatch, f"generators/{name}.cypher")
    try:
        after = pools(sample_benchmark, form)
    except (QueryError, NoAnswerError, KeyError, ValueError):
        return
    assert after != before
