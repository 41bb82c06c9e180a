"""`jrdb-avr report`: compare runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import click

from jrdb_avr.engine.console import json_option, note, print_json, print_rows, store_option

_ALL: Final = "all"

_EXAMPLE: Final = """\b
Examples:
  jrdb-avr report --store S                             all runs
  jrdb-avr report --store S --table template --table pairs
  jrdb-avr report --store S --paper --latex             beside the paper's rows
"""

_MACRO: Final = "_macro_"


@click.command(epilog=_EXAMPLE)
@click.argument("runs", nargs=-1, metavar="[RUN]...")
@store_option
@click.option(
    "--table",
    "tables",
    multiple=True,
    metavar="NAME",
    help="main; family, group, template, answer_mode, hops, time_gap_s, separation_deg or sequence (breakdowns); "
    "ablation, pairs, wrong_choices, evidence_failures, cost; all. May be given often.  [default: main]",
)
@click.option("--paper", is_flag=True, help="Add the paper's figures as rows, labelled 'paper'.")
@click.option("--iou", type=click.FloatRange(0.0, 1.0, min_open=True), default=0.5, show_default=True, help="Evidence.")
@json_option
@click.option("--csv", "as_csv", is_flag=True, help="Print CSV.")
@click.option("--markdown", "as_markdown", is_flag=True, help="Print Markdown.")
@click.option("--latex", "as_latex", is_flag=True, help="Print LaTeX, for the package booktabs.")
@click.option("--html", type=click.Path(dir_okay=False, path_type=Path), help="Write everything as one page.")
def command(
    runs: tuple[str, ...],
    store: Path,
    tables: tuple[str, ...],
    paper: bool,
    iou: float,
    as_json: bool,
    as_csv: bool,
    as_markdown: bool,
    as_latex: bool,
    html: Path | None,
) -> None:
    """Compare runs: answer, evidence, combined, hallucination and invalid in percent of the n questions asked.

    Intervals are 95 %, from 10,000 seeded draws of whole sequences. Macro averages are over the seven families and the
    paper's five groups.
    """
    if as_json + as_csv + as_markdown + as_latex + (html is not None) > 1:
        raise click.UsageError("choose one of --json, --csv, --markdown, --latex and --html")

    from jrdb_avr.engine.commands._scored_runs import judged_runs
    from jrdb_avr.engine.report import formats as typeset
    from jrdb_avr.engine.report.tables import TABLES, report_table
    from jrdb_avr.queries.store import Store

    names = TABLES if _ALL in tables else tables or ("main",)
    for name in names:
        if name not in TABLES:
            raise click.UsageError(f"no table {name!r}; there are {', '.join(TABLES)}, {_ALL}")
    if as_csv and len(names) > 1:
        raise click.UsageError("--csv prints one table: give one --table")
    opened = Store(store)
    truth, facts, judged = judged_runs(opened, runs, iou)
    found = [run for run, _ in judged]
    if html is not None:
        from jrdb_avr.engine.pages.page import write_page
        from jrdb_avr.engine.pages.report_page import report_page

        write_page(html, report_page(opened, truth, facts, found, iou, published=paper))
        note(f"wrote {html}")
        return
    made = {name: report_table(name, opened, truth, facts, found, iou, published=paper) for name in names}
    if as_json:
        settings = {run.manifest.run_id: run.manifest.settings for run in found}
        print_json([_for_json(name, row, settings) for name, rows in made.items() for row in rows])
        return
    for name, rows in made.items():
        title = name if len(made) > 1 else ""
        if as_csv:
            click.echo(typeset.csv_text(rows), nl=False)
        elif as_markdown:
            click.echo((f"### {title}\n\n" if title else "") + typeset.markdown(_for_paper(name, rows)), nl=False)
        elif as_latex:
            click.echo((f"% {title}\n" if title else "") + typeset.latex(_for_paper(name, rows)), nl=False)
        else:
            _print_table(name, rows, title)
    note(f"percent of n; evidence scores from IoU {iou:g} on; [95 % interval]; n/a: no answer scored")
    if any(run.manifest.synthetic for run in found):
        note("synthetic: the marker model or the sample world, no result about JRDB")


def _for_json(name: str, row: dict[str, Any], settings: dict[str, dict[str, Any]]) -> dict[str, Any]:
    more = {"settings": settings[row["run"]]} if name == "main" and row["run"] in settings else {}
    return {"table": name, **row, **more}


def _for_paper(name: str, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """What a paper's table shows: no intervals and no macro averages, models first."""
    if name != "main":
        return [{key: value for key, value in row.items() if not key.endswith(("_low", "_high"))} for row in rows]
    rows = sorted(rows, key=lambda row: (str(row["model"]), str(row.get("setting", ""))))
    names = [(row["model"], row["method"], row.get("setting", "")) for row in rows]
    columns = ["model", "method", *(["setting"] if any(row.get("setting") for row in rows) else [])]
    # Runs that nothing else tells apart are told apart by their ids.
    columns += [*(["run"] if len(set(names)) < len(names) else []), "label", "n"]
    columns += ["answer", "evidence", "combined", "hallucination", "invalid"]
    return [{key: row.get(key, "") if key == "setting" else row.get(key) for key in columns} for row in rows]


def _print_table(name: str, rows: list[dict[str, Any]], title: str) -> None:
    from jrdb_avr.engine.report import formats as typeset

    shown = typeset.joined(rows)
    if name != "main":
        print_rows(typeset.filled(shown), title=title)
        return
    left_out = ("iou", "sequences")
    plain = [{k: v for k, v in row.items() if _MACRO not in k and k not in left_out} for row in shown]
    print_rows(typeset.filled(plain), title=title)
    macro = [{k.replace(_MACRO, " over "): v for k, v in row.items() if k == "run" or _MACRO in k} for row in shown]
    print_rows([row for row in macro if len(row) > 1], title="macro averages")
