"""Refused and skipped parts of files, counted by reason with the first example of each.

No content of a file may vanish silently: every file, frame, record or field that cannot be used is counted here, and
the load report prints the sums. A *refused* part gives no fact. A refused field leaves the rest of its record.
"""

from __future__ import annotations

import msgspec


class Problem(msgspec.Struct):
    """One reason with its count and its first example."""

    kind: str
    """Unit that was lost each time: sequence, file, frame, record or field."""
    reason: str
    count: int
    file: str
    frame: str
    field: str
    detail: str
    """Offending value of the first example, shortened."""
    layer: str = ""
    """Layer of the file, if it is known."""


class Problems:
    """Counter of the problems of one file."""

    def __init__(self, file: str, layer: str = "") -> None:
        self.file = shorten(file, 200)
        self.layer = layer
        self._problems: dict[tuple[str, str, str], Problem] = {}

    def add(
        self, kind: str, reason: str, *, frame: str = "", field: str = "", value: object = "", count: int = 1
    ) -> None:
        """Count a problem. Problems of one kind, reason and field are one entry."""
        problem = self._problems.get((kind, reason, field))
        if problem is not None:
            problem.count += count
            return
        example = Problem(kind, reason, count, self.file, frame, field, shorten(value), self.layer)
        self._problems[kind, reason, field] = example

    def without(self, reported: Problems) -> None:
        """Remove the problems that another reader of the same file has counted as often."""
        counted = {(problem.reason, problem.field, problem.count) for problem in reported.listed()}
        for key, problem in list(self._problems.items()):
            if (problem.reason, problem.field, problem.count) in counted:
                del self._problems[key]

    def listed(self) -> list[Problem]:
        """Return all problems, sorted by kind, reason and field."""
        return [self._problems[key] for key in sorted(self._problems)]


def shorten(value: object, length: int = 60) -> str:
    """Return the value as printable text of at most `length` characters."""
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    if not isinstance(value, bytes | str):
        try:
            text = repr(value)
        except (RecursionError, ValueError):  # nested beyond reason, or an int of thousands of digits
            text = type(value).__name__
    text = "".join(c if c.isprintable() else " " for c in text[: length + 1])
    return text if len(text) <= length else text[: length - 1] + "…"
