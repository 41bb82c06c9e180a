"""Evaluate a method: have it answer a store's questions, with everything it does on record.

    runs/<run_id>/                    manifest, journal and tables (`Run`)
    runs/<run_id>/calls.jsonl         model calls that finished cleanly

A run killed at any point loses nothing that is in the journal; resumed, it answers what is not, and what ended in an
error. Only the public question tables and the panoramas are read.
"""

from __future__ import annotations

import contextlib
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.model.options import DEFAULTS, Options
from jrdb_avr.agent.model.prices import Price
from jrdb_avr.agent.reference.method import Policy
from jrdb_avr.agent.simulated.knobs import PERFECT, Knobs, profile_of, turned
from jrdb_avr.engine.run.answering import answer_all
from jrdb_avr.engine.run.bench import Bench, find_images
from jrdb_avr.engine.run.endpoint import Endpoint, read_calibration, serving
from jrdb_avr.engine.run.journal import world_rows
from jrdb_avr.engine.run.live_scores import LiveScore, report_scores
from jrdb_avr.engine.run.methods import (
    CHATS,
    DRIVABLE,
    METHODS,
    NO_MODEL,
    WORLD_METHODS,
    CustomMethod,
    default_policy,
    is_custom,
    load_custom_method,
    make_method,
    open_world,
)
from jrdb_avr.engine.run.opaque import key_fingerprint
from jrdb_avr.engine.run.run import Run, add_world_counts, run_questions
from jrdb_avr.engine.run.selection import QuestionSelection
from jrdb_avr.queries.display import Displayed, Progress, Tables, step_counter
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrWarning, InputError, LockedError, StoreError
from jrdb_avr.schema.method import ConfigurableMethod, Method

_SUMS: Final = ("n_model_calls", "n_observations", "prompt_tokens", "completion_tokens")
"""Columns of `predictions` that a run adds up."""
_TOKENS: Final = ("prompt_tokens", "completion_tokens")


@dataclass(frozen=True, repr=False)
class RunResult(Displayed):
    """A finished run: its id and its rows of `predictions`. `synthetic`: of the built-in model or the sample world.

    `price`: the model's, if it is known.
    """

    run_id: str
    predictions: pa.Table
    synthetic: bool
    price: Price | None = None

    def row(self) -> dict[str, Any]:
        """Counts by status, sums of calls, looks and tokens, mean seconds, and the dollars of the tokens if known."""
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
        """The commonest reason of a status, "error" or "invalid", and its number of questions; "" and 0 without any."""
        ended = self.predictions.filter(pc.equal(self.predictions["status"], status))
        found = Counter(ended["reason"].to_pylist()).most_common(1)
        return found[0] if found else ("", 0)

    def _summary(self) -> str:
        row = self.row()
        return ", ".join([self.run_id, *(f"{row[name]} {name}" for name in ("answered", "invalid", "error"))])

    def _tables(self) -> Tables:
        return {"Run (synthetic)" if self.synthetic else "Run": [self.row()]}


def evaluate(
    store: Store | str | Path,
    method: str | Method,
    model: str = NO_MODEL,
    *,
    base_url: str | None = None,
    options: Options = DEFAULTS,
    marker: Knobs | None = None,
    run_id: str | None = None,
    questions: QuestionSelection | Iterable[str] | None = None,
    limit: int | None = None,
    concurrency: int = 16,
    resume: bool = False,
    images: str | Path | None = None,
    world_db: Path | None = None,
    opaque: bool = False,
    policy: Policy | None = None,
    history: int | None = None,
    strict_preflight: bool = False,
    epoch: int | None = None,
    progress: Progress | None = None,
    live_scores: Callable[[LiveScore], None] | None = None,
) -> RunResult:
    """Have a method answer questions of a store, and record every step in `runs/<run_id>/`.

    `method`: a name of `METHODS`, a custom one as "FILE.py:NAME" or "MODULE:NAME", or a method itself. `model`: the
    server's id for it, at `base_url`; "simulated" or "simulated:PROFILE" is the built-in one, which reads marks, and
    `marker` stands in place of its profile's knobs. `questions`: ids, or a `QuestionSelection`; all without, at most
    `limit`. `resume` finishes a run, and enlarges it where more questions are selected. `images` and `world_db` stand
    in for the store's panoramas and graph. `opaque`: whether the method gets opaque names of sequences (`run.opaque`).
    `policy`: who chooses the looks of agent and agent-no-world: the harness, as "driven", if none is named. `history`:
    how many of the newest pictures react, or agent-no-world under "model", sends in each turn; all without.
    `strict_preflight`: whether a failed check of the server refuses the run; else it is a warning, and in the manifest.
    `epoch`: the number of the run among those that answer the same questions again, which ends its id; the simulated
    model's seed moves with it. `live_scores` is called from another thread with the scores so far.
    Problems that do not end the run are AvrWarnings.

    Raises InputError, StoreError or EndpointError before the first question where something does not fit.

        evaluate("store", "react", "simulated:noisy", limit=20)
    """
    store = Store.of(store)
    check_arguments(method, model, base_url, marker is not None, world_db, policy, history)
    simulated = profile_of(model)
    knobs = marker or simulated or PERFECT
    if epoch is not None:
        knobs = msgspec.structs.replace(knobs, seed=knobs.seed + epoch - 1)
    name = method if isinstance(method, str) else method.name
    player = player_of(name, policy)
    run_id = default_run_id(player, model) if run_id is None else run_id
    # Before the epoch, which would make a name of none.
    folder = store.run_path(run_id)
    if epoch is not None:
        run_id = f"{run_id}-{epoch}"
        folder = store.run_path(run_id)
    image_root = find_images(store, images)
    chosen, selection = run_questions(store, run_id, QuestionSelection.of(questions, limit), resume, image_root)
    bench = Bench(store, chosen, image_root, opaque)
    with contextlib.ExitStack() as stack:
        run = stack.enter_context(Run(store, run_id))
        calls = folder / "calls.jsonl"
        world = stack.enter_context(_world(store, run_id, name, world_db, run))
        endpoint = None
        if model != NO_MODEL:
            url = stack.enter_context(serving(model, base_url, folder / "marker.jsonl", knobs))
            calibration = read_calibration(store, model)
            endpoint = Endpoint(calibration, model, url, options, calls, player, strict_preflight)
            for line in endpoint.warnings:
                warnings.warn(f"preflight: {line}", AvrWarning, stacklevel=2)
        own = _make(method, endpoint, world, policy, history)
        manifest = run.start(
            own.name,
            model,
            [question.question_id for question in chosen],
            {
                "method": own.settings(),
                **({} if endpoint is None else endpoint.settings),
                **({"marker": turned(knobs)} if simulated is not None and knobs != PERFECT else {}),
                **({"opaque": key_fingerprint(store)} if opaque else {}),
                **({"epoch": epoch} if epoch is not None else {}),
            },
            simulated is not None or bench.synthetic,
            selection,
        )
        if live_scores is not None:
            run.listeners.append(stack.enter_context(report_scores(store, run.finished.values(), live_scores)))
        advance = step_counter(progress, f"{name}, {model}", len(chosen))
        see = bench.observer
        answer_all(own, bench.questions, bench.sequences, see, see.stored, run, concurrency, advance)
        if world is not None:
            # Before the tables: a run that has predictions is complete.
            add_world_counts(store, run_id, world.graph.counts)
        predictions = run.finish()
        if endpoint is not None and (changed := endpoint.changed()):
            warnings.warn(changed, AvrWarning, stacklevel=2)
    return RunResult(run_id, predictions, manifest.synthetic, options.price)


