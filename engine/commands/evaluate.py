"""`jrdb-avr evaluate`: run a method on the questions."""

from __future__ import annotations

import contextlib
import datetime
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from jrdb_avr.agent.model.options import Options
from jrdb_avr.engine.commands._endpoint import endpoint_options, need_address
from jrdb_avr.engine.console import json_option, note, print_json, print_rows, progress, store_option
from jrdb_avr.engine.run.methods import METHODS, WORLD_METHODS, is_own, own_method

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.world_model import World
    from jrdb_avr.agent.simulated.noise import Knobs
    from jrdb_avr.engine.run.endpoint import Endpoint
    from jrdb_avr.engine.run.evaluate import Finished, Journal
    from jrdb_avr.engine.run.live_scores import Standing
    from jrdb_avr.queries.runs import RunManifest
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.method import ConfigurableMethod, Question

LOG_EVERY_S: Final = 30.0
"""Between two lines of running scores where there is no bar to print them beside."""

_EXAMPLE: Final = """\b
Examples:
  jrdb-avr evaluate --store S --method react --model marker
  jrdb-avr evaluate --store S --method agent --model Qwen3-VL-8B --base-url http://localhost:8000/v1
  jrdb-avr evaluate --store S --method agent --model marker --resume
\b
A machine without labels needs a folder with questions/questions.parquet and questions/sequences.parquet, and the
panoramas:
  jrdb-avr evaluate --store S --images DIR --method agent --world-db world.kuzu --model M --base-url URL
"""

NO_MODEL: Final = "none"


def _checked_name(ctx: click.Context, param: click.Parameter, value: str) -> str:
    if value not in METHODS and not is_own(value):
        raise click.BadParameter(f"{value!r} is none of {', '.join(METHODS)}, nor FILE.py:NAME or MODULE:NAME")
    return value


