"""Figures that the paper (JRDB-AVR) reports, as reference rows with the label "paper".

They are about the paper's own 2,098 questions over JRDB, not about the questions of a store. The paper's breakdown has
five groups: chain contains this project's 2-hop, 3-hop and fork-join families, hybrid its chain hybrid.
"""

from __future__ import annotations

import csv
from importlib.resources import files
from typing import Final, NamedTuple


class Group(NamedTuple):
    """A group of the paper: families, number of questions, and numbers of right answers, evidence, and both."""

    families: tuple[str, ...]
    n: int
    answer: int
    evidence: int
    combined: int


GROUPS: Final[dict[str, Group]] = {
    "action boundary": Group(("action_boundary",), 67, 25, 38, 16),
    "chain": Group(("chain_2hop", "chain_3hop", "chain_fork_join"), 330, 138, 28, 18),
    "hybrid": Group(("chain_hybrid",), 51, 6, 3, 0),
    "long range": Group(("long_range",), 30, 15, 1, 0),
    "unique anchor": Group(("unique_anchor",), 1620, 624, 507, 271),
}
"""The paper's groups, with the counts of its agent on Qwen3.5 9B."""


class Published(NamedTuple):
    """A row of the paper's main table or ablation, in percent."""

    method: str
    model: str
    answer: float
    evidence: float
    combined: float
    hallucination: float


_LINES: Final = files(__package__).joinpath("paper.csv").read_text("utf-8").splitlines()[1:]

_ROWS: Final = [Published(method, model, *map(float, figures)) for method, model, *figures in csv.reader(_LINES)]

MAIN: Final = [row for row in _ROWS if row.method == "agent" or not row.method.startswith("agent")]
"""The paper's main table."""

ABLATION: Final = {row.method: row for row in _ROWS if row.method.startswith("agent")}
"""The paper's ablation by method of this project: active observation (off: passive) by world model (off: no world)."""
