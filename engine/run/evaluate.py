"""Evaluate a method: let it answer questions of a store, and record everything that it does.

    runs/<run_id>/                    manifest, journal and tables (`Run`)
    runs/<run_id>/calls.jsonl         the model calls that succeeded, so that a resumed run need not repeat them

If a run is killed, its journal keeps all finished questions. A resumed run answers the remaining questions, and answers
again the questions that ended in an error. The run reads only the public tables of questions and the panoramas.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.agent.model.prices import Price
from jrdb_avr.agent.preflight import CROPS
from jrdb_avr.agent.simulated.profiles import Errors, changed_errors, parse_errors, profile_of
from jrdb_avr.engine.run.answering import HOPELESS, answer_all
from jrdb_avr.engine.run.bench import Bench, find_images, with_grey_pictures
from jrdb_avr.engine.run.endpoint import Endpoint, declared, read_calibration, serving
from jrdb_avr.engine.run.given import GIVEN, GivenPictures
from jrdb_avr.engine.run.journal import Finished, world_rows
from jrdb_avr.engine.run.live_scores import LiveScore, report_scores
from jrdb_avr.engine.run.methods import (
    ADVISED,
    BASELINES,
    CHATS,
    LOOKING,
    METHODS,
    NO_MODEL,
    WORLD_METHODS,
    CustomMethod,
    is_custom,
    load_custom_method,
    make_method,
    open_world,
)
from jrdb_avr.engine.run.options import DEFAULTS, EvaluateOptions
from jrdb_avr.engine.run.run import Run, add_world_counts, key_fingerprint, run_questions
from jrdb_avr.queries.beliefs.graph import open_graph
from jrdb_avr.queries.beliefs.record import merge_world
from jrdb_avr.queries.display import Displayed, Progress, Tables, step_counter
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, QueryError, StoreError, warn
from jrdb_avr.schema.method import DIAGNOSTIC, ConfigurableMethod, Method

_SUMS: Final = ("n_model_calls", "n_observations", "prompt_tokens", "completion_tokens")
"""Columns of `predictions` that `RunResult.row` sums up."""
_TOKENS: Final = ("prompt_tokens", "completion_tokens")


@dataclass(frozen=True, repr=False)
class RunResult(Displayed):
    """Result of a run.

    Attributes:
        run_id: The id of the run.
        predictions: The table `predictions` of the run, one row per question.
        synthetic: Whether the run used the simulated model or the sample world.
        price: The price of the model, or None if it is unknown.
    """

    run_id: str
    predictions: pa.Table
    synthetic: bool
    price: Price | None = None

    def row(self) -> dict[str, Any]:
        """Return a summary of the run as one row.

        Returns:
            The run id, the number of all questions, the number of questions with each status, the total numbers of
            model calls, looks and tokens, the mean seconds per question, and the cost in dollars if the price is known.
        """
        status = self.predictions["status"].to_pylist()
        sums = {name.removeprefix("n_"): pc.sum(self.predictions[name]).as_py() or 0 for name in _SUMS}
        return {
            "run_id": self.run_id,
            "n": len(status),
            **{name: status.count(name) for name in ("answered", "invalid", "error")},
            **sums,
            "seconds_per_question": round(pc.mean(self.predictions["seconds"]).as_py() or 0.0, 3),
            **({} if self.price is None else {"dollars": round(self.price.cost(*(sums[name] for name in _TOKENS)), 6)}),
        }

    def commonest_reason(self, status: str) -> tuple[str, int]:
        """Return the most frequent reason among the questions with the given status.

        Args:
            status: "error" or "invalid".

        Returns:
            The reason, with the beginning of an unreadable reply, and the number of questions with this reason. ("", 0)
            if no question has the status.
        """
        ended = self.predictions.filter(pc.equal(self.predictions["status"], status))
        reasons = Counter(ended["reason"].to_pylist()).most_common(1)
        if not reasons:
            return "", 0
        reason, count = reasons[0]
        raw = ended["raw"][ended["reason"].to_pylist().index(reason)].as_py() if "JSON" in reason else ""
        return f"{reason}; a reply begins: {raw[:40]!a}" if raw else reason, count

    def _summary(self) -> str:
        row = self.row()
        return ", ".join([self.run_id, *(f"{row[name]} {name}" for name in ("answered", "invalid", "error"))])

    def _tables(self) -> Tables:
        return {"Run (synthetic)" if self.synthetic else "Run": [self.row()]}


def evaluate(
    store: Store | str | Path,
    method: str | Method,
    model: str = NO_MODEL,
    options: EvaluateOptions = DEFAULTS,
    *,
    progress: Progress | None = None,
    live_scores: Callable[[LiveScore], None] | None = None,
    usage: Callable[[str], None] | None = None,
) -> RunResult:
    """Let a method answer questions of a store, and record every step in `runs/<run_id>/`.

    A problem that does not stop the run is reported as an AvrWarning. If the run stops early, its tables have the
    questions that are finished.

    Args:
        store: The store, or its folder. A public store (`export --public`) is enough.
        method: A method object, a name of `METHODS`, or for your own method "FILE.py:NAME" or "MODULE:NAME".
        model: The id of the model at its server. "simulated" or "simulated:PROFILE" is the simulated model, and "none"
            means that the method uses no model.
        options: All further options.
        progress: Called at the start and after each finished question, with a title, the number of finished questions
            and the number of all questions.
        live_scores: Called from another thread with the scores so far, each time they change.
        usage: Called after each finished question with a text: the tokens since the call, their cost if the price is
            known, and the number of repeated requests.

    Returns:
        The result of the run, which has the run id and the table `predictions`.

    Raises:
        InputError: If an argument or option is wrong, or if options contradict each other.
        StoreError: If no question is selected, if no selected question has panoramas, or if the run exists and cannot
            be resumed.
        EndpointError: If the server of the model does not reply or fails a check that must pass.

    Example:
        evaluate("store", "react", "simulated", EvaluateOptions(selection=QuestionSelection(limit=20)))
    """
    store = Store.of(store)
    check_options(method, model, options)
    if method in DIAGNOSTIC and not store.question_path("answers").exists():
        raise StoreError(f"{method} is diagnostic: it needs the answers of the questions, which {store.path} lacks")
    playing, files, errors = options.method, options.run, _errors(model, options)
    simulated = declared(model, options.endpoint).simulated
    run_id = name_run(store, method, model, options)
    with contextlib.ExitStack() as stack:
        image_root = stack.enter_context(with_grey_pictures(store, find_images(store, files.images), simulated))
        chosen, selection = run_questions(store, run_id, options.selection, files.resume, image_root)
        bench = Bench(store, chosen, image_root, playing.opaque)
        run = stack.enter_context(Run(store, run_id))
        world = stack.enter_context(open_world(store.run_path(run_id), run_id)) if method in WORLD_METHODS else None
        endpoint = None if model == NO_MODEL else stack.enter_context(_connect(run, method, model, options, errors))
        if endpoint is not None and world is not None:
            world.repeats = endpoint.repeats
        player: ConfigurableMethod
        if not isinstance(method, str):
            player = CustomMethod(type(method).__name__, method)
        elif is_custom(method):
            player = load_custom_method(method, None if endpoint is None else endpoint.client)
        else:
            assert endpoint is not None, "built-in methods need a model: check_options"
            given = GivenPictures(store, bench.observer, method == "given-target") if method in GIVEN else None
            player = make_method(method, endpoint.client, endpoint.convention, world, playing, given)
        most = None if files.keep_going or endpoint is None else HOPELESS
        settings = {
            "method": player.settings(),
            **({} if endpoint is None else endpoint.settings),
            **({} if errors is None else {"simulated": changed_errors(errors)}),
            **({"opaque": key_fingerprint(store)} if playing.opaque else {}),
            **({} if files.epoch is None else {"epoch": files.epoch}),
            "unreadable_questions": most,
        }
        ids = [question.question_id for question in chosen]
        manifest = run.start(player.name, model, ids, settings, simulated or bench.synthetic, selection)
        if live_scores is not None:
            run.listeners.append(stack.enter_context(report_scores(store, run.finished.values(), live_scores)))
        if usage is not None and endpoint is not None:
            run.listeners.append(_usage_listener(endpoint, usage))
        advance = step_counter(progress, f"{_name(method)}, {model}", len(chosen))
        see = bench.observer
        answer_all(player, bench.questions, bench.sequences, see, see.stored, run, files.concurrency, advance, most)
        if world is not None:
            # The counts are written before the tables, because a run with all its predictions counts as complete.
            add_world_counts(store, run_id, world.graph.counts | {"cpu_ms": round(1000 * sum(world.graph.seconds))})
            _merge_world(run)
        predictions = run.finish()
        for line in [] if endpoint is None else endpoint.changed():
            warn(line)
    return RunResult(run_id, predictions, manifest.synthetic, options.endpoint.price)


def _usage_listener(endpoint: Endpoint, usage: Callable[[str], None]) -> Callable[[Finished], None]:
    """Return a listener of a run that reports its tokens, cost and repeated requests since the command began."""
    price, sums = endpoint.client.options.price, Counter[str]()

    def count(entry: Finished) -> None:
        sums.update({name: entry.prediction[name] for name in _TOKENS})
        cost = "" if price is None else f", {price.cost(*(sums[name] for name in _TOKENS)):.4g} dollars"
        usage(f"{sums.total():,} tokens{cost}, {endpoint.client.retries} retries")

    return count


def check_options(method: str | Method, model: str, options: EvaluateOptions) -> None:
    """Check that the arguments of `evaluate` do not contradict each other.

    Args:
        method: The argument `method` of `evaluate`.
        model: The argument `model` of `evaluate`.
        options: The argument `options` of `evaluate`.

    Raises:
        InputError: If two arguments or options contradict each other. The message names options as on the command line.
    """
    playing, endpoint, selection = options.method, options.endpoint, options.selection
    built_in = (*METHODS, *DIAGNOSTIC)
    if isinstance(method, str) and method not in built_in and not is_custom(method):
        raise InputError(f"{method!r} is not one of {', '.join(built_in)}, FILE.py:NAME or MODULE:NAME", field="method")
    if model == NO_MODEL and method in built_in:
        raise InputError(f"--model none: {method} needs a model", field="model")
    if playing.simulate and (profile_of(model) is None or endpoint.base_url is not None):
        raise InputError(
            "--simulate configures the simulated model: give it only with --model simulated, and without --base-url",
            field="simulate",
        )
    _errors(model, options)
    if playing.advice == "off" and method != ADVISED:
        raise InputError(f"--advice off works only with the method {ADVISED}", field="advice")
    if playing.looks is not None and method not in LOOKING:
        raise InputError(f"--looks works only with {', '.join(LOOKING)}", field="looks")
    if playing.history is not None and method not in CHATS:
        raise InputError(f"--history works only with {' and '.join(CHATS)}", field="history")
    if playing.prompts != "default" and method not in BASELINES:
        raise InputError(f"--prompts works only with {', '.join(BASELINES)}", field="prompts")
    if selection.shard is not None and not 1 <= selection.shard[0] <= selection.shard[1]:
        raise InputError("--shard I/N: I is a number from 1 to N", field="shard")


def name_run(store: Store, method: str | Method, model: str, options: EvaluateOptions) -> str:
    """Return the id of the run that `evaluate` would make if it were called with these arguments.

    Args:
        store: The store of the run.
        method: The argument `method` of `evaluate`.
        model: The argument `model` of `evaluate`.
        options: The argument `options` of `evaluate`.

    Returns:
        The id. If the run is a shard, the id ends in the shard. If the run has an epoch, the id ends in the epoch.
        Equal arguments always give an equal id, so that the run can be resumed.

    Raises:
        InputError: If the run id in the options is not a plain name.
    """
    run_id = options.run.run_id
    if run_id is None:
        advice = "-advice-off" if options.method.advice == "off" else ""
        prompts = "" if options.method.prompts == "default" else f"-{options.method.prompts}"
        looks = "" if options.method.looks is None else f"-looks-{options.method.looks}"
        run_id = default_run_id(_name(method) + advice + prompts + looks, model)
    # Checked before the suffixes are added, because an empty id would be valid with a suffix.
    store.run_path(run_id)
    shard, epoch = options.selection.shard, options.run.epoch
    run_id += "" if shard is None else f"-{shard[0]}of{shard[1]}"
    return run_id + ("" if epoch is None else f"-{epoch}")


def default_run_id(method: str, model: str) -> str:
    """Make a run id from the name of a method and the id of a model. The run id has at most 80 characters."""
    text = f"{Path(method).name.replace('.py:', '-')}-{model}"
    return re.sub(r"[^A-Za-z0-9_-]+", "-", text).strip("-")[:80]


def _name(method: str | Method) -> str:
    return method if isinstance(method, str) else method.name


def _errors(model: str, options: EvaluateOptions) -> Errors | None:
    """Return the errors of the simulated model, or None for any other model. The seed differs in each epoch."""
    if (profile := profile_of(model)) is None:
        return None
    errors = parse_errors(options.method.simulate, profile)
    return msgspec.structs.replace(errors, seed=errors.seed + (options.run.epoch or 1) - 1)


@contextlib.contextmanager
def _connect(
    run: Run, method: str | Method, model: str, options: EvaluateOptions, errors: Errors | None
) -> Iterator[Endpoint]:
    """Check the server of a model, issue a warning for each failed check, and yield the server."""
    calibration, calls = read_calibration(run.store, model), run.store.run_path(run.run_id) / "calls.jsonl"
    looks, endpoint, strict = options.method.looks or CROPS, options.endpoint, options.run.strict_preflight
    crops = min(looks, options.method.history or looks)
    with serving(model, endpoint.base_url, run.store, errors) as url:
        checked = Endpoint(calibration, model, url, endpoint, calls, _name(method), strict, crops)
        for line in checked.warnings:
            warn(f"preflight: {line}")
        yield checked


def _merge_world(run: Run) -> None:
    """Merge the world models of a finished run into the store's graph. Issue a warning if that is impossible."""
    store = run.store
    if not store.graph_path.exists():
        return
    try:
        with open_graph(store.graph_path) as graph:
            merge_world(graph, run.run_id, world_rows(run.run_id, run.finished))
    except (StoreError, QueryError) as error:
        text = f"the graph lacks the world models of {run.run_id} ({error})"
        warn(f"{text}: repeat the command with --resume to add them")
