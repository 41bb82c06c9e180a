"""The statements that prove a question, ready to paste, with the rows that they return."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jrdb_avr.engine.generate.cypher_facts import CypherFacts, statement_of
from jrdb_avr.engine.generate.facts import Key
from jrdb_avr.engine.generate.perturb import Answer, MissingFactsError, Program, prove
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.questions import Proof
from jrdb_avr.schema.rules import Rules


class Statement(NamedTuple):
    """A statement that returns facts of one kind.

    Attributes:
        name: Name of its file.
        text: Statement with the values of its parameters.
        rows: Rows that the graph returns.
    """

    name: str
    text: str
    rows: list[dict[str, Any]]


def explain(
    graph: Graph, program: Program, answer: Answer, keyframes: Sequence[int], rules: Rules
) -> tuple[list[Proof], list[Statement]]:
    """Prove a question by statements, and return these.

    Args:
        graph: Graph with the scene of the question.
        program: Program of the question.
        answer: Answer of the question.
        keyframes: Keyframes of the sequence, in order.
        rules: Thresholds.

    Returns:
        The proofs about conditions, hops and times, and the statements in the order of their names.

    Raises:
        NoAnswerError: If the program finds no single person.
    """
    source = CypherFacts(graph, rules.load)
    while True:
        try:
            proofs = prove(program, answer, keyframes, rules, source)
            break
        except MissingFactsError:
            source.fill()
    by_statement: dict[str, list[Key]] = defaultdict(list)
    for key in source.known_keys():
        by_statement[statement_of(key)].append(key)
    statements = []
    for name, keys in sorted(by_statement.items()):
        text, values = source.statement(name, keys)
        pasted = paste(text, values)
        statements.append(Statement(name, pasted, graph.query(pasted, {}).to_pylist()))
    return proofs, statements


def paste(text: str, values: Mapping[str, Any]) -> str:
    """Write the values of parameters into a statement.

    Args:
        text: Statement.
        values: Values by the name of the parameter.

    Returns:
        The statement without parameters.
    """
    return re.sub(r"\$(\w+)", lambda name: literal(values[name[1]]), text)


def literal(value: Any) -> str:
    """Return a value as a literal of Cypher.

    >>> literal([{"id": 0, "at": "o'hara/000015", "posture": True}])
    "[{id: 0, at: 'o\\\\'hara/000015', posture: true}]"
    """
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name}: {literal(part)}" for name, part in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(literal, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return "'" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"
    return "NULL" if value is None else repr(value)
