"""`jrdb-avr runs`: list, show, compare, merge and remove the runs of a store."""

from __future__ import annotations

import sys
from collections import Counter
from typing import Any

import click

from jrdb_avr.engine.cli import NamingGroup
from jrdb_avr.engine.commands._options import Store, form_option, iou_option, run_argument, store_option
from jrdb_avr.engine.console import RowFormat, note, print_data, print_rows


@click.group(cls=NamingGroup)
def command() -> None:
    """List, show, compare, merge or remove the runs of a store.

    Examples:
      jrdb-avr runs list --store S
      jrdb-avr runs diff react-a react-b --store S
    """


@command.command(
    name="list",
    short_help="List the runs, and whether each run is complete.",
    epilog="Example: jrdb-avr runs list --store S",
)
@store_option()
@form_option
def runs_list(store: Store, form: RowFormat) -> None:
    """List the runs with their method, model, state, and numbers of answered, invalid and failed questions.

    The state of a run is "complete", "unfinished", "damaged" or "other questions". The state "other questions" means
    that the questions of the store have changed since the run began.
    """
    from jrdb_avr.engine.run.overview import list_runs

    rows = list_runs(store)
    if rows or form:
        print_rows(rows, form=form)
    else:
        note(f"no runs yet: jrdb-avr evaluate --store {store.path} --method METHOD --model MODEL")


@command.command(
    short_help="Show the settings and failures of a run.",
    epilog="Example: jrdb-avr runs show agent-simulated --store S",
)
@run_argument("run")
@store_option()
@form_option
def show(run: str, store: Store, form: RowFormat) -> None:
    """Show a run: the selection of its questions, its settings, and the most frequent reasons for missing answers."""
    from jrdb_avr.engine.run.overview import show_run

    facts = show_run(store, run)
    if form:
        print_data([facts], form)
        return
    note(f"in {facts.pop('folder')}")
    rows = [{"what": name, "value": value} for name, item in facts.items() for name, value in _lines(name, item)]
    # The prefix is removed, because the names of settings are long without it.
    rows = [{**row, "what": row["what"].removeprefix("settings.")} for row in rows if row["value"] not in (None, "")]
    print_rows(rows)


def _lines(name: str, value: Any) -> list[tuple[str, Any]]:
    """Return the printed lines of a value. Each line is a pair of a name and a text.

    A mapping has the lines of all its entries. A list of the most frequent reasons has one line per reason. Any other
    value has one line.
    """
    if isinstance(value, dict):
        return [line for key, item in value.items() for line in _lines(f"{name}.{key}", item)]
    if isinstance(value, list) and name.startswith("commonest"):
        return [(name, item) for item in value]
    return [(name, value)]


@command.command(
    name="merge",
    short_help="Merge all shards of a run into one run.",
    epilog="Example: jrdb-avr runs merge react-M-1of2 react-M-2of2 --run-id react-M --store S",
)
@run_argument("run_ids", nargs=-1, required=True, metavar="RUN...")
@store_option()
@click.option("--run-id", required=True, help="Name of the new run.")
def runs_merge(run_ids: tuple[str, ...], store: Store, run_id: str) -> None:
    """Merge all shards of a run into one run. 'evaluate --shard' writes the shards.

    If shards were written on other machines, first copy their run folders into the store's folder 'runs'. The shards
    must have the same method, model and settings. All options that select questions must be the same, except --shard.
    Merging leaves the shards unchanged.
    """
    from jrdb_avr.engine.run.merging import merge_runs

    predictions = merge_runs(store, run_ids, run_id)
    counts = Counter(predictions["status"].to_pylist())
    by_status = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
    note(f"wrote {store.run_path(run_id)}: {len(predictions)} predictions{f' ({by_status})' if counts else ''}")


@command.command(
    short_help="Delete runs and their world models.",
    epilog="Example: jrdb-avr runs remove react-simulated --store S --yes",
)
@run_argument("run_ids", nargs=-1, required=True, metavar="RUN...")
@store_option()
@click.option("--yes", is_flag=True, help="Delete without asking.")
def remove(run_ids: tuple[str, ...], store: Store, yes: bool) -> None:
    """Delete the folders of runs, and the world models of these runs in the graph of the store."""
    from jrdb_avr.engine.run.overview import remove_run

    if not yes:
        if not sys.stdin.isatty():
            raise click.UsageError("there is no terminal to ask for confirmation: add --yes")
        click.confirm(f"Delete {', '.join(run_ids)} of {store.path} for good?", abort=True)
    for run_id in dict.fromkeys(run_ids):
        remove_run(store, run_id)
        note(f"removed {run_id}")


@command.command(
    short_help="Compare two runs question by question.",
    epilog="Example: jrdb-avr runs diff react-a agent-a --store S --score answer",
)
@run_argument("first")
@run_argument("second")
@store_option()
@click.option(
    "--score",
    type=click.Choice(["answer", "evidence", "combined"]),
    default="combined",
    show_default=True,
    help="Score that decides which questions are listed below the table.",
)
@iou_option
@form_option
def diff(first: str, second: str, store: Store, score: str, iou: float, form: RowFormat) -> None:
    """Compare two runs on the questions that both runs contain.

    The table shows the scores of both runs in percent, and the difference in points: the second score minus the first.
    It also shows a 95 % interval of the difference, the number of questions that only one run has right, and the
    p-value of the exact McNemar test. Below the table, the command lists the questions that only one run has right. The
    option --score names the score by which a question counts as right. With --json or --csv, the command prints only
    this list.
    """
    from jrdb_avr.engine.report.comparison import diff
    from jrdb_avr.engine.report.formats import with_intervals
    from jrdb_avr.engine.report.tables import TOO_FEW

    compared = diff(store, first, second, iou=iou)
    questions = compared.questions(score)
    if form:
        print_data(questions, form)
        return
    few = any(row["interval"] == TOO_FEW for row in compared.rows)
    rows = [{name: row[name] for name in row if name != "interval"} for row in with_intervals(compared.scores())]
    print_rows(rows, title=f"first: {first}, second: {second}" + (f"; {TOO_FEW}" if few else ""))
    if questions:
        # Other columns already show which of the two runs is right.
        columns = [name for name in questions[0] if name != "only"]
        title = f"{len(questions)} questions that only one of the runs has right, by the score '{score}'"
        print_rows(questions, title, columns)
    else:
        note(f"no question is right in only one of the runs, by the score '{score}'")
    note(f"next: jrdb-avr view --store {store.path} --answers")
    if compared.synthetic:
        note("synthetic: the simulated model or the sample world, no result about JRDB")
