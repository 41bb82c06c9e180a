"""Figures that the JRDB-AVR paper reports, and the names of its models.

The figures describe the paper's own 2,098 questions about JRDB, not the questions of a store. The paper has five groups
of questions, and this project has seven families: `GROUPS` says which families form a group.
"""

from __future__ import annotations

import csv
from importlib.resources import files
from typing import Final, NamedTuple


class Group(NamedTuple):
    """A group of questions in the paper, with counts of the right predictions of the paper's agent.

    Attributes:
        families: The question families of this project that correspond to this group of the paper.
        n: Number of questions.
        answer: Number of questions with a right answer.
        evidence: Number of questions with right evidence.
        combined: Number of questions with a right answer and right evidence.
    """

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
"""The paper's groups by name, with the counts of the paper's agent on Qwen3.5 9B."""


QUOTAS: Final = {
    "action_boundary": 67,
    "chain_2hop": 76,
    "chain_3hop": 222,
    "chain_fork_join": 32,
    "chain_hybrid": 51,
    "long_range": 30,
    "unique_anchor": 1620,
}
"""Number of questions of each family in the paper, in the order of its table."""


class Published(NamedTuple):
    """A row of the paper's main table or ablation, in percent."""

    method: str
    model: str
    answer: float
    evidence: float
    combined: float
    hallucination: float


ALIASES: Final[dict[str, tuple[str, ...]]] = {
    "Gemma-4 E2B": ("gemma-4-e2b-it", "gemma-4-e2b", "gemma4:e2b"),
    "Gemma-4 E4B": ("gemma-4-e4b-it", "gemma-4-e4b", "gemma4:e4b"),
    "Qwen3-VL 4B": ("qwen3-vl-4b-instruct", "qwen3-vl-4b", "qwen3-vl:4b"),
    "Qwen3-VL 8B": ("qwen3-vl-8b-instruct", "qwen3-vl-8b", "qwen3-vl:8b"),
    "Qwen3.5 4B": ("qwen3.5-4b", "qwen3.5:4b"),
    "Qwen3.5 9B": ("qwen3.5-9b", "qwen3.5:9b"),
}
"""Names of each of the paper's models at servers and hubs, in lower case and without the name of an organisation."""


def backbone_of(model: str) -> str:
    """Return the paper's name of a model, or "" for a model that the paper lacks.

    Args:
        model: The id of the model, such as Qwen/Qwen3.5-9B.

    Returns:
        A key of `ALIASES`, or "".
    """
    name = model.rpartition("/")[2].lower()
    return next((backbone for backbone, names in ALIASES.items() if name in (backbone.lower(), *names)), "")


_LINES: Final = files(__package__).joinpath("paper.csv").read_text("utf-8").splitlines()[1:]

_ROWS: Final = [Published(method, model, *map(float, figures)) for method, model, *figures in csv.reader(_LINES)]

MAIN: Final = [row for row in _ROWS if row.method == "agent" or not row.method.startswith("agent")]
"""Rows of the paper's main table."""

ABLATION: Final = {row.method: row for row in _ROWS if row.method.startswith("agent")}
"""Rows of the paper's ablation, by the name of this project's corresponding method."""


def _published(n: int, answer: int, evidence: int, combined: int) -> Published:
    parts = ((answer, n), (evidence, n), (combined, n), (answer - combined, answer))
    return Published("agent", "Qwen3.5 9B", *(round(100 * part / whole, 2) for part, whole in parts))


BY_GROUP: Final = {group: _published(*counts[1:]) for group, counts in GROUPS.items()}
"""Figures of the paper's agent, by group of questions."""
