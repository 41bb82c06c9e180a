"""A method outside the run's own process: what it is sent, what it sends back, and what it holds there.

`isolated.py` starts one in a process that is shut in, `on_cluster.py` many on the machines of a Ray cluster. They are
sent public data alone: the job, the questions, and where these questions' pictures are. All messages are JSON.
"""

from __future__ import annotations

import contextlib
import functools
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.model.calibrate import Calibration
from jrdb_avr.agent.model.options import Options
from jrdb_avr.agent.reference.method import Policy
from jrdb_avr.agent.simulated.knobs import Knobs
from jrdb_avr.engine.observe.observer import Observer
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.endpoint import Endpoint, serving
from jrdb_avr.engine.run.journal import Finished
from jrdb_avr.engine.run.methods import NO_MODEL, WORLD_METHODS, is_custom, load_custom_method, make_method
from jrdb_avr.engine.run.run import Run
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.schema.errors import AvrError, EndpointError, InputError, RunStoppedError, StoreError
from jrdb_avr.schema.method import ConfigurableMethod, Prediction, Question, SequenceInfo, Task

_ERRORS: Final = {kind.__name__: kind for kind in (InputError, StoreError, EndpointError, RunStoppedError)}

_PER_WORLD: Final = 200
"""How many questions share a world model in memory."""


class Runner(Protocol):
    """A method that is ready to answer a run's questions, in this process or in others.

    `name`, `settings`: the method's; `endpoint_settings`, `warnings`: what `Endpoint` has of them, if there is a model.
    After `answer_all`: `changed`, as of `Endpoint`; `counts` of the world model, None without.
    """

    name: str
    settings: dict[str, Any]
    endpoint_settings: dict[str, Any]
    warnings: list[str]

    @property
    def changed(self) -> str: ...

    @property
    def counts(self) -> dict[str, int] | None: ...

    def answer_all(self, run: Run, bench: Bench, advance: Callable[[int], None]) -> None:
        """Have the bench's questions answered that the run lacks, or holds as errors.

        Raises RunStoppedError where no further question can be answered now.
        """


class Job(msgspec.Struct, frozen=True):
    """The arguments of `evaluate` that a worker needs. `url`: the server's; without it the simulated model is served
    beside the worker, with the `marker`'s knobs. `concurrency`: questions in flight. `calls`: file of finished calls.
    """

    run_id: str
    method: str
    policy: Policy | None
    history: int | None
    player: str
    model: str
    url: str | None
    marker: Knobs
    options: Options
    calibration: Calibration | None
    strict: bool
    concurrency: int
    images: str | None
    calls: str

    def absolute(self) -> Job:
        """The job with paths that hold in any folder."""
        where, _, made = self.method.rpartition(":")
        return msgspec.structs.replace(
            self,
            method=f"{Path(where).absolute()}:{made}" if where.endswith(".py") else self.method,
            images=self.images if self.images is None else str(Path(self.images).absolute()),
            calls=str(Path(self.calls).absolute()),
        )


class Assignment(msgspec.Struct, frozen=True):
    """Questions, the sequences that may be looked at, and the folders of those with opaque names."""

    questions: list[Question]
    sequences: list[SequenceInfo]
    folders: dict[str, str] | None

    def observer(self, images: str | None) -> Observer:
        """An observer of the sequences."""
        return Observer(images, self.sequences, folders=self.folders)


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """The method is made and its server checked, which has cost `spent` dollars."""

    name: str
    settings: dict[str, Any]
    endpoint: dict[str, Any]
    warnings: list[str]
    spent: float = 0.0


class Done(msgspec.Struct, frozen=True, tag="done"):
    """A finished question, and the dollars that the worker's calls have cost since it began."""

    entry: Finished
    spent: float = 0.0


class End(msgspec.Struct, frozen=True, tag="end"):
    """All questions are answered."""

    changed: str
    counts: dict[str, int] | None


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """An error of this package that ends the work."""

    kind: str
    text: str

    @classmethod
    def of(cls, error: AvrError) -> Failed:
        """The message that tells an error."""
        return cls(type(error).__name__, str(error))


Message = Ready | Done | End | Failed

_MESSAGE: Final = msgspec.json.Decoder(Message)


