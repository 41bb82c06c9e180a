"""The table `twins`: time-grounded accuracy, the share of pairs of time twins with both answers right.

Time twins differ in one asked time, and their answers differ. A method that finds the right person and ignores the time
has at most one of the two right. As the pairs are few, methods are never ranked by this share.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

import numpy as np

from jrdb_avr.engine.report.scored_runs import QuestionIndex, ScoredRun, percent_of
from jrdb_avr.engine.report.tables import Line, interval_label, run_names, shares_with_bounds
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import warn

_DIFFERENT: Final = {"presence": 1 / 4}
"""Share of pairs that a guesser of two different answers has right, by template. In presence the twins share a time, so
that only four pairs of answers fit. In the templates that this dictionary lacks, twelve fit."""


def twin_rows(index: QuestionIndex, runs: Sequence[ScoredRun]) -> list[Line]:
    """Compute the table `twins`.

    Args:
        index: The questions of the store, with their labels.
        runs: Scored runs.

    Returns:
        One row per run that has both questions of a pair, then one row per guesser. `n` is the number of pairs.
        `both_answers` is the share of pairs with both answers right, `both_combined` the share with both boxes right in
        addition, each with an interval over sequences. `single` is the share of right answers to the same questions.
        The list is empty if no run has a pair.
    """
    pairs, rows = find_pairs(index.twins), []
    for run in runs:
        complete = pairs[np.isin(pairs, run.rows).all(axis=1)]
        rows += [_row(index, run, np.searchsorted(run.rows, complete))] if len(complete) else []
    return rows and rows + _guessers(index, pairs)


def find_pairs(twin_ids: Sequence[str | None]) -> Ints:
    """Find the pairs of time twins among questions. An AvrWarning names the ids that are not on exactly two questions.

    Args:
        twin_ids: The `twin_id` of each question of a store.

    Returns:
        The positions of the two questions of each pair. Shape: (pairs, 2).
    """
    by_twin: dict[str, list[int]] = defaultdict(list)
    for position, twin in enumerate(twin_ids):
        if twin is not None:
            by_twin[twin].append(position)
    if strays := sorted(twin for twin, positions in by_twin.items() if len(positions) != 2):
        line = f"twin_id {', '.join(strays[:3])}: not on exactly two questions, so left out ({len(strays)} in all)"
        warn(f"{line}: run 'jrdb-avr validate'")
    return np.array([pair for pair in by_twin.values() if len(pair) == 2], np.int64).reshape(-1, 2)


def _row(index: QuestionIndex, run: ScoredRun, pairs: Ints) -> Line:
    scores, n = run.scores[pairs], len(pairs)
    ratios = {"both_answers": (1, 0), "both_combined": (3, 0)}
    shares, sequences = shares_with_bounds(index, run.rows[pairs[:, 0]], scores.prod(axis=1), ratios)
    row = run_names(run) | {"n": n} | shares | {"single": percent_of(int(scores[:, :, 0].sum()), 2 * n)}
    return row | {"sequences": sequences, "interval": interval_label(sequences)}


def _guessers(index: QuestionIndex, pairs: Ints) -> list[Line]:
    """Return the row of each guesser over all pairs of the store."""
    n, template = len(pairs), index.labels["template"]
    different = sum(_DIFFERENT.get(template.names[code], 1 / 12) for code in template.numbers[pairs[:, 0]].tolist())
    # The names have spaces, so that no run id is equal to one of them.
    shares = {"uniform answers": (n / 16, 25.0), "two answers": (different, 25.0), "time ignored": (0, 50.0)}
    return [
        {"run": name, "method": "", "model": "", "label": "guesser", "n": n}
        | {"both_answers": percent_of(both, n), "single": single}
        for name, (both, single) in shares.items()
    ]
