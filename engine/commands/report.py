"""`jrdb-avr report`: compare runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import click

from jrdb_avr.engine.output import json_option, note, print_json, print_rows, store_option


@click.command(epilog="Example: jrdb-avr report --store S --markdown   (without a RUN: all runs)")
@click.argument("runs", nargs=-1, metavar="[RUN]...")
@store_option
@click.option("--iou", type=click.FloatRange(0.0, 1.0, min_open=True), default=0.5, show_default=True, help="Evidence.")
@json_option
@click.option("--csv", "as_csv", is_flag=True, help="Print CSV.")
@click.option("--markdown", "as_markdown", is_flag=True, help="Print a Markdown table.")
def command(runs: tuple[str, ...], store: Path, iou: float, as_json: bool, as_csv: bool, as_markdown: bool) -> None:
    """Compare runs: answer, evidence, combined, hallucination and invalid in percent of the n questions asked."""
    if as_json + as_csv + as_markdown > 1:
        raise click.UsageError("choose one of --json, --csv and --markdown")

    from jrdb_avr.engine.report import cell, markdown, report_row
    from jrdb_avr.queries.store import Store

    from ._judging import scored_runs

    # Scoring takes milliseconds, so a report never trusts scores of an earlier threshold or question file.
    found = [
        (manifest.settings, report_row(manifest, predictions, scores, iou))
        for manifest, predictions, scores in scored_runs(Store(store), runs, iou)
    ]
    found.sort(key=lambda pair: (pair[1].method, pair[1].model, pair[1].run_id))
    rows = [{"run": row.run_id, **_without_run(dataclasses.asdict(row))} for _, row in found]
    if as_json:
        print_json([{**row, "settings": settings} for row, (settings, _) in zip(rows, found, strict=True)])
        return
    columns = list(rows[0])
    if as_csv:
        _print_csv(rows)
    elif as_markdown:
        click.echo(markdown(rows, columns), nl=False)
    else:
        print_rows([{name: cell(value) for name, value in row.items()} for row in rows])
    note(f"percent of n; evidence scores from IoU {iou:g} on; n/a: no answer scored")
    if any(row["label"] for row in rows):
        note("synthetic: the marker model or the sample world, no result about JRDB")


def _without_run(row: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in row.items() if name != "run_id"}


def _print_csv(rows: list[dict[str, object]]) -> None:
    import csv
    import sys

    writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
