"""Select the questions of all templates with four choices, in a fixed order and under their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from jrdb_avr.engine.generate.answer_levels import select_answers
from jrdb_avr.engine.generate.asked import Candidate, Question, Selected, offer_of, sequence_cap
from jrdb_avr.engine.generate.guessers import LabelCounts, guesser_shares
from jrdb_avr.engine.generate.levelling import select_choices
from jrdb_avr.engine.generate.near_duplicates import Taken
from jrdb_avr.engine.generate.twins import MAX_TWINS, match_twins

ORDER: Final = ("fork_join", "three_hop", "two_hop", "later_action", "consequence", "change", "distance", "presence")
"""Templates in the order of selection: as a person is in few questions, the scarce templates choose first."""

_FIXED: Final = ("distance", "presence")
"""Templates with four fixed answers."""

_CHANGE_QUOTA: Final = 350
"""Maximum number of questions of the template change."""


def quota_of(template: str, quotas: Mapping[str, int], selected: Mapping[str, int], located: bool) -> int:
    """Return how many questions a template should give.

    Args:
        template: Name of the template.
        quotas: Number for each template, and that for the family unique_anchor.
        selected: Number of selected questions of the templates before it in `ORDER`.
        located: Whether a sequence has 3D boxes.

    Returns:
        The number of `quotas`. In the family unique_anchor change has 350, distance half of the rest if there are 3D
        boxes, and presence the rest.
    """
    rest = quotas["unique_anchor"] - selected.get("change", 0) - selected.get("distance", 0)
    if template == "change":
        return min(_CHANGE_QUOTA, quotas["unique_anchor"])
    if template == "distance":
        return rest // 2 if located else 0
    return rest if template == "presence" else quotas.get(template, 0)


def select_mix(
    pool: Mapping[str, Sequence[Candidate]],
    quotas: Mapping[str, int],
    counts: LabelCounts,
    taken: Taken,
    sequences: int,
    located: bool,
) -> tuple[list[Question], list[dict[str, Any]]]:
    """Select the questions of all templates with choices.

    Args:
        pool: The proven candidates of each template, in any order.
        quotas: Number for each template, and that for the family unique_anchor.
        counts: How common actions are.
        taken: Account of near-duplicates and caps. The selected questions are added.
        sequences: Number of sequences of the data.
        located: Whether a sequence has 3D boxes.

    Returns:
        The selected questions, and a row per template: template, quota, proven, reached, twins (pairs), shortage and
        the share of right answers of each counting guesser.
    """
    questions: list[Question] = []
    rows: list[dict[str, Any]] = []
    for template in ORDER:
        candidates = pool.get(template, ())
        quota = quota_of(template, quotas, {row["template"]: row["reached"] for row in rows}, located)
        selected = Selected([], None if candidates else "no candidate is proven")
        if candidates and quota:
            selected = _select(template, candidates, quota, counts, taken, sequences)
        offers = [offer_of(question, counts) for question in selected.questions]
        pairs = sum(question.twin is not None for question in selected.questions) // 2
        row = {"template": template, "quota": quota, "proven": len(candidates), "reached": len(offers)}
        rows.append(row | {"twins": pairs, "shortage": selected.shortage} | guesser_shares(offers))
        questions += selected.questions
    return questions, rows


def _select(
    template: str, candidates: Sequence[Candidate], quota: int, counts: LabelCounts, taken: Taken, sequences: int
) -> Selected:
    """Match the time twins of a template, and select its questions around them."""
    cap = sequence_cap(quota, sequences, 10 if template == "presence" else 20)
    twins = match_twins(candidates, taken, cap) if template in MAX_TWINS else []
    if template in _FIXED:
        return select_answers(candidates, quota, taken, sequences, twins)
    return select_choices(candidates, quota, counts, taken, sequences, twins)