@click.command(epilog=_EXAMPLE)
@store_option
@click.option(
    "--method",
    "method_name",
    required=True,
    metavar="METHOD",
    callback=_checked_name,
    help=f"How questions are answered: {', '.join(METHODS)}; or one of your own, as FILE.py:NAME or MODULE:NAME.",
)
@click.option(
    "--model",
    required=True,
    help="Model id to ask for; 'marker' is the built-in reader of marks, 'none' for a method of your own without any.",
)
@click.option("--base-url", help="An OpenAI-compatible server, as http://localhost:8000/v1.")
@click.option("--run-id", help="Name of the run; METHOD-MODEL if left out.")
@click.option("--questions", "picked", help="Question ids with commas between, or a file with one id per line.")
@click.option("--limit", type=click.IntRange(1), help="Ask at most this many.")
@click.option(
    "--concurrency", type=click.IntRange(1, 64), default=16, show_default=True, help="Questions in flight at a time."
)
@click.option("--resume", is_flag=True, help="Finish a run that was stopped, and ask again what ended in an error.")
@click.option(
    "--images",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    help="Folder with one folder of panoramas per sequence; the store's own if left out.",
)
@click.option(
    "--world-db",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Graph file for the agent's world model, in place of the store's: for runs in parallel, or without labels.",
)
@click.option(
    "--marker",
    "knob_texts",
    multiple=True,
    metavar="KEY=VALUE",
    help="How imperfectly the marker model plays: wrong_box=0.1, wrong_attribute, malformed, refusal, truncated and "
    "thinking as shares, latency in seconds, seed. May be given several times.",
)
@click.option(
    "--scores/--no-scores",
    default=None,
    help="Scores so far, from a process of their own; beside the bar on a terminal, as lines if asked for elsewhere.",
)
@endpoint_options
@json_option
def command(
    store: Path,
    method_name: str,
    model: str,
    base_url: str | None,
    run_id: str | None,
    picked: str | None,
    limit: int | None,
    concurrency: int,
    resume: bool,
    images: Path | None,
    world_db: Path | None,
    knob_texts: tuple[str, ...],
    scores: bool | None,
    options: Options,
    as_json: bool,
) -> None:
    """Ask a model the questions of a store, and keep every step.

    The model's key is read from the environment (OPENAI_API_KEY). Its server is checked first, as by 'preflight'. The
    run can be stopped at any time and resumed. Exit code 1 while any question ends in an error.
    """
    from jrdb_avr.agent.simulated.noise import parse
    from jrdb_avr.engine.observe.observer import Observer
    from jrdb_avr.engine.run import evaluate as runs
    from jrdb_avr.engine.run.endpoint import MARKER, connect, serving
    from jrdb_avr.engine.run.resume import keep_terms
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.errors import StoreError

    if model == NO_MODEL and not is_own(method_name):
        raise click.UsageError(f"--model none: {method_name} asks a model")
    if model != NO_MODEL:
        need_address(model, base_url)
    if knob_texts and (model != MARKER or base_url is not None):
        raise click.UsageError("--marker sets how the built-in marker model plays: give it with --model marker alone")
    knobs = parse(knob_texts)
    if world_db is not None and method_name not in WORLD_METHODS:
        raise click.UsageError(f"--world-db: {method_name} has no world model")
    place = Store(store)
    run_id = run_id or default_run_id(method_name, model)
    folder = place.run_path(run_id)
    image_root = str(images) if images is not None else _image_root(place)
    questions = _questions(place, run_id, picked, limit, resume, image_root)
    sequences = runs.read_sequences(place)
    asked = {question.sequence for question in questions}
    observer = Observer(image_root, [info for name, info in sequences.items() if name in asked])
    with contextlib.ExitStack() as stack:
        journal = stack.enter_context(runs.Journal(folder / "journal.jsonl"))
        if journal.finished and not (folder / "run.json").exists():
            # Of another model, for all that is known.
            raise StoreError(f"{folder} holds answers and no run.json: delete it, or give another --run-id")
        world = stack.enter_context(_world(place, run_id, method_name, world_db, journal))
        endpoint = None
        if model != NO_MODEL:
            url = stack.enter_context(serving(model, base_url, folder / "marker.jsonl", knobs))
            endpoint = connect(place, model, url, options, folder / "calls.jsonl", method_name)
            for warning in endpoint.warnings:
                note(f"preflight: {warning}")
        method = _method(method_name, endpoint, world)
        keep_terms(place, _manifest(place, run_id, model, method, endpoint, questions, knobs))
        beside = stack.enter_context(_running_scores(place, run_id, scores))
        advance = stack.enter_context(progress(f"{method_name}, {model}", len(questions), beside))
        runs.ask_all(method, questions, sequences, observer, observer.stored, journal, concurrency, advance)
        entries = [journal.finished[question.question_id] for question in questions]
        runs.write_tables(place, run_id, entries)
        if endpoint is not None and (changed := endpoint.changed()):
            note(changed)
    rows = [_summary(run_id, entries)]
    if as_json:
        print_json(rows)
    else:
        print_rows(rows, title="Run (synthetic: the marker model)" if model == MARKER else "Run")
    if rows[0]["error"]:
        note(f"{rows[0]['error']} questions ended in an error: run the same command with --resume to ask them again")
        sys.exit(1)
    if not as_json:
        note(f"next: jrdb-avr score --store {store} {run_id} && jrdb-avr report --store {store}")


def default_run_id(method: str, model: str) -> str:
    """The name of a run that was given none: the same command names the same run, so it can be resumed."""
    own = f"{Path(method).name.replace('.py:', '-')}-{model}"
    return re.sub(r"[^A-Za-z0-9_-]+", "-", own).strip("-")[:80]


def _questions(
    place: Store, run_id: str, picked: str | None, limit: int | None, resume: bool, image_root: str | None
) -> list[Question]:
    """What is asked: the options' choice, or what the run that is resumed asked."""
    from jrdb_avr.engine.run import evaluate as runs
    from jrdb_avr.queries.runs import questions_hash, read_run_manifest
    from jrdb_avr.schema.errors import StoreError

    questions = runs.read_questions(place)
    exists = (place.run_path(run_id) / "run.json").exists()
    if exists and not resume:
        raise StoreError(f"run {run_id!r} exists: add --resume to finish it, or give another --run-id")
    if not exists or picked is not None or limit is not None:
        chosen = runs.choose(questions, None if picked is None else _ids(picked), limit)
        kept, without = runs.with_images(chosen, image_root)
        if without:
            note(
                f"{sum(without.values())} of {len(chosen)} questions are left out: {len(without)} sequences have no "
                f"panoramas ({', '.join(list(without)[:3])}{', ...' if len(without) > 3 else ''})"
            )
        if not kept:
            raise StoreError("no question is left to ask: choose questions of sequences with panoramas")
        if not exists:
            return kept
        questions = kept
    manifest = read_run_manifest(place, run_id)
    if manifest.questions_sha256 != questions_hash(place):
        raise StoreError(f"run {run_id!r} asked other questions than the store has now: give another --run-id")
    if (picked is not None or limit is not None) and manifest.question_ids != tuple(q.question_id for q in questions):
        raise StoreError(f"run {run_id!r} asked other questions: leave --questions and --limit out to resume it")
    return runs.choose(questions, manifest.question_ids, None)