def read_message(data: bytes) -> Ready | Done | End:
    """Decode what a worker sent. Raises the error that it tells, msgspec.DecodeError or UnicodeDecodeError for anything
    else."""
    message: Message = _MESSAGE.decode(data)
    if isinstance(message, Failed):
        raise _ERRORS.get(message.kind, StoreError)(message.text)
    return message


class _World:
    """A world model in memory with its method, the questions begun in it, and those at work."""

    def __init__(self, make: Callable[[WorldModel], ConfigurableMethod], run_id: str) -> None:
        self.graph = WorldGraph.memory()
        self.method = make(WorldModel(self.graph, run_id))
        self.begun = self.working = 0


class _Worlds(contextlib.ExitStack):
    """A method that writes into world models in memory, a new one for every `_PER_WORLD` questions.

    The memory of one is limited, and is full after some 3,000 questions; none reads another one's beliefs.
    """

    def __init__(self, make: Callable[[WorldModel], ConfigurableMethod], run_id: str) -> None:
        super().__init__()
        self._make = functools.partial(_World, make, run_id)
        self._lock = threading.Lock()
        self._counts: list[Counter[str]] = []
        self._renew()
        self.callback(lambda: self._world.graph.close())
        self.name, self.settings = self._world.method.name, self._world.method.settings

    def _renew(self) -> None:
        self._world = self._make()
        self._counts.append(self._world.graph.counts)

    def answer(self, task: Task) -> Prediction:
        with self._lock:
            if self._world.begun == _PER_WORLD:
                if not self._world.working:
                    self._world.graph.close()
                self._renew()
            own = self._world
            own.begun, own.working = own.begun + 1, own.working + 1
        try:
            return own.method.answer(task)
        finally:
            with self._lock:
                own.working -= 1
                if own is not self._world and not own.working:
                    own.graph.close()

    def counts(self) -> dict[str, int]:
        """Statements that read and that wrote, in all worlds."""
        return {kind: sum(own[kind] for own in self._counts) for kind in ("reads", "writes")}


class Worker(contextlib.ExitStack):
    """A job's method with its client and its world model, which is in memory: its record goes into the journal, and
    from there into any graph.

    Raises InputError or EndpointError where the method cannot be made or its server not be used.
    """

    def __init__(self, job: Job) -> None:
        super().__init__()
        self._endpoint: Endpoint | None = None
        self._worlds: _Worlds | None = None
        try:
            if job.model != NO_MODEL:
                url = self.enter_context(serving(job.model, job.url, None, job.marker))
                self._endpoint = Endpoint(
                    job.calibration, job.model, url, job.options, Path(job.calls), job.player, job.strict
                )

            def make(world: WorldModel | None) -> ConfigurableMethod:
                return method_of(job.method, self._endpoint, world, job.policy, job.history)

            self.method = make(None) if job.method not in WORLD_METHODS else self._in_worlds(make, job.run_id)
        except BaseException:
            self.close()
            raise

    def _in_worlds(self, make: Callable[[WorldModel], ConfigurableMethod], run_id: str) -> ConfigurableMethod:
        self._worlds = self.enter_context(_Worlds(make, run_id))
        return self._worlds

    def ready(self) -> Ready:
        """The worker's first message: its method, and the server as it was checked."""
        known = self._endpoint
        settings, warned = ({}, []) if known is None else (known.settings, known.warnings)
        return Ready(self.method.name, self.method.settings(), settings, warned, self._spent())

    def done(self, entry: Finished) -> Done:
        """The message of a finished question."""
        return Done(entry, self._spent())

    def _spent(self) -> float:
        return 0.0 if self._endpoint is None else self._endpoint.client.spent

    def end(self) -> End:
        """The worker's last message: how its server changed, and counts of its world models."""
        changed = "" if self._endpoint is None else self._endpoint.changed()
        return End(changed, None if self._worlds is None else self._worlds.counts())


def method_of(
    method: str, endpoint: Endpoint | None, world: WorldModel | None, policy: Policy | None, history: int | None
) -> ConfigurableMethod:
    """The method of a name, built-in or custom. Raises InputError where a custom one cannot be made."""
    if is_custom(method):
        return load_custom_method(method, None if endpoint is None else endpoint.client)
    assert endpoint is not None, "built-in methods need a model: check_arguments"
    return make_method(method, endpoint.client, endpoint.convention, world, policy, history)
