"""Each statement matters: with an operator, relation or property changed, facts or questions differ, or generation fails.

The changes are derived from the texts of the statements. A relation becomes another one between the same tables, and a
property becomes another one of the same type and table. If there is none, the name becomes one that does not exist.
"""

import random
import re
from functools import cache
from itertools import chain
from pathlib import Path

import pytest
from keyframe_layers import make_prover
from random_worlds import lively_world, random_world, sociable_world
from test_cypher_facts import keys_of
from worlds import load_world

import jrdb_avr
from jrdb_avr.engine.generate import cypher_facts, facts, propose
from jrdb_avr.engine.generate.cypher_facts import CypherFacts, statement_of
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.pool import fill_pool
from jrdb_avr.engine.generate.propose import Search
from jrdb_avr.engine.generate.stored_layer import ensure_layer, layer_jobs
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.errors import QueryError
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, SCENE_RELS
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

RULES = Rules()
QUERIES = Path(jrdb_avr.__file__).parent / "queries"
NODES, RELS = SCENE_NODES | LAYER_NODES, SCENE_RELS | LAYER_RELS
SWAPS = {">=": "<", "<=": ">", "<>": "=", " = ": " <> ", " < ": " > ", " > ": " < "}
OPERATOR = re.compile("|".join(map(re.escape, SWAPS)))
PATTERN = re.compile(r"[(\[](\w*):([A-Z]\w*(?:\|[A-Z]\w*)*)[)\]]")
PROPERTY = re.compile(r"\b([a-z]\w*)\.(\w+)\b")
FAILURES = (QueryError, KeyError, ValueError, TypeError, StopIteration)


def columns_of(table):
    """{column: type} of a table."""
    texts = RELS[table][2] if table in RELS else NODES[table].replace("`", "").split(", ")
    return dict(text.split()[:2] for text in texts)


def after(name, names):
    """The name that follows another one in a circle, or one that does not exist."""
    names = list(names)
    other = names[(names.index(name) + 1) % len(names)]
    return other if other != name else "missing"


def changes_of(text):
    """Yield each statement with one operator, relation or property changed, and the kind of the change."""
    tables = {found[1]: found[2].split("|")[0] for found in PATTERN.finditer(text)}
    begin = text.index("\n")
    for found in OPERATOR.finditer(text, begin):
        yield "operator", found.start(), found.end(), SWAPS[found[0]]
    for found in PATTERN.finditer(text, begin):
        start = found.start(2)
        for table in found[2].split("|"):
            if table in RELS:
                same = [name for name, (*ends, _) in RELS.items() if ends == list(RELS[table][:2])]
                yield "relation", start, start + len(table), after(table, same)
            start += len(table) + 1
    for found in PROPERTY.finditer(text, begin):
        if found[1] in tables:
            columns = columns_of(tables[found[1]])
            same = [name for name, kind in columns.items() if kind == columns.get(found[2])]
            yield "property", *found.span(2), after(found[2], same) if same else "missing"


def mutants_of(path):
    text = read_statement(path)
    for kind, start, end, new in changes_of(text):
        yield kind, text[:start] + new + text[end:]


# -- the facts and questions of a store ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def searches(tmp_path_factory):
    """A `Search` for each of some random worlds."""
    rng, layers = random.Random(23), {}
    for number in range(15):
        make = (random_world, lively_world, sociable_world)[number % 3]
        layers |= make(rng, f"yard-2020-01-01_{number}")
    store = load_world(tmp_path_factory.mktemp("mutants"), layers)
    ensure_layer(store, RULES, 1)
    with Graph.open(store.graph_path, read_only=True) as graph:
        yield [Search(graph, job.sequence, job.layer(graph), RULES) for job in layer_jobs(store, RULES)]


def keys(search):
    """Keys of facts of a sequence, by the name of the statement."""
    found = {}
    for key in keys_of(search.layer.facts, search.sequence, random.Random(5), 60):
        found.setdefault(statement_of(key), []).append(key)
    starts = [(row["track"], row["action"], row["first"]) for row in search.layer.segments.values()]
    found["onsets"] = [("onsets", search.sequence, *start) for start in starts]
    return found


def questions(search, name):
    """The questions that are proven of the rows of a generator, with their people and times."""
    form = "presence" if name == "described" else name
    pool = fill_pool(search, [TEMPLATES[form]], make_prover(search))
    return sorted((one.key, one.answer, *one.people.items(), *one.frames.items()) for one, _ in pool)


def results(search, path):
    """What the program makes of a statement in one sequence."""
    folder, name = path.removesuffix(".cypher").split("/")
    if folder == "generators":
        return questions(search, name)
    if folder == "search":
        found = Facts(search.graph, search.sequence, RULES.load, with_faces=True)
        asked = list(chain.from_iterable(keys(search).values()))
        return found.people, found.keyframes, found.ask([key for key in asked if key[0] != "onsets"])
    source = CypherFacts(search.graph, RULES.load)
    return source.complete(lambda: source.ask(keys(search).get(name, [])))
