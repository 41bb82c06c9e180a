"""`jrdb-avr evaluate`: run a method on the questions."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from jrdb_avr.engine.commands._complete import complete_sequence
from jrdb_avr.engine.commands._endpoint import check_address, endpoint_options
from jrdb_avr.engine.commands._matrix import matrix_runs
from jrdb_avr.engine.commands._options import FILE, form_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_rows, progress_bar
from jrdb_avr.engine.run.methods import METHODS, NO_MODEL, POLICIES
from jrdb_avr.schema.errors import AvrError, InputError

if TYPE_CHECKING:
    from jrdb_avr.engine.run.evaluate import RunResult
    from jrdb_avr.engine.run.live_scores import LiveScore
    from jrdb_avr.queries.store import Store

LOG_EVERY_S: Final = 30.0
"""Seconds between two lines of scores so far where there is no bar to print them beside."""

_CHECKED: Final = ("method", "model", "base_url", "world_db", "policy", "history")
"""Options that may contradict each other."""

_EXAMPLE: Final = """\b
Examples:
  jrdb-avr evaluate --store S --method react --model marker
  jrdb-avr evaluate --store S --method agent --model M --base-url http://localhost:8000/v1
  jrdb-avr evaluate --store S --method agent --model marker --resume
  jrdb-avr evaluate --store S --matrix runs.toml --limit 100

A machine without labels needs a folder with questions/questions.parquet and questions/sequences.parquet, and the
panoramas:

\b
  jrdb-avr evaluate --store S --images DIR --world-db world.kuzu \\
      --method agent --model M --base-url URL
