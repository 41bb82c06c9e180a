"""`jrdb-avr score` and `jrdb-avr report`: score runs, and compare them in tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import click

from jrdb_avr.engine.commands._options import FILE, FOLDER, Store, form_option, iou_option, run_argument, store_option
from jrdb_avr.engine.console import RowFormat, note, print_data, print_rows, warnings_as_notes

# Because OpenBLAS takes twice the processor time if it multiplies the small matrices of the bootstrap with threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_MACRO: Final = "_macro_"

_runs_argument = run_argument("runs", nargs=-1, metavar="[RUN]...")


@click.command()
@_runs_argument
@store_option()
@click.option(
    "--jsonl", type=FILE, help="Import predictions from FILE as the run RUN (default: the name of FILE), and score RUN."
)
@click.option("--bundle", type=FOLDER, help="Score a bundle that 'submit' wrote. The scores are not stored.")
@iou_option
@form_option
def score(
    runs: tuple[str, ...], store: Store, iou: float, form: RowFormat, jsonl: Path | None, bundle: Path | None
) -> None:
    """Score the predictions of each RUN, or of all runs if no RUN is given.

    The answer score, the evidence score and the combined score of every question are written to the file
    runs/RUN/scores.parquet of the store. The command prints the mean scores of each run.

    Examples:
      jrdb-avr score --store S react-simulated
      jrdb-avr score --store S --jsonl mine.jsonl     import predictions as the run 'mine'
      jrdb-avr score --store S --bundle bundle        score a bundle of 'submit'
    """
    from jrdb_avr.engine.report import comparison

    if (jsonl and len(runs) > 1) or (bundle and (runs or jsonl)):
        raise click.UsageError("--jsonl takes at most one RUN, --bundle takes neither RUN nor --jsonl")
    if jsonl is not None:
        from jrdb_avr.engine.run.imported import import_predictions

        runs = (import_predictions(store, jsonl, *runs),)
    from jrdb_avr.engine.run.run import write_partial

    for run_id in runs:
        write_partial(store, run_id)
    with warnings_as_notes():
        if bundle is not None:
            from jrdb_avr.engine.report.leaderboard import score_bundles

            scores = score_bundles(store, [bundle], iou)
        else:
            scores = comparison.score(store, runs, iou)
    print_rows(scores.rows, form=form)
    if not form:
        note(f"scores are percent of n; a box is right from IoU {iou:g} on")
    if not form and bundle is None:
        note(f"next: jrdb-avr report --store {store.path} && jrdb-avr view --store {store.path} --answers")


@click.command()
@_runs_argument
@store_option()
@click.option(
    "--table",
    "tables",
    multiple=True,
    metavar="NAME",
    help="main and twins (default), iou, gaps, looks, ablation, pairs, people, epochs, evidence_failures, cost, all, "
    "or a breakdown by family, group, template, answer_mode, hops, time_gap_s, separation_deg, sequence, or a column "
    "of imported questions. May be repeated.",
)
@click.option("--paper", is_flag=True, help="Print the paper's tables 3 to 6 beside the scores of this store.")
@click.option(
    "--as",
    "backbone",
    metavar="MODEL",
    default="",
    help="With --paper: the paper's name, such as 'Qwen3.5 9B', for the model of the RUNS. Runs of the simulated model "
    "and of the sample need it.",
)
@iou_option
@form_option
@click.option("--markdown", "as_markdown", is_flag=True, help="Print Markdown tables.")
@click.option("--latex", "as_latex", is_flag=True, help="Print LaTeX tables for the package booktabs.")
@click.option("--html", type=FILE, help="HTML file to write, with all tables.")
@click.option("--leaderboard", is_flag=True, help="Rank bundles. Give folders of bundles instead of runs.")
def report(store: Store, tables: tuple[str, ...], iou: float, paper: bool, html: Path | None, **options: Any) -> None:
    """Compare the scores of the given RUNs in tables. If no RUN is given, compare all runs.

    The columns show percentages of a run's n questions. answer: questions with a right answer. evidence: questions with
    a right box. combined: questions with a right answer and a right box. invalid: questions with a reply that could not
    be read. The column hallucination has another base: of the questions with a right answer, it is the percentage
    without a right box. Each 95 % interval comes from a bootstrap, which draws the sequences at random 10,000 times
    with a fixed seed. A macro average is the mean of a score over the seven families, or over the paper's five groups.

    The table twins has the time-grounded accuracy. Its n counts pairs of time twins, which are two questions that
    differ in one asked time and in their answers. both_answers: pairs with both answers right. both_combined: pairs
    with both boxes right in addition. single: questions of these pairs with a right answer. Rows with the label guesser
    belong to methods that see no picture. two answers: two different answers at random, if the twins are known. time
    ignored: the most that a method can reach if it answers both questions alike.

    Examples:
      jrdb-avr report --store S
      jrdb-avr report --store S --table template --table pairs
      jrdb-avr report --store S --paper --latex
      jrdb-avr report --store S --leaderboard B1 B2 --html leaderboard.html
    """
    form, as_markdown, as_latex = options["form"], options["as_markdown"], options["as_latex"]
    if bool(form) + as_markdown + as_latex + (html is not None) > 1:
        raise click.UsageError("choose one of --json, --csv, --markdown, --latex and --html")

    if options["leaderboard"]:
        if tables or paper or options["backbone"] or as_markdown or as_latex:
            raise click.UsageError("--leaderboard goes with --iou, --json, --csv and --html only")
        _leaderboard(store, options["runs"], iou, html, form)
        return

    from jrdb_avr.engine.report import comparison, formats
    from jrdb_avr.engine.report.bootstrap import LEAST_CLUSTERS
    from jrdb_avr.engine.report.scored_runs import read_index
    from jrdb_avr.engine.report.tables import PAPER_TABLES, TOO_FEW, tables_of
    from jrdb_avr.engine.validate.references import read_references
    from jrdb_avr.schema.errors import did_you_mean

    tables += tuple(PAPER_TABLES) if paper else ()
    if form == "csv" and (len(tables) > 1 or "all" in tables):
        raise click.UsageError("--csv prints one table: give one --table")
    known = tables_of(read_index(store).labels)
    names = known if "all" in tables else tables or (("main",) if form == "csv" else ("main", "twins"))
    for name in names:
        if name not in known:
            raise click.UsageError(f"no table {name!r}{did_you_mean(name, (*known, 'all'))}")
    with warnings_as_notes():
        result = comparison.report(store, options["runs"], iou=iou, backbone=options["backbone"])
        result.index.references = read_references(store)
    if html is not None:
        from jrdb_avr.engine.pages.page import write_page
        from jrdb_avr.engine.pages.report import report_page

        write_page(html, report_page(result, paper=paper))
        note(f"wrote {html}")
        return
    rows_of = result.tables(names)
    names = tuple(name for name in names if name != "twins" or rows_of[name])
    if form == "csv":
        print_data(rows_of[names[0]], form)
        return
    if form:
        settings = {run.manifest.run_id: {"settings": run.manifest.settings} for run in result.runs}
        rows = [{"table": name, **row} for name in names for row in rows_of[name]]
        print_data(({**row, **(settings.get(row["run"], {}) if row["table"] == "main" else {})} for row in rows), form)
        return
    for name in names:
        caption = formats.paper_caption(name, rows_of[name])
        title = caption or (name if len(names) > 1 else "")
        if as_markdown:
            text = formats.markdown(formats.for_paper(name, rows_of[name]))
            click.echo((f"### {title}\n\n" if title else "") + text, nl=False)
        elif as_latex:
            text = formats.latex(formats.for_paper(name, rows_of[name]), caption)
            click.echo((f"% {title}\n" if title else "") + text, nl=False)
        elif caption:
            print_rows(formats.for_paper(name, rows_of[name]), title=title)
        else:
            _print_table(name, rows_of[name], title)
    if any(row.get("interval") == TOO_FEW for rows in rows_of.values() for row in rows):
        note(f"{TOO_FEW} in rows with fewer than {LEAST_CLUSTERS} sequences")
    note(f"scores are percent of n; a box is right from IoU {iou:g} on; [95 % interval]; n/a: no answer scored")
    if any(map(formats.other_counts, rows_of.values())):
        note(f"{formats.MARK} fewer or more questions than most runs; --table pairs compares common questions")
    if result.synthetic:
        note("synthetic: the simulated model or the sample world, no result about JRDB")


def _leaderboard(store: Store, folders: tuple[str, ...], iou: float, html: Path | None, form: RowFormat) -> None:
    """Score and rank bundles. Write the ranking as an HTML file, or print it as a table, JSON or CSV."""
    from jrdb_avr.engine.report.formats import filled, with_intervals
    from jrdb_avr.engine.report.leaderboard import leaderboard

    if not folders:
        raise click.UsageError("--leaderboard ranks bundles: name their folders")
    with warnings_as_notes():
        board = leaderboard(store, folders, iou)
    if html is not None:
        from jrdb_avr.engine.pages.leaderboard import leaderboard_page
        from jrdb_avr.engine.pages.page import write_page

        write_page(html, leaderboard_page(board))
        note(f"wrote {html}")
        return
    print_rows(board.rows if form else filled(with_intervals(board.rows)), form=form)


def _print_table(name: str, rows: list[dict[str, Any]], title: str) -> None:
    from jrdb_avr.engine.report.formats import filled, with_intervals

    cells = with_intervals(rows)
    empty = (column for column in ("label", "setting") if not any(row.get(column) for row in cells))
    # The id of a run already names its method and model.
    left_out = {"iou", "interval", "method", "model", *empty}
    plain = [{k: v for k, v in row.items() if _MACRO not in k and k not in left_out} for row in cells]
    if name == "main" and not rows[-1]["method"]:
        plain.insert(sum(bool(row["method"]) for row in rows), {})
    print_rows(filled(plain), title=title)
    if name == "main":
        macro = [{k.replace(_MACRO, " over "): v for k, v in row.items() if k == "run" or _MACRO in k} for row in cells]
        print_rows([row for row in macro if len(row) > 1], title="macro averages")
