"""Result of a validation: the numbers of checks by kind, and the faults."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import Any, Final

from jrdb_avr.queries.display import Displayed, Tables

CHECKS: Final = {
    "files": "columns, metadata and frame rates are right; public files have no private columns",
    "ids": "each question is once in each file; its id is the hash of its public columns",
    "choices": "a choice question has four choices in the order of a hash, and no two may be called the same; "
    "other questions have none",
    "answers": "the stored answer is readable and inside the sequence",
    "plans": "the plan is valid and fits the template of the question",
    "text": "the text states the plan and nothing else",
    "evidence": "the evidence has all boxes of the target and no other box",
    "proofs": "all required proofs hold; bindings fit",
    "rules": "generation used the same rules",
    "selection": "the number of questions per person obeys the rules; no two questions are alike",
    "twins": "questions with one twin_id are a pair that differs in one asked time and in the answer",
    "rederive": "the second program finds the same person, answer, needed boxes, measures and proofs",
}
"""Meanings of the checks of stored questions by name, in the order of the report."""

REPLAY_CHECKS: Final = {
    "replay": "statements over the graph, run for each proof again, give the stored proofs",
    "compiled": "the plan, compiled to Cypher, finds the stored people and answer in the graph",
}
"""Meanings of the additional checks of `--replay` by name."""


class Validation(Displayed):
    """Result of a validation.

    Attributes:
        checked: Number of checks by name.
        faults: Messages by the name of the check, in the order of discovery.
    """

    def __init__(self) -> None:
        """Make a result without checks."""
        self.checked: Counter[str] = Counter()
        self.faults: dict[str, list[str]] = defaultdict(list)

    def check(self, name: str, holds: bool, fault: str) -> bool:
        """Count one check.

        Args:
            name: Name of the check.
            holds: Whether the check succeeds.
            fault: Message that is recorded if the check fails.

        Returns:
            `holds`.
        """
        self.add(name, 1, [] if holds else [fault])
        return holds

    def add(self, name: str, count: int, faults: Iterable[object]) -> None:
        """Count several checks.

        Args:
            name: Name of the checks.
            count: Number of checks.
            faults: Faults of the checks that failed.
        """
        self.checked[name] += count
        for fault in faults:
            self.faults[name].append(str(fault))

    @property
    def sound(self) -> bool:
        """Whether all checks succeeded."""
        return not self.faults

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per kind of check.

        Returns:
            Name, number of checks, number of faults, first fault, and meaning. The rows have the order of CHECKS. The
            rows of REPLAY_CHECKS follow if those checks ran.
        """
        replayed = REPLAY_CHECKS if REPLAY_CHECKS.keys() & self.checked.keys() else {}
        return [
            {
                "check": name,
                "checked": self.checked[name],
                "faults": len(self.faults.get(name, ())),
                "first fault": self.faults[name][0] if name in self.faults else "",
                "what holds": statement,
            }
            for name, statement in (CHECKS | replayed).items()
        ]

    def _summary(self) -> str:
        faults = sum(map(len, self.faults.values()))
        return f"sound, {self.checked.total()} checks" if self.sound else f"{faults} faults"

    def _tables(self) -> Tables:
        return {"Checks": self.rows()}
