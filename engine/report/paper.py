"""The paper's figures, shown beside a run's as reference rows and marked as the paper's.

They are of its own 2,098 questions over JRDB, not of this store's. Its five groups are those of its breakdown: the
chain family holds this project's 2-hop, 3-hop and fork-join families, hybrid its chain hybrid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "action boundary": ("action_boundary",),
    "chain": ("chain_2hop", "chain_3hop", "chain_fork_join"),
    "hybrid": ("chain_hybrid",),
    "long range": ("long_range",),
    "unique anchor": ("unique_anchor",),
}
"""The paper's groups, as families."""


@dataclass(frozen=True)
class Counts:
    """Questions of a group, and on how many the answer, the evidence, and both score."""

    n: int
    answer: int
    evidence: int
    combined: int


@dataclass(frozen=True)
class Published:
    """A row of the paper's main table or ablation, in percent."""

    method: str
    model: str
    answer: float
    evidence: float
    combined: float
    hallucination: float
    source: str = "paper"


BY_GROUP: Final[dict[str, Counts]] = {
    "action boundary": Counts(67, 25, 38, 16),
    "chain": Counts(330, 138, 28, 18),
    "hybrid": Counts(51, 6, 3, 0),
    "long range": Counts(30, 15, 1, 0),
    "unique anchor": Counts(1620, 624, 507, 271),
}
"""Its agent on Qwen3.5 9B."""

_METHODS: Final = ("monolithic", "chain-of-thought", "search-recognize", "react")

_MAIN: Final[dict[str, tuple[tuple[float, float, float, float], ...]]] = {
    "Gemma-4 E2B": (
        (29.12, 0.05, 0.05, 99.83),
        (25.31, 0.05, 0.05, 99.81),
        (26.69, 4.00, 0.81, 96.96),
        (29.50, 5.67, 1.91, 93.54),
    ),
    "Gemma-4 E4B": (
        (29.50, 0.14, 0.14, 99.52),
        (31.22, 0.29, 0.10, 99.69),
        (29.27, 6.10, 2.29, 92.18),
        (30.60, 9.29, 3.53, 88.47),
    ),
    "Qwen3-VL 4B": (
        (25.41, 2.67, 1.10, 95.68),
        (27.74, 3.19, 1.48, 94.67),
        (21.40, 11.01, 3.53, 83.52),
        (27.74, 13.01, 4.29, 84.54),
    ),
    "Qwen3-VL 8B": (
        (26.93, 1.57, 0.95, 96.46),
        (27.74, 1.72, 0.95, 96.56),
        (21.88, 10.49, 2.62, 88.02),
        (33.65, 11.87, 4.77, 85.84),
    ),
    "Qwen3.5 4B": (
        (27.41, 4.00, 2.00, 92.70),
        (24.59, 3.86, 1.72, 93.02),
        (24.55, 9.34, 3.48, 85.83),
        (31.22, 10.49, 5.24, 83.21),
    ),
    "Qwen3.5 9B": (
        (25.88, 6.29, 3.05, 88.21),
        (25.60, 5.72, 2.10, 91.81),
        (23.36, 12.11, 4.39, 81.22),
        (32.98, 11.82, 5.96, 81.94),
    ),
}

ABLATION: Final[dict[str, Published]] = {
    "agent-passive-no-world": Published("agent-passive-no-world", "Qwen3.5 9B", 25.31, 6.86, 2.72, 89.25),
    "agent-passive": Published("agent-passive", "Qwen3.5 9B", 26.83, 8.06, 3.62, 86.51),
    "agent-no-world": Published("agent-no-world", "Qwen3.5 9B", 37.66, 18.22, 9.20, 75.57),
    "agent": Published("agent", "Qwen3.5 9B", 38.51, 27.50, 14.54, 62.25),
}
"""Active observation (off: passive) by world model (off: no world), as this project's method names."""

MAIN: Final = (
    *(
        Published(method, model, *figures)
        for model, rows in _MAIN.items()
        for method, figures in zip(_METHODS, rows, strict=True)
    ),
    ABLATION["agent"],
)
"""Its main table."""
