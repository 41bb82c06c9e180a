"""Score bundles with the answers of one store, and rank the bundles. Each set of questions has its own ranking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from jrdb_avr.engine.report.bundle import Bundle, bundle_submission, read_bundle
from jrdb_avr.engine.report.comparison import Scores
from jrdb_avr.engine.report.formats import with_intervals
from jrdb_avr.engine.report.run_scores import Submission, score_runs
from jrdb_avr.engine.report.scored_runs import ScoredRun, read_index
from jrdb_avr.engine.report.scoring import DEFAULT_IOU
from jrdb_avr.engine.report.tables import Line, main_rows, score_row
from jrdb_avr.engine.report.truth import read_truth
from jrdb_avr.queries.display import Displayed, Tables
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError


@dataclass(frozen=True, repr=False)
class Leaderboard(Displayed):
    """Scored bundles.

    Attributes:
        sets: For each question set, its bundles with their rows, the best combined score first. A row has the rank of
            the bundle in the set, the id of the set, the folder name of the bundle, and the columns of the table
            `main`.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.
    """

    sets: list[list[tuple[Bundle, Line]]]
    iou: float

    @property
    def rows(self) -> list[Line]:
        """All rows without macro averages. The rows of a question set are together."""
        rows = [row for entries in self.sets for _, row in entries]
        return [{name: row[name] for name in row if "_macro_" not in name} for row in rows]

    @property
    def synthetic(self) -> bool:
        """Whether at least one bundle used the simulated model or the sample world.

        The scores of such a bundle do not describe JRDB.
        """
        return any(bundle.run.synthetic for entries in self.sets for bundle, _ in entries)

    def _summary(self) -> str:
        return f"{len(self.rows)} bundles of {len(self.sets)} question sets, evidence from IoU {self.iou:g} on"

    def _tables(self) -> Tables:
        return {"Bundles in percent [95 % interval]": with_intervals(self.rows)}


def leaderboard(store: Store | str | Path, folders: Sequence[str | Path], iou: float = DEFAULT_IOU) -> Leaderboard:
    """Score bundles and rank them by their combined score. Bundles with equal combined scores have the same rank.

    A bundle without a prediction for each of its questions is partial. It comes last and has no rank.

    Args:
        store: The store that has the answers, or its folder.
        folders: Folders of bundles. A bundle that cannot be scored is left out with an AvrWarning.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.

    Returns:
        The leaderboard. Each set of questions has its own ranking. The set with the most questions comes first.

    Raises:
        StoreError: If no bundle can be scored.
    """
    sets: dict[str, list[tuple[Bundle, ScoredRun]]] = {}
    for bundle, run in _scored(Store.of(store), folders, iou, strict=False):
        sets.setdefault(bundle.question_set, []).append((bundle, run))
    if not sets:
        raise StoreError("none of the bundles can be scored: see the lines above")
    index = read_index(Store.of(store))
    ranked = []
    for name, scored in sets.items():
        rows = main_rows(index, [run for _, run in scored], iou)
        ordered = sorted(((*pair, row) for pair, row in zip(scored, rows, strict=True)), key=_order)
        scores = [row["combined"] for _, run, row in ordered if run.is_ranked]
        entries = []
        for bundle, run, row in ordered:
            rank = 1 + scores.index(row["combined"]) if run.is_ranked else None
            head: Line = {"rank": rank, "questions": name, "bundle": bundle.folder.name}
            entries.append((bundle, head | row | {"run": bundle.run.run_id}))
        ranked.append(entries)
    ranked.sort(key=lambda entries: (-entries[0][1]["n"], entries[0][0].question_set))
    return Leaderboard(ranked, iou)


def score_bundles(store: Store | str | Path, folders: Sequence[str | Path], iou: float = DEFAULT_IOU) -> Scores:
    """Score bundles with the answers of a store. Nothing is written.

    Args:
        store: The store that has the answers, or its folder.
        folders: Folders of bundles.
        iou: Minimum IoU of the evidence box and the target's box. Evidence with a smaller IoU is wrong.

    Returns:
        The scores of each bundle, in the order of the folders.

    Raises:
        InputError: If a bundle is altered or broken.
        StoreError: If a bundle answers the questions of another file than the questions file of the store, or if the
            predictions of a bundle do not match the questions of the bundle.
    """
    scored = _scored(Store.of(store), folders, iou, strict=True)
    return Scores([score_row(run, iou) | {"run": bundle.run.run_id} for bundle, run in scored])


def _scored(store: Store, folders: Sequence[str | Path], iou: float, strict: bool) -> list[tuple[Bundle, ScoredRun]]:
    bundles: dict[str | Path, Bundle] = {}

    def opened(folder: str | Path) -> Submission:
        bundles[folder] = read_bundle(folder, store)
        return bundle_submission(store, bundles[folder])

    scored = []
    for index, (folder, run) in enumerate(score_runs(read_truth(store), folders, opened, iou, strict)):
        # Each run gets a unique number as its id, because two bundles may have the same run id.
        run.manifest = msgspec.structs.replace(run.manifest, run_id=str(index))
        scored.append((bundles[folder], run))
    return scored


def _order(entry: tuple[Bundle, ScoredRun, Line]) -> tuple[bool, float, float, str, str]:
    bundle, run, row = entry
    return not run.is_ranked, -row["combined"], -row["answer"], bundle.run.run_id, str(bundle.folder)
