"""Perturbed programs over statements and over sets give the proofs that published questions store."""

from collections import Counter

from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.facts import Facts
from jrdb_avr.engine.generate.perturb import MissingFactsError, prove
from jrdb_avr.engine.validate.checks import read_records
from jrdb_avr.engine.validate.replay import read_plans
from jrdb_avr.engine.validate.validation import Validation
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import FORMS

RULES = Rules()
KINDS = ("anchor", "hop.stop", "hop.skip", "time.shift", "time.drop")


def in_order(proofs):
    """Proofs about conditions by their words, because plans sort conditions in another way; then the others."""
    some = [proof for proof in proofs if proof.kind in KINDS and proof.variant != "match"]
    return sorted(some, key=lambda proof: (proof.kind != "anchor", proof.variant if proof.kind == "anchor" else ""))


class Sets:
    """The facts of all sequences as one source; reads of starts come from the graph."""

    def __init__(self, facts, graph):
        self.facts, self.graph = facts, graph

    def ask(self, keys):
        if any(kind in ("start", "onsets") for kind, *_ in keys):
            return self.graph.ask(keys)
        return self.facts[keys[0][1]].ask(keys)


def prove_all(plans, keyframes, source, fill):
    """The proofs of each plan by question."""
    proofs, left = {}, list(plans)
    while left:
        again = []
        for one in left:
            try:
                found = prove(one.program, one.answer, keyframes[one.record.sequence], RULES, source)
                proofs[one.record.question_id] = found
            except MissingFactsError:
                again.append(one)
        left = again
        assert not left or fill()
    return proofs


def check_proofs(store):
    """Both sources give the stored proofs of each question; return the number of proofs by template."""
    records = list(read_records(store, Validation()))
    plans, unreadable = read_plans(records)
    assert plans and not unreadable
    compared = Counter()
    with Graph.open(store.graph_path, read_only=True) as graph:
        facts = {
            name: Facts(graph, name, RULES.load, with_faces="pose" in entry.layers)
            for name, entry in store.manifest().sequences.items()
        }
        keyframes = {name: one.keyframes for name, one in facts.items()}
        cypher = CypherFacts(graph, RULES.load)
        for source in (cypher, Sets(facts, cypher)):
            proofs = prove_all(plans, keyframes, source, cypher.fill)
            for record in records:
                assert in_order(proofs[record.question_id]) == in_order(record.proofs), (record.template, record.plan)
                compared[record.template] += len(proofs[record.question_id])
    return compared


def test_both_sources_give_the_stored_proofs_of_each_template(sample_benchmark):
    compared = check_proofs(Store(sample_benchmark.path))
    assert compared.keys() == FORMS.keys()
