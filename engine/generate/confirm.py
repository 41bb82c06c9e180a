"""Check chosen candidates by the second program, which derives each plan again from the annotation tables.

It takes longer than the search itself, so it is run for chosen candidates alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import pyarrow as pa

from jrdb_avr.engine.generate.scene import box_count
from jrdb_avr.engine.rederive import Annotations, rederive
from jrdb_avr.queries.store import Store
from jrdb_avr.queries.workers import without_collector
from jrdb_avr.schema.plan import parse_plan
from jrdb_avr.schema.questions import NeededBox
from jrdb_avr.schema.rules import Rules

CONFIRMED: Final = ("key", "template", "target_track", "plan", "answer_text", "needed")
"""Columns of the pool that are confirmed, and the key."""


@dataclass(frozen=True)
class ConfirmJob:
    """Chosen candidates of a sequence: rows of the pool with the columns CONFIRMED."""

    store: Path
    sequence: str
    rules: Rules
    chosen: pa.Table

    @property
    def weight(self) -> int:
        """By how much work the sequence is started earlier than others."""
        return box_count(Store(self.store), self.sequence)


class Fault(NamedTuple):
    """A candidate that is not confirmed, by its sequence and plan, and what the second program finds else."""

    candidate: str
    difference: str

    def __str__(self) -> str:
        return ": ".join(self)


@without_collector()
def find_faults(job: ConfirmJob) -> dict[str, Fault]:
    """The candidates that the second program does not confirm, by key."""
    annotations = Annotations.read(Store(job.store), job.sequence, job.rules)
    found = {}
    for line in job.chosen.to_pylist():
        if difference := _difference(annotations, line, job.rules):
            found[line["key"]] = Fault(f"{job.sequence} {line['plan']}", difference)
    return found


def _difference(annotations: Annotations, line: Mapping[str, Any], rules: Rules) -> str | None:
    second = rederive(annotations, parse_plan(line["plan"]), line["template"], rules)
    if second.outcome != "defined" or second.answer != line["answer_text"]:
        return f"answer {line['answer_text']}, rederived {second.answer or second.outcome}"
    if second.target != line["target_track"]:
        return f"target {line['target_track']}, rederived {second.target}"
    if second.faults:
        return second.faults[0]
    needed = msgspec.json.decode(line["needed"], type=tuple[NeededBox, ...])
    return None if _places(needed) == _places(second.needed) else "other boxes are needed"


def _places(boxes: Sequence[NeededBox]) -> set[tuple[str, int, int, bool]]:
    return {(box.node, box.track, box.frame, box.decisive) for box in boxes}
