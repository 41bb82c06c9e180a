"""Counters of the parts of files that are refused or skipped, with the first example for each reason.

No content of a file may vanish silently. Each file, frame, record or field that cannot be used is counted here, and
the load report shows the counts. A *refused* part gives no fact. If a field is refused, the rest of its record is used.
"""

from __future__ import annotations

import msgspec


class Problem(msgspec.Struct):
    """Reason why parts of the input were refused or skipped, with their number and the first part as an example."""

    kind: str
    """What each counted part is: "file", "frame", "record" or "field"."""
    reason: str
    count: int
    file: str
    frame: str
    """Frame key or record of the example, or "" if there is none."""
    field: str
    """Field of all counted parts, or "" if there is none."""
    detail: str
    """Offending value of the example, shortened."""
    layer: str = ""
    """Layer of the file, or "" if it is not known."""


class Problems:
    """Counter of the problems of one file."""

    def __init__(self, file: str, layer: str = "") -> None:
        self.file = shorten(file, 200)
        self.layer = layer
        self._problems: dict[tuple[str, str, str], Problem] = {}

    def add(
        self, kind: str, reason: str, *, frame: str = "", field: str = "", value: object = "", count: int = 1
    ) -> None:
        """Count refused or skipped parts. Parts of the same kind, reason and field are counted together.

        Args:
            kind: "file", "frame", "record" or "field".
            reason: reason of the refusal.
            frame: frame key or name of the first part. If the parts of several calls are counted together, the `frame`
                and the `value` of the first call are kept as the example.
            field: name of the offending field.
            value: offending value of the first part.
            count: number of parts.
        """
        problem = self._problems.get((kind, reason, field))
        if problem is not None:
            problem.count += count
            return
        example = Problem(kind, reason, count, self.file, frame, field, shorten(value), self.layer)
        self._problems[kind, reason, field] = example

    def without(self, reported: Problems) -> None:
        """Remove each problem that is also in `reported` with an equal reason, field and count.

        `reported` is the counter of another reader of the same file.
        """
        counted = {(problem.reason, problem.field, problem.count) for problem in reported.listed()}
        for key, problem in list(self._problems.items()):
            if (problem.reason, problem.field, problem.count) in counted:
                del self._problems[key]

    def listed(self) -> list[Problem]:
        """Return all problems, sorted by kind, reason and field."""
        return [self._problems[key] for key in sorted(self._problems)]


def shorten(value: object, length: int = 60) -> str:
    """Return a value as text of at most `length` characters, with blanks for unprintable characters."""
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""
    if not isinstance(value, bytes | str):
        try:
            text = repr(value)
        except (RecursionError, ValueError):  # The value is nested too deeply, or is an int of thousands of digits.
            text = type(value).__name__
    text = "".join(c if c.isprintable() else " " for c in text[: length + 1])
    return text if len(text) <= length else text[: length - 1] + "…"
