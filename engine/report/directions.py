"""Whether observing and the world model change scores in the directions of the paper's ablation.

The four cells are active observation by world model. A direction is that of one score from one cell to its neighbour:
with the world model beside without, passive or active, and active beside passive, without or with a world model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.engine.report.paper import ABLATION

_Row = Mapping[str, Any]
_Cell = tuple[str, str]
"""Active observation and world model, each on or off."""

_CHANGES: Final[Mapping[str, tuple[_Cell, _Cell]]] = {
    "world model, passive": (("off", "off"), ("off", "on")),
    "world model, active": (("on", "off"), ("on", "on")),
    "active, no world model": (("off", "off"), ("on", "off")),
    "active, world model": (("off", "on"), ("on", "on")),
}
_METHODS: Final[Mapping[_Cell, str]] = {
    ("off", "off"): "agent-passive-no-world",
    ("off", "on"): "agent-passive",
    ("on", "off"): "agent-no-world",
    ("on", "on"): "agent",
}
_SCORES: Final = ("answer", "evidence", "combined", "hallucination")


def direction_lines(rows: Sequence[_Row]) -> list[str]:
    """A line for each model, setting and policy of an ablation table that has all four cells.

    The passive cells have no looks to choose: they belong to every policy.
    """
    own = [row for row in rows if row["label"] != "paper"]
    lines = []
    for model, setting, policy in sorted({(row["model"], row["setting"], row["policy"]) for row in own}):
        cells = {
            (row["active"], row["world_model"]): row
            for row in own
            if (row["model"], row["setting"]) == (model, setting)
            and (row["policy"] == policy or row["active"] == "off")
        }
        if len(cells) == len(_METHODS):
            lines.append(_line(cells, ", ".join(filter(None, (model, setting, f"policy {policy}")))))
    return lines


def _line(cells: Mapping[_Cell, _Row], about: str) -> str:
    others = []
    for change, (before, after) in _CHANGES.items():
        unlike = [name for name in _SCORES if not _alike(cells, before, after, name)]
        others += [f"{change}: {', '.join(unlike)}"] if unlike else []
    count = len(_CHANGES) * len(_SCORES)
    agreeing = sum(_alike(cells, *ends, name) for ends in _CHANGES.values() for name in _SCORES)
    label = " (synthetic)" if any(row["label"] for row in cells.values()) else ""
    rest = f"; others: {'; '.join(others)}" if others else ""
    return f"{about}{label}: {agreeing} of {count} directions are the paper's{rest}"


def _alike(cells: Mapping[_Cell, _Row], before: _Cell, after: _Cell, name: str) -> bool:
    """Whether a score changes as in the paper; one that stays equal, or is undefined, does not."""
    first, second = cells[before][name], cells[after][name]
    paper = getattr(ABLATION[_METHODS[after]], name) - getattr(ABLATION[_METHODS[before]], name)
    return first is not None and second is not None and (second - first) * paper > 0
