"""Near-duplicates and caps, which decide whether two questions may both be chosen."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import sub

from jrdb_avr.engine.generate.asked import Candidate
from jrdb_avr.schema.rules import Rules, frames

Person = tuple[str, int]
"""Sequence and track."""


def near_frames(template: str, rules: Rules) -> int:
    """Return the maximum number of frames between the times of two near-duplicates."""
    return frames(rules.near_presence_s if template == "presence" else rules.near_duplicate_s)


@dataclass
class Taken:
    """Account of the chosen questions of all templates. It never depends on their order."""

    rules: Rules
    reads: dict[tuple[Person, str], list[tuple[int, ...]]] = field(default_factory=lambda: defaultdict(list))
    events: set[tuple[Person, str | None]] = field(default_factory=set)
    questions: Counter[Person] = field(default_factory=Counter)

    def admits(self, candidate: Candidate) -> bool:
        """Return whether no near-duplicate and no cap forbids a question."""
        person, rules = candidate.person, self.rules
        others = self.reads[person, candidate.template]
        if len(others) >= rules.max_per_person or self.questions[person] >= rules.max_per_person_in_all:
            return False
        if candidate.event is not None and (person, candidate.event) in self.events:
            return False
        near = near_frames(candidate.template, rules)
        return not any(are_near(candidate.asked, asked, near) for asked in others)

    def add(self, candidate: Candidate) -> None:
        """Add a chosen question to the account."""
        self.reads[candidate.person, candidate.template].append(candidate.asked)
        self.questions[candidate.person] += 1
        self.events.add((candidate.person, candidate.event))

    def remove(self, candidate: Candidate) -> None:
        """Remove a chosen question from the account."""
        self.reads[candidate.person, candidate.template].remove(candidate.asked)
        self.questions[candidate.person] -= 1
        self.events.discard((candidate.person, candidate.event))


def are_near(first: Sequence[int], second: Sequence[int], near: int) -> bool:
    """Return whether two questions read equally many frames, and these are near each other, one by one."""
    return len(first) == len(second) and max(map(abs, map(sub, first, second))) <= near
