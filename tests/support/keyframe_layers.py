"""Generation over graphs in memory, for small stores without a stored graph.

with searched(store, sequence, rules) as search: ...            # a Layer, whose statements run
for one in proposals(search, template): make_prover(search).prove(one)
result, candidates = search_one(store, sequence, rules)         # what a worker of generation returns
rows, faults = make_all(store, sequence, rules, candidates, result.counts)
with layers_in_memory(): generate(store, rules, workers=1)
"""

import contextlib
import itertools

import pytest

from jrdb_avr.engine.generate import question, run
from jrdb_avr.engine.generate.asked import Question
from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.guessers import LabelCounts
from jrdb_avr.engine.generate.layer import Layer
from jrdb_avr.engine.generate.levelling import level_choices
from jrdb_avr.engine.generate.perturb import Setting, prove
from jrdb_avr.engine.generate.pool import Prover
from jrdb_avr.engine.generate.propose import Proposal, program_of, propose, propose_presence
from jrdb_avr.engine.generate.run import search_sequence
from jrdb_avr.engine.generate.stored_layer import Job, layer_jobs
from jrdb_avr.loaders.graph import build_scene
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, table_ddl
from jrdb_avr.schema.rules import LoadRules, Rules, frames
from jrdb_avr.schema.templates import FORMS, TEMPLATES

ANY_VIEW = Rules(load=LoadRules(visibility="any"))
"""Rules under which generation does not judge who is in clear view, and covered people do not exist."""


def memory_graph(store, sequences):
    """A graph with the scenes of some sequences and the tables of the keyframe layer."""
    graph = Graph.memory(prepares=True)
    build_scene(graph, store, sequences)
    for statement in table_ddl(LAYER_NODES, LAYER_RELS):
        graph.execute(statement)
    return graph


def add_layer(graph, layer):
    for name, rows in layer.tables():
        graph.copy(name, rows)


@contextlib.contextmanager
def searched(store, sequence, rules):
    """A sequence ready to be searched."""
    graph = memory_graph(store, [sequence])
    layer = Layer(store, graph, sequence, rules)
    add_layer(graph, layer)
    yield layer


def make_prover(search, held_out=()):
    return Prover(search, CypherFacts(search.graph, search.rules.load, search.facts), held_out)


def forms_in(store, sequence):
    """The forms of templates whose layers the sequence has."""
    (layers,) = store.interval("sequence", sequence)["layers"].to_pylist()
    return [template for template in TEMPLATES.values() if set(template.layers) <= set(layers)]


def proposals(search, template):
    """Every proposal of a form of a template."""
    if template.name != "presence":
        yield from (Proposal(search, template, row) for row in propose(search, template))
        return
    described, pairs = propose_presence(search, template)
    wait = frames(search.rules.min_wait_s)
    for who, rows in described.items():
        for row, pair in itertools.product(rows, pairs.get(who, ())):
            if pair["t1"] >= row["t0"] + wait and not (row["ahead"] and pair["away"]):
                yield Proposal(search, template, row | pair)


def all_proofs(search, one):
    """The proofs of a proposal about conditions, hops and times, whether they hold or not."""
    cypher = CypherFacts(search.graph, search.rules.load, search.facts)
    setting = Setting(cypher, search.facts.keyframes, search.rules)
    return cypher.complete(lambda: prove(*program_of(one), setting))


@contextlib.contextmanager
def worked(store, sequence, rules):
    """A context in which workers read a sequence from memory."""
    with searched(store, sequence, rules) as search, pytest.MonkeyPatch.context() as patch:
        for module in (run, question):
            patch.setattr(module, "Store", lambda path: store)
            patch.setattr(module, "open_worker_graph", lambda path: contextlib.nullcontext(search.graph))
        patch.setattr(Job, "layer", lambda *_: search)
        yield


def search_one(store, sequence, rules):
    """What a worker of generation returns for a sequence: the result, and its candidates."""
    with worked(store, sequence, rules):
        found = search_sequence(Job(store.path, sequence, 0, rules))
    return found, run._CANDIDATES.decode(found.pool)


def make_all(store, sequence, rules, candidates, counts):
    """Rows of questions about all candidates, by their choices, and their faults."""
    level = LabelCounts({(sequence, frame): number for frame, number in counts.items()})
    rows, faults = [], []
    with worked(store, sequence, rules):
        for template in dict.fromkeys(one.template for one in candidates):
            own = [one for one in candidates if one.template == template]
            # Alone, each candidate stays.
            leveled = (level_choices([one], level, rules) for one in own if FORMS[template][0].asks_action)
            asked = list(itertools.chain.from_iterable(leveled))
            asked = tuple(asked or [Question(one, tuple(sorted(one.wrong))) for one in own])
            table, found = question.make_questions(Job(store.path, sequence, 0, rules, questions=asked))
            rows += [row | {"truth": one.candidate.truth} for row, one in zip(table.to_pylist(), asked, strict=True)]
            faults += found.values()
    return rows, faults


@contextlib.contextmanager
def layers_in_memory():
    """A context in which generation by one worker makes the graph of a store in memory."""
    graphs = []

    def ensure_layer(store, rules, *_):
        names = sorted(store.manifest().sequences)
        jobs = layer_jobs(store, rules)
        graphs[:] = [memory_graph(store, names)]
        for job in jobs:
            add_layer(graphs[0], job.layer(graphs[0]))
        return jobs

    def shared(*_):
        return contextlib.nullcontext(graphs[0])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "ensure_layer", ensure_layer)
        for module, name in ((run, "open_worker_graph"), (question, "open_worker_graph"), (run, "hold_graph")):
            patch.setattr(module, name, shared)
        yield
