"""What a loader refused or skipped, counted by reason with the first example of each.

Nothing that a file holds may vanish silently: a file, frame, record or field that cannot be used is added here, and the
load report prints the sums. *Refused* things leave no fact behind; a refused field leaves the rest of its record.
"""

from __future__ import annotations

import msgspec


class Problem(msgspec.Struct):
    """One reason with its count and its first example."""

    kind: str
    """sequence, file, frame, record or field: how much was lost each time."""
    reason: str
    count: int
    file: str
    frame: str
    field: str
    detail: str
    """The offending value of the first example, shortened."""
    layer: str = ""
    """The layer whose file it is, where that is known."""


class Problems:
    """A counter of problems of one file."""

    def __init__(self, file: str, layer: str = "") -> None:
        self.file = shorten(file, 200)
        self.layer = layer
        self._found: dict[tuple[str, str, str], Problem] = {}

    def add(
        self, kind: str, reason: str, *, frame: str = "", field: str = "", value: object = "", count: int = 1
    ) -> None:
        """Count a problem. Problems of one kind, reason and field are one entry."""
        known = self._found.get((kind, reason, field))
        if known is not None:
            known.count += count
            return
        example = Problem(kind, reason, count, self.file, frame, field, shorten(value), self.layer)
        self._found[kind, reason, field] = example

    def without(self, known: Problems) -> None:
        """Leave out what another reader of the same file has counted as often."""
        counted = {(problem.reason, problem.field, problem.count) for problem in known.listed()}
        for key, problem in list(self._found.items()):
            if (problem.reason, problem.field, problem.count) in counted:
                del self._found[key]

    def listed(self) -> list[Problem]:
        """All entries, by kind, reason and field."""
        return [self._found[key] for key in sorted(self._found)]


def shorten(value: object, length: int = 60) -> str:
    """The value as printable text of at most `length` characters."""
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    if not isinstance(value, bytes | str):
        try:
            text = repr(value)
        except (RecursionError, ValueError):  # nested beyond reason, or an int of thousands of digits
            text = type(value).__name__
    text = "".join(c if c.isprintable() else " " for c in text[: length + 1])
    return text if len(text) <= length else text[: length - 1] + "…"
