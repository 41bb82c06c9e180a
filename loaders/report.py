"""The load report: per sequence what was found, what was kept and what was refused."""

from __future__ import annotations

from typing import Any

import msgspec

from .problems import Problem


class UnknownLabel(msgspec.Struct):
    """A label outside the vocabulary, kept in its normal spelling."""

    field: str
    label: str
    count: int


class Heading(msgspec.Struct):
    """Self-check of the heading convention: people faster than 0.5 m/s should face where they go."""

    moves: int
    """Displacements over one second that were looked at."""
    median_deg: float | None
    """Median angle between heading and displacement; near 0 when the convention holds, near 180 when it is reversed."""


class SequenceReport(msgspec.Struct):
    """One row of the report. Layers are those of the `frames` table; all but the images have an annotation step."""

    sequence: str
    layers: list[str]
    steps: dict[str, int]
    """Frames between annotated frames: 1, or 15 for one per second."""
    frames: int
    """Frames that any layer knows."""
    people: int
    boxes: int
    boxes_3d: int
    unknown_labels: list[UnknownLabel]
    problems: list[Problem]
    heading: Heading | None

    @property
    def refused(self) -> int:
        """Files, frames, records and fields refused or skipped."""
        return sum(problem.count for problem in self.problems)


def empty_report(sequence: str, problems: list[Problem]) -> SequenceReport:
    """The row of a sequence of which nothing could be loaded."""
    return SequenceReport(sequence, [], {}, 0, 0, 0, 0, [], problems, None)


def as_row(report: SequenceReport) -> dict[str, Any]:
    """The report as a JSON object."""
    row: dict[str, Any] = msgspec.to_builtins(report)
    return row


def totals(reports: list[SequenceReport]) -> str:
    """One line over all sequences."""
    loaded = [report for report in reports if report.layers]
    sums = {name: sum(getattr(report, name) for report in loaded) for name in ("frames", "people", "boxes", "boxes_3d")}
    unknown = len({(label.field, label.label) for report in loaded for label in report.unknown_labels})
    return (
        f"{len(loaded)} sequences, {sums['frames']:,} frames, {sums['people']:,} people, {sums['boxes']:,} boxes, "
        f"{sums['boxes_3d']:,} 3D boxes; {unknown} labels outside the vocabulary; "
        f"{sum(report.refused for report in reports):,} refused or skipped"
    )
