"""`jrdb-avr score`: judge the predictions of runs and keep the scores."""

from __future__ import annotations

from pathlib import Path

import click

from jrdb_avr.engine.console import json_option, note, print_json, print_rows, store_option


@click.command(epilog="Example: jrdb-avr score --store S react-marker   (without a RUN: all runs)")
@click.argument("runs", nargs=-1, metavar="[RUN]...")
@store_option
@click.option("--iou", type=click.FloatRange(0.0, 1.0, min_open=True), default=0.5, show_default=True, help="Evidence.")
@json_option
def command(runs: tuple[str, ...], store: Path, iou: float, as_json: bool) -> None:
    """Write runs/RUN/scores.parquet: answer, evidence and combined score of every question asked."""
    from jrdb_avr.engine.commands._scored_runs import judged_runs
    from jrdb_avr.engine.report.scoring import write_scores
    from jrdb_avr.engine.report.tables import score_row
    from jrdb_avr.queries.store import Store

    opened = Store(store)
    _, _, judged = judged_runs(opened, runs, iou)
    rows = []
    for run, scores in judged:
        write_scores(opened, run.manifest.run_id, scores, iou)
        rows.append(score_row(run, iou))
    if as_json:
        print_json(rows)
    else:
        print_rows(rows)
        note(f"percent of n; evidence scores from IoU {iou:g} on")