"""


@click.command(epilog=_EXAMPLE)
@store_option()
@click.option(
    "--method",
    metavar="METHOD",
    help=f"How questions are answered: {', '.join(METHODS)}; or one of your own, as FILE.py:NAME or MODULE:NAME.",
)
@click.option(
    "--policy",
    type=click.Choice(POLICIES),
    help="Who chooses the looks of agent and agent-no-world: 'driven', the program, unless another is named; 'guided', "
    "the model among the program's best; 'model', the model alone. The first two have it read one picture at a time.",
)
@click.option(
    "--history",
    type=click.IntRange(1),
    metavar="N",
    help="Of react, and of agent-no-world with --policy model: send the last N pictures in each turn, of older ones "
    "their metadata line alone. All without.",
)
@endpoint_options(optional=True)
@click.option(
    "--prices",
    type=FILE,
    help="TOML file of prices: a table per model with input and output, in dollars per million tokens.",
)
@click.option(
    "--max-cost",
    type=click.FloatRange(0, min_open=True),
    metavar="DOLLARS",
    help="Stop once the run's calls have cost so much, by --prices; more, and --resume, go on. Calls in flight may "
    "exceed it; --resume does not count again what replies cost that were cut off or refused.",
)
@click.option("--run-id", help="Name of the run; METHOD-MODEL if left out, METHOD-POLICY-MODEL with --policy.")
@click.option("--questions", "picked", help="Question ids with commas between, or a file with one id per line.")
@click.option("--family", "families", multiple=True, metavar="NAME", help="Only of this family; may be repeated.")
@click.option("--template", "templates", multiple=True, metavar="NAME", help="Only of this template; may be repeated.")
@click.option(
    "--sequence",
    "sequences",
    multiple=True,
    metavar="NAME",
    shell_complete=complete_sequence,
    help="Only of this sequence; may be repeated.",
)
@click.option(
    "--per-template",
    type=click.IntRange(1),
    metavar="N",
    help="At most N of each template; with --limit the same number of each, as far as there are so many.",
)
@click.option("--limit", type=click.IntRange(1), metavar="N", help="At most N in all, of those that have panoramas.")
@click.option("--seed", type=int, help="Draw the questions at random; without it the first ones are taken.")
@click.option(
    "--concurrency",
    type=click.IntRange(1, 64),
    default=16,
    show_default=True,
    help="Questions in flight at a time.",
)
@click.option(
    "--resume",
    is_flag=True,
    help="Finish a run that was stopped, ask again what ended in an error, and ask more where more are selected.",
)
@click.option(
    "--images",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="Folder with one folder of panoramas per sequence; the store's own if left out.",
)
@click.option(
    "--world-db",
    type=FILE,
    help="Graph file for the agent's world model, in place of the store's: for runs in parallel, or without labels.",
)
@click.option(
    "--opaque",
    is_flag=True,
    help="Give the method names of sequences that say nothing of the place; they are the same in every run of a store.",
)
@click.option(
    "--marker",
    "noise",
    multiple=True,
    metavar="KEY=VALUE",
    help="A knob of the simulated model, on top of its profile: wrong_box=0.1, ids=off, seed=3, and others that "
    "docs/models.md lists. May be repeated.",
)
@click.option(
    "--strict-preflight",
    is_flag=True,
    help="Refuse the run where a check of the server fails that the method needs; without, it is a warning on record.",
)
@click.option(
    "--scores/--no-scores",
    default=None,
    help="Scores so far, from a process of their own; beside the bar on a terminal, as lines elsewhere.",
)
@click.option(
    "--epochs",
    type=click.IntRange(1, 1000),
    metavar="N",
    help="Ask each question N times, in runs RUN-1 to RUN-N; 'report --table epochs' has pass@k and the majority.",
)
@click.option(
    "--matrix",
    type=FILE,
    help="TOML file of several runs: a table [[run]] with options, by their names; a list is a run for each value.",
)
@form_option
def command(store: Store, matrix: Path | None, form: RowFormat, **options: Any) -> None:
    """Ask a model the questions of a store, and keep every step.

    The model's key is read from the environment (OPENAI_API_KEY). Its server is checked first, as by 'preflight'. The
    run can be stopped at any time and resumed. Exit code 1 while any question ends in an error.
    """
    from jrdb_avr.agent.simulated.knobs import profile_of
    from jrdb_avr.engine.report.formats import filled

    runs = [options] if matrix is None else matrix_runs(matrix, click.get_current_context(), options)
    runs = [_checked(run) for run in runs]
    _check_names(runs)
    epochs = [epoch for run in runs for epoch in _epochs(**run)]
    results: list[RunResult] = []
    for epoch in epochs:
        try:
            results.append(_evaluate(store, **epoch))
        except AvrError as error:
            if matrix is None:
                raise
            # One server that is away leaves the others their runs.
            note(f"jrdb-avr: {epoch['method']}, {epoch['model']}: {error}")
    title = "Run" if len(epochs) == 1 else "Runs"
    if any(run.synthetic for run in results):
        simulated = any(profile_of(run["model"]) is not None for run in runs)
        title += f" (synthetic: the {'simulated model' if simulated else 'sample world'})"
    rows = filled([run.row() for run in results])
    print_rows(rows, title=title, form=form)
    for run, row in zip(results, rows, strict=True):
        about = f"{run.run_id}: " if len(epochs) > 1 else ""
        for status, way, then in (
            ("invalid", "as invalid", ""),
            ("error", "in an error", "; run the same command with --resume to ask them again"),
        ):
            reason, times = run.commonest_reason(status)
            if times:
                ended = f"{row[status]} of {row['n']} questions ended {way}, {times} of them so: {reason[:300]}"
                note(f"{about}{ended}{then}")
    if len(results) < len(epochs) or any(row["error"] for row in rows):
        sys.exit(1)
    if not form:
        names = " ".join(run.run_id for run in results)
        scored = f"score --store {store.path} {names} && jrdb-avr report --store {store.path}"
        note(f"next: jrdb-avr {f'runs diff {names} --store {store.path}' if len(results) == 2 else scored}")


def _check_names(runs: Sequence[Mapping[str, Any]]) -> None:
    """Raise UsageError where two runs would have the same name: the second would fail once the first was made."""
    from jrdb_avr.engine.run.evaluate import default_run_id, player_of

    players = [(run["run_id"], player_of(run["method"], run["policy"]), run["model"]) for run in runs]
    names = [default_run_id(player, model) if name is None else name for name, player, model in players]
    for name in names:
        if names.count(name) > 1:
            raise click.UsageError(f"two runs are named {name}: give each a [[run]] of its own, with a run-id")


def _checked(run: dict[str, Any]) -> dict[str, Any]:
    """The options of a run with its price. Raises UsageError where they contradict each other."""
    from jrdb_avr.agent.model.prices import read_price
    from jrdb_avr.engine.run.evaluate import check_arguments

    for name in ("method", "model"):
        if run[name] is None:
            raise click.UsageError(f"Missing option '--{name}'.")
    if run["model"] != NO_MODEL:
        check_address(run["model"], run["base_url"])
    prices, max_cost = run.pop("prices"), run.pop("max_cost")
    price = None if prices is None else read_price(prices, run["model"])
    try:
        checked = {name: run[name] for name in _CHECKED}
        check_arguments(**checked, noisy=bool(run["noise"]))
        return run | {"options": replace(run["options"], price=price, max_cost=max_cost)}
    except InputError as error:
        raise click.UsageError(str(error)) from None


def _epochs(epochs: int | None, **run: Any) -> list[dict[str, Any]]:
    """The options of each epoch of a run."""
    if epochs is None:
        return [run]
    if epochs > 1 and run["options"].temperature == 0 and run["base_url"] is not None:
        note("warning: at temperature 0 epochs repeat each other: give --temperature")
    return [run | {"epoch": epoch} for epoch in range(1, epochs + 1)]


def _evaluate(
    store: Store, picked: str | None, noise: tuple[str, ...], scores: bool | None, **options: Any
) -> RunResult:
    from jrdb_avr.agent.simulated.knobs import PERFECT, parse, profile_of
    from jrdb_avr.engine.run.evaluate import evaluate
    from jrdb_avr.engine.run.selection import QuestionSelection

    marker = parse(noise, profile_of(options["model"]) or PERFECT) if noise else None
    names = {
        name: options.pop(name) for name in ("families", "templates", "sequences", "per_template", "limit", "seed")
    }
    questions = QuestionSelection(questions=() if picked is None else _ids(picked), **names)
    terminal = sys.stderr.isatty()
    latest, printed = "", 0.0

    def report(score: LiveScore) -> None:
        nonlocal latest, printed
        latest = str(score)
        if not terminal and time.monotonic() >= printed + LOG_EVERY_S:
            printed = time.monotonic()
            note(f"so far: {latest}")

    live_scores = report if scores or (scores is None and terminal) else None
    with progress_bar(lambda: latest) as progress:
        return evaluate(
            store, questions=questions, marker=marker, progress=progress, live_scores=live_scores, **options
        )


def _ids(picked: str) -> tuple[str, ...]:
    """Ids of the option `--questions`: a file's lines, or the text's parts."""
    text = picked
    if not re.fullmatch(r"[0-9a-f]{16}(,[0-9a-f]{16})*,?", picked):
        try:
            path = Path(picked)
            text = path.read_text(encoding="utf-8") if path.is_file() else picked
        except (OSError, ValueError) as error:
            raise InputError(f"--questions: cannot read {picked[:80]}: {error}", file=picked) from None
    ids = [part.strip() for part in re.split(r"[,\n]", text) if part.strip()]
    if not ids:
        raise InputError("--questions names no question", field="questions")
    return tuple(dict.fromkeys(ids))
