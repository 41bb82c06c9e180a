"""The paper's tables with the figures of a store beside each figure of the paper, and the difference.

A run is beside a row of the paper if its method is the row's method and its model is the row's model. Runs of the
simulated model and of the sample world are never matched by the names of their models.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from jrdb_avr.engine.report.paper import ABLATION, ALIASES, BY_GROUP, GROUPS, MAIN, QUOTAS, Published, backbone_of
from jrdb_avr.engine.report.scored_runs import QuestionIndex, ScoredRun, distinguishing_settings
from jrdb_avr.engine.report.tables import CELLS, SHARES, Line, reference_rows, run_names, score_columns
from jrdb_avr.schema.card import is_of_sample
from jrdb_avr.schema.errors import InputError, did_you_mean

_ENTRIES: Final[dict[str, list[tuple[Line, Published]]]] = {
    "paper_main": [({"model": row.model, "method": row.method}, row) for row in MAIN],
    "paper_ablation": [(CELLS[method], row) for method, row in ABLATION.items()],
    "paper_groups": [({"group": group, "paper_n": GROUPS[group].n}, row) for group, row in BY_GROUP.items()],
}
"""The first columns and the figures of each row of the paper, by table."""


def paper_rows(table: str, index: QuestionIndex, runs: Sequence[ScoredRun], backbone: str = "") -> list[Line]:
    """Compute a table of `PAPER_TABLES`.

    Args:
        table: Its name.
        index: The questions of the store, with their labels.
        runs: Scored runs.
        backbone: The paper's name for the model of the runs that no alias matches. If empty, these runs are left out.

    Returns:
        One row per row of the paper, or one per run if several runs match it. `paper_NAME` is the paper's figure,
        `NAME` this store's figure with its interval (None without a run), and `NAME_difference` is the second minus the
        first. Then the rows of `reference_rows` over the questions of the matched runs, by group in a table by group.

    Raises:
        InputError: If the paper has no model `backbone`, or if the runs that no alias matches have several models.
    """
    matched, settings = _match(runs, backbone), distinguishing_settings(runs)
    if table == "paper_generators":
        return _generator_rows(index)
    names, numbers = index.labels["group"]
    groups, rows, shown = np.array(names)[numbers], [], []
    for head, published in _ENTRIES[table]:
        beside, among = [], groups == head.get("group", groups)
        for run in matched[published.model]:
            if run.manifest.method == published.method and among[run.rows].any():
                shown.append(run)
                ours = run_names(run) | {"setting": settings[run.manifest.run_id]}
                beside.append(_row(head, published, ours | score_columns(index, run, among[run.rows])))
        rows += beside or [_row(head, published, {})]
    for part in [{"group": name} for name in names] if table == "paper_groups" else [{}]:
        rows += [part | row for row in reference_rows(index, shown, groups == part.get("group", groups))]
    return rows


def _row(head: Line, published: Published, ours: Line) -> Line:
    """Put a run's figures beside the paper's. `ours` is empty without a run."""
    row = head | {name: ours.get(name) for name in ("run", "label", "setting", "n", "interval")}
    for name in SHARES:
        paper, share = getattr(published, name), ours.get(name)
        row |= {f"paper_{name}": paper} | {key: ours.get(key) for key in (name, f"{name}_low", f"{name}_high")}
        row[f"{name}_difference"] = None if share is None else round(share - paper, 2)
    return row


def _match(runs: Sequence[ScoredRun], backbone: str) -> dict[str, list[ScoredRun]]:
    """Return the runs of each of the paper's models."""
    if backbone and backbone not in ALIASES:
        raise InputError(f"the paper has no model {backbone!r}{did_you_mean(backbone, ALIASES)}", field="backbone")
    names = [(run, "" if run.manifest.synthetic else backbone_of(run.manifest.model)) for run in runs]
    others = sorted({run.manifest.model for run, name in names if not name})
    if backbone and len(others) > 1:
        raise InputError(f"{backbone} cannot be all of {', '.join(others)}: name the runs of one", field="backbone")
    return {model: [run for run, name in names if (name or backbone) == model] for model in ALIASES}


def _generator_rows(index: QuestionIndex) -> list[Line]:
    labels = index.labels["family"]
    counts = dict(zip(labels.names, np.bincount(labels.numbers).tolist(), strict=True))
    label = "synthetic" if any(map(is_of_sample, index.labels["sequence"].names)) else ""
    pairs = {name: (quota, counts.get(name, 0)) for name, quota in QUOTAS.items()}
    pairs["all"] = (sum(QUOTAS.values()), len(index.ids))
    return [
        {"generator": name, "paper_n": paper, "n": n, "n_difference": n - paper, "label": label}
        for name, (paper, n) in pairs.items()
    ]