def _ids(picked: str) -> list[str]:
    """Ids of the option `--questions`: a file's lines, or the text's parts."""
    from jrdb_avr.schema.errors import InputError

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
    return ids


def _image_root(place: Store) -> str | None:
    """Where the store says that the panoramas are. Raises StoreError where there is nothing that could say it."""
    from jrdb_avr.schema.errors import StoreError

    if place.question_path("questions").exists() and not (place.path / "store.json").exists():
        raise StoreError(f"{place.path} has no store.json, which names the panoramas: give their folder by --images")
    return place.manifest().image_root


@contextlib.contextmanager
def _world(
    place: Store, run_id: str, method_name: str, world_db: Path | None, journal: Journal
) -> Iterator[World | None]:
    """The run's world model, holding what the journal holds; None for a method without one."""
    from jrdb_avr.engine.run.evaluate import world_rows
    from jrdb_avr.engine.run.methods import open_world
    from jrdb_avr.schema.errors import LockedError, StoreError

    if method_name not in WORLD_METHODS:
        yield None
        return
    if world_db is None and not place.graph_path.exists():
        raise StoreError(
            f"{place.path} has no graph to hold the agent's world model: name one of its own by --world-db"
        )
    path = world_db or place.graph_path
    try:
        with open_world(path, run_id, world_rows(run_id, journal.finished.values())) as world:
            yield world
    except LockedError as error:
        holder = error.holder
        raise LockedError(
            f"{path} is in use by {holder}: wait for it, or give this run a graph of its own by --world-db FILE",
            holder=holder,
        ) from None


@contextlib.contextmanager
def _running_scores(place: Store, run_id: str, wanted: bool | None) -> Iterator[Callable[[], str]]:
    """Yields what stands beside the bar: the scores so far, once there are any."""
    from jrdb_avr.engine.run.live_scores import running_scores

    terminal = sys.stderr.isatty()
    latest, printed = "", 0.0

    def tell(standing: Standing) -> None:
        nonlocal latest, printed
        latest = str(standing)
        if not terminal and time.monotonic() >= printed + LOG_EVERY_S:
            printed = time.monotonic()
            note(f"so far: {latest}")

    if wanted is False or (wanted is None and not terminal):
        yield lambda: ""
        return
    with running_scores(place, run_id, tell):
        yield lambda: latest


def _method(name: str, endpoint: Endpoint | None, world: World | None) -> ConfigurableMethod:
    from jrdb_avr.engine.run.methods import make_method

    if is_own(name):
        return own_method(name, None if endpoint is None else endpoint.client)
    assert endpoint is not None, "built-in methods ask a model"
    return make_method(name, endpoint.client, endpoint.convention, world)


def _manifest(
    place: Store,
    run_id: str,
    model: str,
    method: ConfigurableMethod,
    endpoint: Endpoint | None,
    questions: list[Question],
    knobs: Knobs,
) -> RunManifest:
    from jrdb_avr.agent.simulated.noise import turned
    from jrdb_avr.engine.run.endpoint import MARKER
    from jrdb_avr.engine.run.evaluate import is_of_sample
    from jrdb_avr.queries.runs import RunManifest, questions_hash

    shown = turned(knobs)
    return RunManifest(
        run_id=run_id,
        method=method.name,
        model=model,
        questions_sha256=questions_hash(place),
        question_ids=tuple(question.question_id for question in questions),
        synthetic=model == MARKER or any(map(is_of_sample, questions)),
        settings={
            "method": method.settings(),
            **({} if endpoint is None else endpoint.settings),
            **({"marker": shown} if shown else {}),
        },
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )


def _summary(run_id: str, entries: list[Finished]) -> dict[str, Any]:
    rows = [entry.prediction for entry in entries]
    count = {status: sum(row["status"] == status for row in rows) for status in ("answered", "invalid", "error")}
    return {
        "run_id": run_id,
        "n": len(rows),
        **count,
        "model_calls": sum(row["n_model_calls"] for row in rows),
        "observations": sum(row["n_observations"] for row in rows),
        "prompt_tokens": sum(row["prompt_tokens"] for row in rows),
        "completion_tokens": sum(row["completion_tokens"] for row in rows),
        "seconds": round(sum(row["seconds"] for row in rows), 3),
    }
