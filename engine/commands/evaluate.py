"""`jrdb-avr evaluate`: let a method answer the questions of a store."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.engine.commands._declared import build, check_address, field_options, model_option
from jrdb_avr.engine.commands._matrix import matrix_runs
from jrdb_avr.engine.commands._next import scoring_steps
from jrdb_avr.engine.commands._options import FILE, form_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_rows, progress_bar
from jrdb_avr.engine.run.methods import METHODS, NO_MODEL
from jrdb_avr.engine.run.options import EvaluateOptions, MethodOptions, QuestionSelection, RunOptions
from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.queries.manifest import is_public
from jrdb_avr.schema.errors import AvrError, InputError, RunStoppedError
from jrdb_avr.schema.method import DIAGNOSTIC

if TYPE_CHECKING:
    from jrdb_avr.engine.run.effort import Total
    from jrdb_avr.engine.run.evaluate import RunResult
    from jrdb_avr.queries.store import Store


class _Evaluation(NamedTuple):
    method: str
    model: str
    options: EvaluateOptions


@click.command()
@store_option()
@click.option(
    "--method",
    metavar="METHOD",
    help=f"The method: {', '.join(METHODS)}; a diagnostic method: {', '.join(DIAGNOSTIC)}; or a custom method as "
    "FILE.py:NAME or MODULE:NAME.",
)
@model_option(" For a custom method without a model, give 'none'.", required=False)
@field_options(EndpointOptions)
@field_options(MethodOptions)
@field_options(QuestionSelection)
@field_options(RunOptions)
@click.option(
    "--scores/--no-scores",
    default=None,
    help="Whether to show scores during the run. A separate process computes them. Default: only on a terminal.",
)
@click.option(
    "--epochs",
    type=click.IntRange(1, 1000),
    metavar="N",
    help="Ask each question N times, in the runs RUN-1 to RUN-N. 'report --table epochs' prints pass@k of the runs.",
)
@click.option(
    "--matrix",
    type=FILE,
    help="TOML file that describes several runs, or 'paper' for the runs of the paper. With --model, only the runs of "
    "this model. docs/models.md shows the format.",
)
@click.option(
    "--plan",
    is_flag=True,
    help="Send nothing. Print the calls, pictures and tokens of each run with bounds, its hours at the rate of --tpm "
    "and --rpm, and its cost by --prices.",
)
@form_option
def command(store: Store, matrix: Path | None, plan: bool, form: RowFormat, **values: Any) -> None:
    """Let a method answer the questions of a store with a model, and record every step as a run.

    If the model's server needs a key, set the environment variable OPENAI_API_KEY to the key. Before the run, the
    command makes the checks of 'preflight'. A run can be stopped at any time, scored as it is, and continued with
    --resume. The progress shows the time left, tokens, dollars and repeated requests; without a terminal, as a line per
    minute. The exit code is 1 if a run fails, or if a question ends in an error.

    Examples:
      jrdb-avr evaluate --store S --method react --model simulated
      jrdb-avr evaluate --store S --method agent --model M --base-url http://localhost:8000/v1
      jrdb-avr evaluate --store S --method agent --model simulated --resume
      jrdb-avr evaluate --store S --matrix runs.toml --limit 100

    A public store (see 'export --public') is a store for machines that must not have the answers. It holds no answers
    and no labels. On a public store, --family, --template and --per-template do not work:

      jrdb-avr evaluate --store PUBLIC --method agent --model M --base-url URL
    """
    from jrdb_avr.agent.simulated.profiles import profile_of
    from jrdb_avr.engine.report.formats import filled
    from jrdb_avr.engine.run.effort import estimate

    runs = [values] if matrix is None else matrix_runs(matrix, click.get_current_context(), values)
    evaluations = [(_evaluation(run, plan), run["epochs"], run["scores"]) for run in runs]
    _check_names(store, [evaluation for evaluation, _, _ in evaluations])
    epochs = [(epoch, scores) for evaluation, count, scores in evaluations for epoch in _epochs(evaluation, count)]
    if plan:
        rows = [_plan_row(evaluation, *estimate(store, *evaluation), text=not form) for evaluation, _ in epochs]
        print_rows(filled(rows), title="Plan: expected totals (lower to upper bound)", form=form)
        note("synthetic: texts, and all figures of methods that choose their calls, are measured with simulated models")
        return
    results: list[RunResult] = []
    for evaluation, scores in epochs:
        try:
            results.append(_evaluate(store, evaluation, scores))
        except AvrError as error:
            if matrix is None:
                raise
            # The next run may use another server, so it is tried too.
            note(f"jrdb-avr: {evaluation.method}, {evaluation.model}: {error}")
    title = "Run" if len(epochs) == 1 else "Runs"
    if any(run.synthetic for run in results):
        simulated = any(run["simulated"] or profile_of(run["model"]) is not None for run in runs)
        title += f" (synthetic: the {'simulated model' if simulated else 'sample world'})"
    rows = filled([run.row() for run in results])
    if rows or form:
        print_rows(rows, title=title, form=form)
    for run, row in zip(results, rows, strict=True):
        _note_reasons(run, row, f"{run.run_id}: " if len(epochs) > 1 else "")
    if len(results) < len(epochs) or any(row["error"] for row in rows):
        sys.exit(1)
    if not form:
        ids = [run.run_id for run in results]
        names, steps = " ".join(ids), scoring_steps(store.path, *ids)
        if len(results) > 1 and all(evaluation.options.selection.shard for evaluation, _ in epochs):
            steps = f"jrdb-avr runs merge {names} --run-id RUN --store {store.path}"
        elif not is_public(store.path):
            report = f"{steps} && jrdb-avr report --store {store.path}"
            steps = f"jrdb-avr runs diff {names} --store {store.path}" if len(results) == 2 else report
        note(f"next: {steps}")


def _plan_row(evaluation: _Evaluation, questions: int, totals: Mapping[str, Total], text: bool) -> dict[str, Any]:
    """Return the estimate of a run as a row. Its totals are texts with bounds, or each bound has its own column."""
    row: dict[str, Any] = {"model": evaluation.model, "method": evaluation.method, "questions": questions}
    for name in ("calls", "pictures", "prompt_tokens", "reply_tokens", "hours", "dollars"):
        digits = 2 if name in ("hours", "dollars") else None
        values = [round(float(value), digits) for value in totals.get(name, ())]
        if not text:
            row |= zip_longest((name, f"{name}_low", f"{name}_high"), values)
        elif values:
            row[name] = "{:,} ({:,}–{:,})".format(*values)
    return row


def _note_reasons(run: RunResult, row: Mapping[str, Any], prefix: str) -> None:
    """Print the most frequent reason of invalid answers, and the most frequent reason of errors."""
    again = "; run the same command with --resume to ask them again"
    for status, ending, remedy in (("invalid", "as invalid", ""), ("error", "in an error", again)):
        reason, count = run.commonest_reason(status)
        if count:
            ended = f"{row[status]} of {row['n']} questions ended {ending}, {count} of them because: {reason[:300]}"
            note(f"{prefix}{ended}{remedy}")


def _check_names(store: Store, evaluations: Sequence[_Evaluation]) -> None:
    """Raise UsageError if two runs have the same name, because the second run would fail after the first."""
    from jrdb_avr.engine.run.evaluate import name_run

    names = [name_run(store, *evaluation) for evaluation in evaluations]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise click.UsageError(f"two runs are named {repeated[0]}: give each a [[run]] of its own, with a run-id")


def _evaluation(values: Mapping[str, Any], plan: bool) -> _Evaluation:
    """Return the arguments of `evaluate` for one run. Raise UsageError if options contradict each other.

    A plan needs no address of a server.
    """
    from jrdb_avr.agent.model.prices import read_price
    from jrdb_avr.engine.run.evaluate import check_options

    method, model = values["method"], values["model"]
    for name in ("method", "model"):
        if values[name] is None:
            raise click.UsageError(f"Missing option '--{name}'.")
    if model != NO_MODEL and not plan:
        check_address(model, values["base_url"])
    path = values["price"]
    price = None if path is None else read_price(to_utf8(read_input(path), path), path, model)
    filled = {**values, "price": price}
    options = EvaluateOptions(
        endpoint=build(EndpointOptions, filled),
        selection=build(QuestionSelection, {**filled, "questions": values["questions"] or ()}),
        method=build(MethodOptions, filled),
        run=build(RunOptions, filled),
    )
    try:
        check_options(method, model, options)
    except InputError as error:
        raise click.UsageError(str(error)) from None
    return _Evaluation(method, model, options)


def _epochs(evaluation: _Evaluation, count: int | None) -> list[_Evaluation]:
    """Return a copy of the evaluation for each epoch, or only the evaluation if `--epochs` is not given."""
    options = evaluation.options
    if count is None:
        return [evaluation]
    if count > 1 and options.endpoint.temperature == 0 and options.endpoint.base_url is not None:
        note("warning: at temperature 0, all epochs give the same answers: give --temperature")
    runs = [replace(options, run=replace(options.run, epoch=epoch)) for epoch in range(1, count + 1)]
    return [evaluation._replace(options=run) for run in runs]


def _evaluate(store: Store, evaluation: _Evaluation, scores: bool | None) -> RunResult:
    from jrdb_avr.engine.run.evaluate import evaluate, name_run
    from jrdb_avr.engine.run.overview import show_run
    from jrdb_avr.engine.run.run import has_manifest

    texts: dict[str, object] = {}
    show = scores or (scores is None and sys.stderr.isatty())
    # Another thread shows the texts. A copy does not change while the thread formats it.
    with progress_bar(lambda: "; ".join(map(str, list(texts.values())))) as progress:
        try:
            return evaluate(
                store,
                *evaluation,
                progress=progress,
                usage=lambda text: texts.update(usage=text),
                live_scores=(lambda score: texts.update(scores=score)) if show else None,
            )
        except (KeyboardInterrupt, RunStoppedError):
            run_id = name_run(store, *evaluation)
            state, steps = "no question was asked", ""
            if has_manifest(store, run_id):
                # The progress may lack a question that is on disk, because an interrupt may come at any moment.
                row = show_run(store, run_id)
                state = f"{row['answered'] + row['invalid']} of {row['n']} questions are finished"
                if row["answered"] + row["invalid"] + row["error"]:
                    steps = f"; or score what is finished: {scoring_steps(store.path, run_id)}"
            note(f"{run_id}: {state}; go on: the same command with --resume{steps}")
            raise
