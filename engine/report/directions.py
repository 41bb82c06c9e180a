"""Directions of the ablation: whether scores rise and fall between its cells in the same way as in the paper.

The ablation has four cells, one for each combination of active observation (on or off) and world model (on or off).
Two neighbouring cells differ in exactly one of these two factors. A direction says whether one score rises or falls
between two neighbouring cells.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.engine.report.paper import ABLATION
from jrdb_avr.engine.report.tables import CELLS

_Row = Mapping[str, Any]
_Cell = tuple[str, str]
"""A cell of the ablation: active observation ("on" or "off"), and world model ("on" or "off")."""

_CHANGES: Final[Mapping[str, tuple[_Cell, _Cell]]] = {
    "world model, passive": (("off", "off"), ("off", "on")),
    "world model, active": (("on", "off"), ("on", "on")),
    "active, no world model": (("off", "off"), ("on", "off")),
    "active, world model": (("off", "on"), ("on", "on")),
}
_METHODS: Final = {(cell["active"], cell["world_model"]): method for method, cell in CELLS.items()}
_SCORES: Final = ("answer", "evidence", "combined", "hallucination")


def direction_lines(rows: Sequence[_Row]) -> list[str]:
    """Say how many directions of an ablation table agree with the paper, and list the other directions.

    Args:
        rows: Rows of the table `ablation`.

    Returns:
        One line for each combination of model and setting that has all four cells.
    """
    lines = []
    for model, setting in sorted({(row["model"], row["setting"]) for row in rows}):
        cells = {
            (row["active"], row["world_model"]): row
            for row in rows
            if (row["model"], row["setting"]) == (model, setting)
        }
        if len(cells) == len(_METHODS):
            lines.append(_line(cells, ", ".join(filter(None, (model, setting)))))
    return lines


def _line(cells: Mapping[_Cell, _Row], about: str) -> str:
    unlike = {change: [name for name in _SCORES if not _alike(cells, *ends, name)] for change, ends in _CHANGES.items()}
    count = len(_CHANGES) * len(_SCORES)
    label = " (synthetic)" if any("synthetic" in row["label"] for row in cells.values()) else ""
    others = "; ".join(f"{change}: {', '.join(names)}" for change, names in unlike.items() if names)
    agreeing = count - sum(map(len, unlike.values()))
    return f"{about}{label}: {agreeing} of {count} directions are the paper's{others and f'; others: {others}'}"


def _alike(cells: Mapping[_Cell, _Row], before: _Cell, after: _Cell, name: str) -> bool:
    """Return whether a score and its figure in the paper both rise, or both fall, from one cell to another cell.

    If the score is equal in both cells or is missing in one of them, return False.
    """
    first, second = cells[before][name], cells[after][name]
    paper = getattr(ABLATION[_METHODS[after]], name) - getattr(ABLATION[_METHODS[before]], name)
    return first is not None and second is not None and (second - first) * paper > 0
