"""Explanation of a question: its proofs, and the statements over the graph that return their facts."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from jrdb_avr.engine.generate.cypher_facts import CypherFacts, statement_of
from jrdb_avr.engine.generate.facts import Key
from jrdb_avr.engine.generate.perturb import NoAnswerError, Setting, require_all
from jrdb_avr.engine.report.truth import refuse_imported
from jrdb_avr.engine.validate.checks import read_records
from jrdb_avr.engine.validate.replay import StoredPlan, iterate_stored_proofs, read_plans
from jrdb_avr.engine.validate.validation import Validation
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.keyframes import layer_stamp
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, StoreError
from jrdb_avr.schema.questions import Proof, QuestionRecord
from jrdb_avr.schema.rules import Rules, rules_hash, training_rules


class ProofQuery(NamedTuple):
    """A statement that returns facts of one kind.

    Attributes:
        id: Number of the statement in an explanation, from 1.
        name: Name of its file.
        cypher: Text of the statement.
        params: Values of its parameters, by name.
        rows: Rows that the graph returns.
    """

    id: int
    name: str
    cypher: str
    params: dict[str, Any]
    rows: list[dict[str, Any]]


class Explanation(NamedTuple):
    """The proofs of a question, and the statements that return their facts.

    Attributes:
        store: Folder of the store.
        record: Record of the question.
        proofs: Each proof with the ids of its statements.
        statements: Statements in the order of their ids. A fact that several proofs need is in one statement only.
    """

    store: Path
    record: QuestionRecord
    proofs: list[tuple[Proof, list[int]]]
    statements: list[ProofQuery]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row per proof, with its statements."""
        used = [[self.statements[statement_id - 1]._asdict() for statement_id in ids] for _, ids in self.proofs]
        proofs = ({"question_id": self.record.question_id} | msgspec.structs.asdict(proof) for proof, _ in self.proofs)
        return [proof | {"statements": statements} for proof, statements in zip(proofs, used, strict=True)]


def explain(store: Store, question_id: str) -> Explanation:
    """Prove a question by statements over the graph.

    Args:
        store: Store with the question and its graph.
        question_id: Id of the question.

    Returns:
        The proofs, and the statements with their rows.

    Raises:
        InputError: If the store has no such question.
        StoreError: If the graph is missing or damaged, or the graph or its rules do not fit the question.
        LockedError: If another process writes the graph.
    """
    refuse_imported(store, "query them with 'jrdb-avr sql'")
    records = [record for record in read_records(store, Validation()) if record.question_id == question_id]
    if not records:
        raise InputError(f"no question {question_id[:40]!r} in {store.path}: jrdb-avr sql 'FROM questions' lists all")
    plans, _ = read_plans(records)
    with Graph.open(store.graph_path, read_only=True) as graph:
        choices = (Rules(), training_rules(Rules()), layer_stamp(graph)[1])
        rules = next((r for r in choices if r is not None and rules_hash(r) == records[0].rules), None)
        if plans and rules is not None:
            with contextlib.suppress(NoAnswerError):
                return Explanation(store.path, records[0], *_run(graph, plans[0], rules))
    raise StoreError(f"the graph does not fit {question_id}: run 'jrdb-avr validate --replay --store {store.path}'")


def _run(graph: Graph, stored: StoredPlan, rules: Rules) -> tuple[list[tuple[Proof, list[int]]], list[ProofQuery]]:
    """Return the proofs and the statements of an explanation."""
    source = CypherFacts(graph, rules.load)
    keyframes = source.keyframes(stored.record.sequence)
    complete = source.complete(lambda: require_all(iterate_stored_proofs(stored, Setting(source, keyframes, rules))))
    proofs: list[tuple[Proof, list[int]]] = []
    statements: list[ProofQuery] = []
    ids: dict[Key, int] = {}
    source.asked.clear()
    # The second pass asks for the facts of one proof after another. It shares no proof with the first one.
    for proof, _ in zip(complete, iterate_stored_proofs(stored, Setting(source, keyframes, rules)), strict=True):
        new = sorted(source.asked - ids.keys(), key=lambda key: (statement_of(key), repr(key)))
        for name, group in itertools.groupby(new, statement_of):
            keys = list(group)
            ids |= dict.fromkeys(keys, len(statements) + 1)
            query = source.statement(name, keys)
            statements.append(ProofQuery(len(statements) + 1, name, *query, graph.query(*query).to_pylist()))
        proofs.append((proof, sorted({ids[key] for key in source.asked})))
        source.asked.clear()
    return proofs, statements
