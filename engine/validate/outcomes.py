"""What `validate` checks of a benchmark, and the counts and faults that it finds."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import Any, Final

from jrdb_avr.queries.display import Displayed, Tables

CHECKS: Final = {
    "files": "schema, canary, nothing private in public files",
    "ids": "each question once, its id is the hash of its public columns, and each file knows the same ones",
    "choices": "four different choices, exactly one of them true; none for other answers",
    "answers": "the stored answer reads back and lies within the sequence",
    "plans": "the plan is valid and of the question's template",
    "text": "the text says the plan and nothing else; stated seconds are frame / fps",
    "evidence": "every box of the target, and nothing else",
    "proofs": "every required proof is there and holds; distractors and bindings fit",
    "rules": "made under the rules given",
    "selection": "shares of answers and questions per person keep to the rules",
    "rederive": "the second path finds the same person, answer and needed boxes",
}
"""What is checked, in the order in which it is reported."""

REPLAY_CHECKS: Final = {
    "replay": "every proof, run again from the stored plan, comes out as it is stored",
    "compiled": "the plan, compiled to Cypher, finds the stored people and answer in the graph",
}
"""What is checked besides where the proofs are run again."""


class Validation(Displayed):
    """The result of a validation: counts per check, and its faults in the order found."""

    def __init__(self) -> None:
        self.checked: Counter[str] = Counter()
        self.faults: dict[str, list[str]] = defaultdict(list)

    def check(self, name: str, holds: bool, fault: str) -> bool:
        """Count one check; keep the fault where it does not hold."""
        self.checked[name] += 1
        if not holds:
            self.faults[name].append(fault)
        return holds

    @property
    def sound(self) -> bool:
        """Whether there is no fault."""
        return not self.faults

    def rows(self) -> list[dict[str, Any]]:
        """One row per check, for printing."""
        replayed = REPLAY_CHECKS if REPLAY_CHECKS.keys() & self.checked.keys() else {}
        return [
            {
                "check": name,
                "checked": self.checked[name],
                "faults": len(self.faults.get(name, ())),
                "first fault": self.faults[name][0] if name in self.faults else "",
                "what holds": what,
            }
            for name, what in (CHECKS | replayed).items()
        ]

    def _summary(self) -> str:
        faults = sum(map(len, self.faults.values()))
        return f"sound, {self.checked.total()} checks" if self.sound else f"{faults} faults"

    def _tables(self) -> Tables:
        return {"Checks": self.rows()}
