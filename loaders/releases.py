"""Comparison of a loaded copy of JRDB with the public releases: names of sequences, frames, occlusion and headings."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from importlib.resources import files
from typing import Any, Final

from jrdb_avr.loaders.report import MAX_TURN_DEG, SequenceReport

_LINES: Final = files(__package__).joinpath("sequences.csv").read_text("utf-8").splitlines()[1:]
_FRAMES: Final = {name: (split, int(count)) for name, split, count in csv.reader(_LINES)}
"""Split and number of frames of each sequence in the release of 2022."""


def compare_releases(reports: Sequence[SequenceReport]) -> list[dict[str, Any]]:
    """Compare each layer of a load with the public releases.

    Args:
        reports: Reports of a load.

    Returns:
        A row per layer: sequences that have it, splits that have it in all 27 sequences, and differences from every
        known release with their numbers of sequences. No row if no sequence is of JRDB.
    """
    loaded = [report for report in reports if report.layers]
    if not any(report.sequence in _FRAMES for report in loaded):
        return []
    rows = []
    for layer in dict.fromkeys(layer for report in loaded for layer in report.layers):
        having = [report for report in loaded if layer in report.layers]
        names = {report.sequence for report in having}
        complete = [
            part for part in ("train", "test") if names >= {name for name, (of, _) in _FRAMES.items() if of == part}
        ]
        odd = Counter(line for report in having for line in _differences(report, layer))
        unlike = "; ".join(f"{line} ({count})" for line, count in odd.items())
        rows.append({"layer": layer, "sequences": len(names), "complete": ", ".join(complete), "unlike": unlike})
    return rows


def _differences(report: SequenceReport, layer: str) -> list[str]:
    """Return what no known release has."""
    if report.sequence not in _FRAMES:
        return ["another sequence"]
    lines, (_, count) = list[str](), _FRAMES[report.sequence]
    shown = report.image_frames if layer == "images" else report.label_frames
    # The release of 2019 numbers the frames of train from 2.
    if layer in ("2d", "images") and shown and shown.last > count + 1:
        lines.append("more frames")
    if layer == "2d" and report.visibility != "attributes":
        lines.append("no occlusion attributes")
    turn = report.heading.median_deg if report.heading else None
    if layer == "3d" and turn is not None and turn > MAX_TURN_DEG:
        lines.append("reversed headings")
    return lines
