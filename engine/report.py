"""The comparison of runs: one row per run, in percent of the questions asked."""

from __future__ import annotations

from dataclasses import dataclass

import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.queries.runs import RunManifest


@dataclass(frozen=True)
class Row:
    """A run's results. Percent of `n`, the questions asked; `hallucination` is None where no answer scored.

    `errors` counts questions without a prediction too. `label` is "synthetic" for runs of the marker model or on the
    sample world.
    """

    run_id: str
    method: str
    model: str
    label: str
    n: int
    answer: float | None
    evidence: float | None
    combined: float | None
    hallucination: float | None
    invalid: float | None
    errors: float | None
    iou: float


def report_row(manifest: RunManifest, predictions: pa.Table, scores: pa.Table, iou: float) -> Row:
    """One run's row from its manifest, predictions and scores."""
    n = scores.num_rows
    answer, evidence, combined = (_total(scores[f"{name}_score"]) for name in ("answer", "evidence", "combined"))
    judged = _total(pc.is_in(predictions["status"], value_set=pa.array(["answered", "invalid"])))
    return Row(
        run_id=manifest.run_id,
        method=manifest.method,
        model=manifest.model,
        label="synthetic" if manifest.synthetic else "",
        n=n,
        answer=percent(answer, n),
        evidence=percent(evidence, n),
        combined=percent(combined, n),
        hallucination=hallucination(answer, combined),
        invalid=percent(_total(scores["invalid"]), n),
        errors=percent(n - judged, n),
        iou=iou,
    )


def percent(part: int, n: int) -> float | None:
    """Percent with two decimals; None of nothing."""
    return round(100 * part / n, 2) if n else None


def hallucination(answer: int, combined: int) -> float | None:
    """Percent of the scoring answers whose evidence does not score; None where no answer scores."""
    return percent(answer - combined, answer)


def markdown(rows: list[dict[str, object]], columns: list[str]) -> str:
    """Rows as a Markdown table; None is written n/a."""
    lines = [columns, ["---:" if name not in ("run", "method", "model", "label") else "---" for name in columns]]
    lines += [[cell(row[name]).replace("|", "\\|") for name in columns] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def cell(value: object) -> str:
    """A value as a person reads it."""
    if value is None:
        return "n/a"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def _total(values: pa.ChunkedArray) -> int:
    return int(pc.sum(values).as_py() or 0)
