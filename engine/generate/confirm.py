"""Confirmation of chosen candidates by two other programs, before they are published.

The second program (`engine.rederive`) derives each plan again from the annotation tables. The statements in
`queries/necessity` run each perturbation of the plan over the stored graph, and must give the proofs that the sets of
facts gave. Both take longer than the search, so they check chosen candidates only.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import msgspec
import pyarrow as pa

from jrdb_avr.engine.generate.cypher_facts import CypherFacts
from jrdb_avr.engine.generate.perturb import (
    Answer,
    MissingFactsError,
    NoAnswerError,
    Program,
    make_program,
    parse_answer,
    prove,
)
from jrdb_avr.engine.generate.stored_layer import LayerJob
from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.queries.graph.handle import open_worker_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import without_collector
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import NeededBox, Proof
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

CONFIRMED: Final = ("key", "template", "form", "target_track", "plan", "answer_mode", "answer_text", "needed", "proofs")
"""Columns of the pool that a confirmation needs."""

_PERTURBED: Final = ("anchor", "hop.stop", "hop.skip", "time.shift", "time.drop")
"""Kinds of proofs that perturbed programs give, but for the description's own match."""

_PROOFS: Final = msgspec.json.Decoder(tuple[Proof, ...])
_NEEDED: Final = msgspec.json.Decoder(tuple[NeededBox, ...])


@dataclass(frozen=True)
class ConfirmJob(LayerJob):
    """Chosen candidates of a sequence.

    Attributes:
        chosen: Rows of the pool with the columns `CONFIRMED`.
    """

    chosen: pa.Table


class Fault(NamedTuple):
    """A candidate that is not confirmed.

    Attributes:
        candidate: Sequence and plan of the candidate.
        difference: Result of the other program.
    """

    candidate: str
    difference: str

    def __str__(self) -> str:
        """Return the fault as one line."""
        return ": ".join(self)


@without_collector()
def find_faults(job: ConfirmJob) -> dict[str, Fault]:
    """Find the candidates of a sequence that are not confirmed.

    Args:
        job: Chosen candidates of the sequence.

    Returns:
        The faults by the candidate's key.

    Raises:
        StoreError: If a table or the graph is missing.
    """
    store, lines = Store(job.store), job.chosen.to_pylist()
    annotations = Annotations.read(store, job.sequence, job.rules)
    with open_worker_graph(store.graph_path) as graph:
        (keyframes,) = store.interval("sequence", job.sequence)["keyframes"].to_pylist()
        programs = {line["key"]: _program(job.sequence, line) for line in lines}
        proofs = prove_all(programs, sorted(keyframes), job.rules, CypherFacts(graph, job.rules.load))
    faults = {}
    for line in lines:
        difference = _rederived(annotations, line, job.rules) or _proven(line, proofs[line["key"]])
        if difference:
            faults[line["key"]] = Fault(f"{job.sequence} {line['plan']}", difference)
    return faults


def _program(sequence: str, line: Mapping[str, Any]) -> tuple[Program, Answer]:
    program = make_program(sequence, parse_plan(line["plan"]), TEMPLATES[line["form"]])
    return program, parse_answer(line["answer_mode"], line["answer_text"])


def prove_all(
    programs: Mapping[str, tuple[Program, Answer]], keyframes: Sequence[int], rules: Rules, source: CypherFacts
) -> dict[str, list[Proof]]:
    """Prove programs of one sequence together, so that one statement returns the facts of all of them.

    Args:
        programs: Programs with the answers of their questions, by key.
        keyframes: Keyframes of the sequence, in order.
        rules: Thresholds.
        source: Source of the facts.

    Returns:
        The proofs of each program by key, or no proofs if the program finds no single person.
    """
    proofs: dict[str, list[Proof]] = {}
    while waiting := programs.keys() - proofs.keys():
        for key in sorted(waiting):
            program, answer = programs[key]
            try:
                proofs[key] = prove(program, answer, keyframes, rules, source)
            except NoAnswerError:
                proofs[key] = []
            except MissingFactsError:
                continue
        source.fill()
    return proofs


def _rederived(annotations: Annotations, line: Mapping[str, Any], rules: Rules) -> str | None:
    """Return how the result of the second program differs."""
    second = rederive(annotations, parse_plan(line["plan"]), line["template"], rules)
    if second.outcome != "defined" or second.answer != line["answer_text"]:
        return f"answer {line['answer_text']}, rederived {second.answer or second.outcome}"
    if second.target != line["target_track"]:
        return f"target {line['target_track']}, rederived {second.target}"
    if second.faults:
        return second.faults[0]
    return None if _places(_NEEDED.decode(line["needed"])) == _places(second.needed) else "other boxes are needed"


def _places(boxes: Sequence[NeededBox]) -> set[tuple[str, int, int, bool]]:
    return {(box.node, box.track, box.frame, box.decisive) for box in boxes}


def _proven(line: Mapping[str, Any], proofs: Iterable[Proof]) -> str | None:
    """Return how the proofs by statements differ from those by sets."""
    stored = {one for one in _PROOFS.decode(line["proofs"]) if one.kind in _PERTURBED and one.variant != "match"}
    differing = sorted(stored.symmetric_difference(proofs), key=repr)
    if not differing:
        return None
    kind, variant = differing[0].kind, differing[0].variant
    by_sets, by_statements = (
        next((one.outcome for one in some if (one.kind, one.variant) == (kind, variant)), "nothing")
        for some in (stored, proofs)
    )
    return f"proof {kind} {variant}: {by_sets} by sets, {by_statements} by statements"