def _make(
    method: str | Method,
    endpoint: Endpoint | None,
    world: WorldModel | None,
    policy: Policy | None,
    history: int | None,
) -> ConfigurableMethod:
    """Return the method to run. Raise InputError if a custom method cannot be made."""
    if not isinstance(method, str):
        return CustomMethod(type(method).__name__, method)
    if is_custom(method):
        return load_custom_method(method, None if endpoint is None else endpoint.client)
    assert endpoint is not None, "built-in methods need a model: check_arguments"
    return make_method(method, endpoint.client, endpoint.convention, world, policy, history)


def check_arguments(
    method: str | Method,
    model: str,
    base_url: str | None,
    noisy: bool,
    world_db: Path | None,
    policy: Policy | None = None,
    history: int | None = None,
) -> None:
    """Raises InputError, in the words of the command's options, for arguments that contradict each other."""
    if isinstance(method, str) and method not in METHODS and not is_custom(method):
        raise InputError(f"{method!r} is none of {', '.join(METHODS)}, nor FILE.py:NAME or MODULE:NAME", field="method")
    if model == NO_MODEL and method in METHODS:
        raise InputError(f"--model none: {method} needs a model", field="model")
    if noisy and (profile_of(model) is None or base_url is not None):
        raise InputError(
            "--marker sets how the simulated model plays: give it with --model simulated or marker alone",
            field="marker",
        )
    chosen = policy or default_policy(method)
    if chosen != "model" and method not in DRIVABLE:
        raise InputError(f"--policy {policy}: of the methods {' and '.join(DRIVABLE)} only", field="policy")
    if history is not None and (method not in CHATS or chosen != "model"):
        raise InputError(f"--history: of the methods {' and '.join(CHATS)} with --policy model only", field="history")
    if world_db is not None and method not in WORLD_METHODS:
        raise InputError(f"--world-db: {method} has no world model", field="world_db")


def player_of(method: str, policy: Policy | None) -> str:
    """A method's name, with the policy behind it where that is not the method's own."""
    return method if policy in (None, default_policy(method)) else f"{method}-{policy}"


def default_run_id(method: str, model: str) -> str:
    """The name of a run without one: the same arguments name the same run, so that it can be resumed."""
    own = f"{Path(method).name.replace('.py:', '-')}-{model}"
    return re.sub(r"[^A-Za-z0-9_-]+", "-", own).strip("-")[:80]


@contextlib.contextmanager
def _world(store: Store, run_id: str, method: str, world_db: Path | None, run: Run) -> Iterator[WorldModel | None]:
    """The run's world model with the facts of the journal; None for a method without one."""
    if method not in WORLD_METHODS:
        yield None
        return
    if world_db is None and not store.graph_path.exists():
        raise StoreError(
            f"{store.path} has no graph to hold the agent's world model: name one of its own by --world-db"
        )
    path = world_db or store.graph_path
    try:
        with open_world(path, run_id, world_rows(run_id, run.finished)) as world:
            yield world
    except LockedError as error:
        raise LockedError(
            f"{path} is in use by {error.holder}: wait for it, or give this run a graph of its own by --world-db FILE",
            holder=error.holder,
        ) from None
