"""Time-grounded accuracy: the share of pairs of time twins with both answers right.

Time twins differ in one asked time, and their answers differ. A method that finds the right person and ignores the time
has at most one of the two right. As the pairs are few, methods are never ranked by this share alone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from jrdb_avr.engine.report.bootstrap import Interval, intervals, mean_ratio

CHANCE: Final = {"change": (1 / 16, 1 / 12), "later_action": (1 / 16, 1 / 12), "presence": (1 / 16, 1 / 4)}
"""For each template with twins, the share of pairs that a uniform guesser has right: without knowledge of the twins,
and with two different answers for each pair. In presence the twins share a time, so fewer answers fit."""


class TwinScore(NamedTuple):
    """The scores of a method for one question that has a twin.

    Attributes:
        twin: The common id of the two questions.
        template: Name of the template.
        sequence: Name of the sequence.
        answer: 1 if the answer is right, else 0.
        combined: 1 if the answer and the evidence box are right, else 0.
    """

    twin: str
    template: str
    sequence: str
    answer: int
    combined: int


def time_grounded_row(scores: Sequence[TwinScore]) -> dict[str, Any] | None:
    """Compute the time-grounded accuracy of a method.

    Args:
        scores: Scores of the questions that have a twin, in any order. A question without the score of its twin is
            ignored.

    Returns:
        n (number of pairs), sequences; the shares `both_answers` and `both_combined` of pairs with both right, as
        intervals over sequences; the share `single` of right answers to the same questions; the mean chance of the
        pairs for a guesser without (`chance`) and with knowledge of the twins (`chance_twins`). None without a pair.
    """
    by_twin: dict[str, list[TwinScore]] = defaultdict(list)
    for score in scores:
        by_twin[score.twin].append(score)
    pairs = [pair for _, pair in sorted(by_twin.items()) if len(pair) == 2]
    if not pairs:
        return None
    sequences = sorted({first.sequence for first, _ in pairs})
    sums = np.zeros((len(sequences), 4))
    for first, second in pairs:
        both = first.answer * second.answer, first.combined * second.combined
        sums[sequences.index(first.sequence)] += (1, *both, first.answer + second.answer)
    answers, combined = intervals(sums, (mean_ratio((1, 0)), mean_ratio((2, 0))))
    chances = [sum(CHANCE[first.template][known] for first, _ in pairs) / len(pairs) for known in (0, 1)]
    shares: dict[str, Interval | float] = {"both_answers": answers, "both_combined": combined}
    shares |= {"single": float(sums[:, 3].sum()) / (2 * len(pairs))}
    return {"n": len(pairs), "sequences": len(sequences), **shares, "chance": chances[0], "chance_twins": chances[1]}
