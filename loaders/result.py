"""The result of a load, as tables and lines for a person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import msgspec

from jrdb_avr.loaders.problems import Problem
from jrdb_avr.loaders.report import FrameRange, SequenceReport, totals
from jrdb_avr.queries.display import Displayed, Tables

_Row = dict[str, Any]


@dataclass(frozen=True, repr=False)
class LoadResult(Displayed):
    """What a load found and refused: a report per sequence, by name; one without a sequence is about the whole root."""

    reports: list[SequenceReport]

    @property
    def refused(self) -> int:
        """Files, frames, records and fields refused or skipped."""
        return sum(report.refused for report in self.reports)

    def rows(self) -> list[_Row]:
        """Each report as a JSON object."""
        rows: list[_Row] = msgspec.to_builtins(self.reports)
        return rows

    def parts(self) -> Iterator[str | tuple[str, list[_Row]]]:
        """Lines, and tables with their titles: sequences, checks, what was refused, unknown labels and warnings."""
        loaded = [report for report in self.reports if report.sequence]
        yield "Loaded", [_summary(report) for report in loaded]
        for layers, names in _shared((_layers(report), report.sequence) for report in loaded):
            yield f"Layers of {_sequences(names)}: {layers}"
        checks = [_checks(report) for report in loaded if report.layers]
        filled = [name for name in (checks[0] if checks else ()) if any(row[name] for row in checks)]
        yield "Checks", [{name: row[name] for name in filled} for row in checks]
        yield from dict.fromkeys(
            f"Cameras: median fy {own.fy:.1f} (rows of the panorama are computed with {own.focal_rows}), "
            f"median cy {own.cy:.1f} ({own.horizon_row})"
            for own in (report.cameras for report in loaded)
            if own is not None
        )
        if problems := _problems(self.reports):
            yield "Refused or skipped, with the first example of each", problems
        unknown: Counter[tuple[str, str]] = Counter()
        for report in self.reports:
            for label in report.unknown_labels:
                unknown[label.field, label.label] += label.count
        if unknown:
            rows = [{"field": field, "label": label, "count": n} for (field, label), n in sorted(unknown.items())]
            yield "Labels outside the vocabulary, kept but never asked about", rows
        for warning, names in _shared((line, report.sequence) for report in self.reports for line in report.warnings):
            where = _sequences(names)
            yield f"Note: {where}: {warning}" if where else f"Note: {warning}"

    def _summary(self) -> str:
        return totals(self.reports)

    def _tables(self) -> Tables:
        return dict(part for part in self.parts() if not isinstance(part, str))


def _shared(lines: Iterable[tuple[str, str]]) -> list[tuple[str, list[str]]]:
    """Each text once, with its sequences."""
    found: dict[str, list[str]] = {}
    for text, sequence in lines:
        found.setdefault(text, []).append(sequence)
    return list(found.items())


def _sequences(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} sequences"


def _summary(report: SequenceReport) -> _Row:
    columns = ("sequence", "frames", "people", "boxes", "boxes_3d", "refused")
    return {"3D" if name == "boxes_3d" else name: getattr(report, name) for name in columns}


def _layers(report: SequenceReport) -> str:
    """The layers by the step at which they are annotated."""
    steps: dict[str, list[str]] = {}
    for layer in report.layers:
        step = report.steps.get(layer)
        how = "" if step is None else " at every frame" if step == 1 else f" at every {step}th frame"
        steps.setdefault(how, []).append(layer)
    return "; ".join(f"{', '.join(layers)}{how}" for how, layers in steps.items()) or "none"


def _checks(report: SequenceReport) -> _Row:
    heading, fps = report.heading, None if report.stamps is None else report.stamps.fps
    turn = None if heading is None else heading.median_deg
    same = {"agrees": "yes", "shifted": "NO", "not tested": "cannot tell"}
    return {
        "sequence": report.sequence,
        "label frames": _range(report.label_frames),
        "image frames": _range(report.image_frames),
        "same frames as 2D": ", ".join(f"{check.layer}: {same[check.result]}" for check in report.shifts),
        "heading": "" if heading is None or turn is None else f"{turn:.0f}° of {heading.moves}",
        "fps": "" if fps is None else f"{fps:.2f}",
        "contradictions": len(report.disagreements),
        "absent partners": report.absent_partners,
    }


def _range(frames: FrameRange | None) -> str:
    return "" if frames is None else f"{frames.first}-{frames.last}"


def _problems(reports: list[SequenceReport]) -> list[_Row]:
    """The problems of one kind in all sequences together: how many, and where the first is."""
    found: dict[tuple[str, ...], list[tuple[str, Problem]]] = {}
    for report in reports:
        for problem in report.problems:
            key = (problem.layer, problem.kind, problem.reason, problem.field)
            found.setdefault(key, []).append((report.sequence, problem))
    return [
        {
            "count": sum(problem.count for _, problem in problems),
            "sequences": len({sequence for sequence, _ in problems}),
            "what": f"{layer} {kind}".strip(),
            "reason": reason,
            "first": _place(*problems[0]),
        }
        for (layer, kind, reason, _), problems in found.items()
    ]


def _place(sequence: str, problem: Problem) -> str:
    """File, frame, field and value of a problem; the sequence where its file does not name it."""
    file = problem.file if sequence in problem.file else f"{sequence}/{problem.file}"
    return " ".join(part for part in (file, problem.frame, problem.field, problem.detail) if part)
