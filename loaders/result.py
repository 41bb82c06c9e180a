"""Result of a load, which the user sees as lines and tables."""

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

_FOLDERS = {
    **{"2d": "labels_2d_stitched", "3d": "labels_3d", "demographics": "labels_2d_activity_social_stitched"},
    "images": "images/image_stitched/SEQUENCE/000000.jpg",
}
"""Files of the layers on which most questions depend, for the text about a missing layer."""


@dataclass(frozen=True, repr=False)
class LoadResult(Displayed):
    """Reports of a load: one per sequence, sorted by name. Reports without a sequence describe the whole root."""

    reports: list[SequenceReport]

    @property
    def refused(self) -> int:
        """Number of refused or skipped files, frames, records and fields."""
        return sum(report.refused for report in self.reports)

    def rows(self) -> list[_Row]:
        """Return one JSON object per report, with the fields of `SequenceReport`."""
        rows: list[_Row] = msgspec.to_builtins(self.reports)
        return rows

    def parts(self) -> Iterator[str | tuple[str, list[_Row]]]:
        """Yield the parts of the report in the order of display.

        A part is a line of text, or a pair: the title and the rows of a table.
        """
        loaded = [report for report in self.reports if report.sequence]
        yield "Loaded", [_summary(report) for report in loaded]
        for layers, names in _shared((_layers(report), report.sequence) for report in loaded):
            yield f"Layers of {_sequences(names)}: {layers}"
        checks = [_checks(report) for report in loaded if report.layers]
        filled = [name for name in (checks[0] if checks else ()) if any(row[name] for row in checks)]
        yield "Checks", [{name: row[name] for name in filled} for row in checks]
        yield from dict.fromkeys(
            f"Cameras: median fy {cameras.fy:.1f}, median cy {cameras.cy:.1f} "
            f"(constants for rows of the panorama: {cameras.focal_rows} and {cameras.horizon_row})"
            for cameras in (report.cameras for report in loaded)
            if cameras is not None
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
    """Return each distinct text with the sequences that have the text. `lines` holds pairs (text, sequence)."""
    sequences: dict[str, list[str]] = {}
    for text, sequence in lines:
        sequences.setdefault(text, []).append(sequence)
    return list(sequences.items())


def _sequences(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} sequences"


def _summary(report: SequenceReport) -> _Row:
    columns = ("sequence", "frames", "people", "boxes", "boxes_3d", "visibility", "refused")
    return {"3D" if name == "boxes_3d" else name: getattr(report, name) for name in columns}


def _layers(report: SequenceReport) -> str:
    """Return a text that lists a sequence's layers by the distance between their frames, and the missing layers."""
    steps: dict[str, list[str]] = {}
    for layer in report.layers:
        step = report.steps.get(layer)
        how = "" if step is None else " at every frame" if step == 1 else f" at every {step}th frame"
        steps.setdefault(how, []).append(layer)
    text = "; ".join(f"{', '.join(layers)}{how}" for how, layers in steps.items()) or "none"
    missing = ", ".join(f"{layer} ({files})" for layer, files in _FOLDERS.items() if layer not in report.layers)
    return f"{text}; without {missing}" if missing else text


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
    """Return one row per kind of problem, with the count in all sequences and the first example."""
    kinds: dict[tuple[str, ...], list[tuple[str, Problem]]] = {}
    for report in reports:
        for problem in report.problems:
            key = (problem.layer, problem.kind, problem.reason, problem.field)
            kinds.setdefault(key, []).append((report.sequence, problem))
    return [
        {
            "count": sum(problem.count for _, problem in problems),
            "sequences": len({sequence for sequence, _ in problems}),
            "what": f"{layer} {kind}".strip(),
            "reason": reason,
            "first": _place(*problems[0]),
        }
        for (layer, kind, reason, _), problems in kinds.items()
    ]


def _place(sequence: str, problem: Problem) -> str:
    """Return one text with the file, frame, field and value of a problem. The text always names the sequence."""
    file = problem.file if sequence in problem.file else f"{sequence}/{problem.file}"
    return " ".join(part for part in (file, problem.frame, problem.field, problem.detail) if part)
