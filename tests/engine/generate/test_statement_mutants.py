"""Each statement matters: with one operator, relation or property changed, facts or questions differ, or none are made.

The changes are derived from the texts of the statements: the last operator is turned round, the first relation becomes
another one between the same tables, and the last property another one of the same type and table. If there is none, the
name becomes one that does not exist.
"""

import random
import re
from pathlib import Path

import pytest
from keyframe_layers import make_prover
from random_worlds import lively_world, random_world, sociable_world
from test_cypher_facts import keys_of
from worlds import load_world

import jrdb_avr
from jrdb_avr.engine.generate import cypher_facts, facts, layer
from jrdb_avr.engine.generate.cypher_facts import CypherFacts, statement_of
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.pool import fill_pool
from jrdb_avr.engine.generate.stored_layer import ensure_layer, layer_jobs
from jrdb_avr.queries.compiler import reads
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.schema.choice_labels import CHOICE_LABELS
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, SCENE_RELS
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

RULES = Rules()
FOLDERS = ("generators", "necessity", "search")
QUERIES = Path(jrdb_avr.__file__).parent / "queries"
NODES, RELS = SCENE_NODES | LAYER_NODES, SCENE_RELS | LAYER_RELS
SWAPS = {">=": "<", "<=": ">", "<>": "=", " = ": " <> ", " < ": " > ", " > ": " < "}
OPERATOR = re.compile("|".join(map(re.escape, SWAPS)))
PATTERN = re.compile(r"[(\[](\w*):([A-Z]\w*(?:\|[A-Z]\w*)*)[)\]]")
PROPERTY = re.compile(r"\b([a-z]\w*)\.(\w+)\b")


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
    """(start, end, new text) of each change of a statement, by kind."""
    tables = {found[1]: found[2].split("|")[0] for found in PATTERN.finditer(text)}
    begin, changes = text.index("\n"), {"operator": [], "relation": [], "property": []}
    for found in OPERATOR.finditer(text, begin):
        changes["operator"].append((*found.span(), SWAPS[found[0]]))
    for found in PATTERN.finditer(text, begin):
        start = found.start(2)
        for table in found[2].split("|"):
            if table in RELS:
                same = [name for name, (*ends, _) in RELS.items() if ends == list(RELS[table][:2])]
                changes["relation"].append((start, start + len(table), after(table, same)))
            start += len(table) + 1
    for found in PROPERTY.finditer(text, begin):
        if found[1] in tables:
            columns = columns_of(tables[found[1]])
            same = [name for name, kind in columns.items() if kind == columns.get(found[2])]
            changes["property"].append((*found.span(2), after(found[2], same) if same else "missing"))
    return changes


def mutants_of(path):
    """The changed statements of a file, by kind of the change."""
    text = read_statement(path)
    changes = changes_of(text)
    chosen = {
        "operator": changes["operator"][-1:],
        "relation": changes["relation"][:1],
        "property": changes["property"][-1:],
    }
    return {kind: text[:start] + new + text[end:] for kind, some in chosen.items() for start, end, new in some}


# -- the facts and questions of a store ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def searches(tmp_path_factory):
    """A `Layer` for each of some random worlds, with keys of its facts by the name of the statement."""
    rng, layers = random.Random(23), {}
    for number in range(15):
        make = (random_world, lively_world, sociable_world)[number % 3]
        layers |= make(rng, f"yard-2020-01-01_{number}")
    store = load_world(tmp_path_factory.mktemp("mutants"), layers)
    ensure_layer(store, RULES, 1)
    with Graph.open(store.graph_path, read_only=True) as graph:
        found = [job.layer(graph) for job in layer_jobs(store, RULES)]
        for search in found:
            # Otherwise few actions may be choices in these small worlds.
            search.present = frozenset(CHOICE_LABELS)
        yield [(search, keys_by_statement(search)) for search in found]


def keys_by_statement(search):
    found = {}
    for key in keys_of(search.facts, search.sequence, random.Random(5), 60):
        found.setdefault(statement_of(key), []).append(key)
    starts = [(row["track"], row["action"], row["first"]) for row in search.segments.values()]
    # A person without a list may do anything, and a person with two postures may have either.
    unread = [(who, frame) for frame, some in search.facts.people.items() for who in some if not some[who]["pose"]]
    starts += [(who, action, frame) for who, frame in unread[:40] for action in ("walking", "holding sth")]
    return found | {"onsets": [("onsets", search.sequence, *start) for start in starts]}


def results(search, keys, path):
    """What the program makes of a statement in one sequence: questions or facts."""
    folder, name = path.removesuffix(".cypher").split("/")
    if folder == "generators":
        form = TEMPLATES["presence" if name == "described" else name]
        pool = fill_pool(search, [form], make_prover(search))
        return sorted((one.key, one.row) for one in pool)
    if folder == "search":
        found = Facts(search.graph, search.sequence, RULES.load, with_faces=True)
        return (
            found.people,
            found.lists,
            found.keyframes,
            [found.ask(some) for kind, some in keys.items() if kind != "onsets"],
        )
    source = CypherFacts(search.graph, RULES.load)
    return source.complete(lambda: source.ask(keys.get(name, [])))


def is_noticed(searches, path, text, before):
    """Whether generation fails with a changed statement, or other facts or questions come of it in some sequence."""
    for number, (search, keys) in enumerate(searches):
        if number not in before:
            before[number] = results(search, keys, path)
        with pytest.MonkeyPatch.context() as patch:
            for module in (cypher_facts, facts, layer, reads):
                patch.setattr(module, "read_statement", lambda name: text if name == path else read_statement(name))
            try:
                found = results(search, keys, path)
            except Exception:
                return True
        if found != before[number]:
            return True
    return False


PATHS = [f"{folder}/{file.name}" for folder in FOLDERS for file in sorted((QUERIES / folder).glob("*.cypher"))]
QUICK = {next(path for path in PATHS if path.startswith(folder)) for folder in FOLDERS}


@pytest.mark.parametrize(
    "path", [pytest.param(path, marks=[] if path in QUICK else pytest.mark.slow) for path in PATHS]
)
def test_a_changed_statement_is_noticed(searches, path):
    mutants, before = mutants_of(path), {}
    assert len(mutants) >= 2
    assert [kind for kind, text in mutants.items() if not is_noticed(searches, path, text, before)] == []
