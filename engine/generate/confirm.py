"""Confirmation of chosen candidates by two other programs, before they are published.

The second program (`engine.rederive`) derives each plan again from the annotation tables. The statements in
`queries/necessity` run each perturbation of the plan over the stored graph, and must give the proofs that the sets of
facts gave. Both take longer than the search, so they check chosen candidates only.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

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
from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.queries.graph.handle import open_worker_graph
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import without_collector
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import NeededBox, Proof
from jrdb_avr.schema.rules import Rules
from jrdb_avr.schema.templates import TEMPLATES

CONFIRMED: Final = (
    *("key", "sequence", "template", "form", "target_track", "plan", "answer_mode", "answer_text", "needed", "proofs"),
)
"""Columns of the pool that a confirmation needs."""

CONFIRMED_AT_ONCE: Final = 500
"""Minimum number of candidates in each part of `split_chosen` except the last one."""

_PERTURBED: Final = ("anchor", "hop.stop", "hop.skip", "time.shift", "time.drop")
"""Kinds of proofs that come from perturbed programs. The proof `anchor match` is of the kind, but not perturbed."""

_PROOFS: Final = msgspec.json.Decoder(tuple[Proof, ...])
_NEEDED: Final = msgspec.json.Decoder(tuple[NeededBox, ...])


@dataclass(frozen=True)
class ConfirmJob:
    """Chosen candidates of some sequences.

    Attributes:
        store: Folder of the store.
        rules: Rules.
        chosen: Rows of the pool with the columns `CONFIRMED`, by sequence.
    """

    store: Path
    rules: Rules
    chosen: pa.Table


def split_chosen(chosen: pa.Table) -> Iterator[pa.Table]:
    """Yield the chosen candidates in parts of whole sequences. A part has many, so that few statements prove all."""
    first = last = 0
    for count in pc.value_counts(chosen["sequence"]).to_pylist():
        last += count["counts"]
        if last - first >= CONFIRMED_AT_ONCE:
            yield chosen.slice(first, last - first)
            first = last
    if last > first:
        yield chosen.slice(first)


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
    """Find the candidates that are not confirmed.

    Args:
        job: Chosen candidates.

    Returns:
        The faults by the candidate's key.

    Raises:
        StoreError: If a table or the graph is missing.
    """
    store, lines = Store(job.store), job.chosen.to_pylist()
    with open_worker_graph(store.graph_path) as graph:
        programs = {line["key"]: _program(line) for line in lines}
        proofs = prove_all(programs, job.rules, CypherFacts(graph, job.rules.load))
    faults = {}
    for sequence, own in groupby(lines, lambda line: line["sequence"]):
        annotations = Annotations.read(store, sequence, job.rules)
        for line in own:
            difference = _rederived(annotations, line, job.rules) or _proven(line, proofs[line["key"]])
            if difference:
                faults[line["key"]] = Fault(f"{sequence} {line['plan']}", difference)
    return faults


def _program(line: Mapping[str, Any]) -> tuple[Program, Answer]:
    program = make_program(line["sequence"], parse_plan(line["plan"]), TEMPLATES[line["form"]])
    return program, parse_answer(line["answer_mode"], line["answer_text"])


def prove_all(
    programs: Mapping[str, tuple[Program, Answer]], rules: Rules, source: CypherFacts
) -> dict[str, list[Proof]]:
    """Prove programs together, so that one statement returns the facts of all of them.

    Args:
        programs: Programs with the answers of their questions, by key.
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
                proofs[key] = prove(program, answer, source.keyframes(program.sequence), rules, source)
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
