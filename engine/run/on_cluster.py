"""A run's method on a Ray cluster: a worker on each processor, with an observer, a client and a world model of its own.

The run's own process hands out the questions, checks what comes back, and alone writes the run's files but for those of
finished calls, of which each worker has its own. A worker that dies is replaced, and its questions are asked again: one
at a time, so that the one that kills workers is found.
"""

from __future__ import annotations

import contextlib
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.agent.model.cache import Calls
from jrdb_avr.agent.model.client import check_cost
from jrdb_avr.engine.run.answering import answer_one, for_many_threads
from jrdb_avr.engine.run.bench import Bench
from jrdb_avr.engine.run.journal import check_entry, finished_entry, unanswered
from jrdb_avr.engine.run.run import Run
from jrdb_avr.engine.run.worker import Assignment, Done, End, Failed, Job, Ready, Worker, read_message
from jrdb_avr.queries.cluster import RETRIES, connected
from jrdb_avr.schema.errors import AvrError, RunStoppedError, StoreError
from jrdb_avr.schema.method import Prediction, Question

_DEATHS: Final = RETRIES + 1
"""Workers that a question, or a start, may cost before it is given up."""

_OF_ONE_WORKER: Final = ("preflight", "server_version")
"""Settings of an endpoint that a server may report to one worker and not to another."""


class _Actor:
    """A worker in a process of the cluster; its messages are bytes."""

    def begin(self, job: bytes, assignment: bytes) -> bytes:
        """Make the worker; once, before any question. Returns Ready or Failed."""
        own = msgspec.json.decode(job, type=Job)
        assigned = msgspec.json.decode(assignment, type=Assignment)
        # For the life of the process.
        contextlib.ExitStack().enter_context(for_many_threads())
        self._observer = assigned.observer(own.images)
        self._sequences = {info.sequence: info for info in assigned.sequences}
        try:
            self._worker = Worker(own)
        except AvrError as error:
            return msgspec.json.encode(Failed.of(error))
        return msgspec.json.encode(self._worker.ready())

    def answer(self, data: bytes) -> bytes:
        """Answer a question, in any thread. Returns Done or Failed."""
        question, see = msgspec.json.decode(data, type=Question), self._observer
        try:
            entry = answer_one(self._worker.method, question, self._sequences[question.sequence], see, see.stored)
        except RunStoppedError as error:
            return msgspec.json.encode(Failed.of(error))
        return msgspec.json.encode(self._worker.done(entry))

    def end(self) -> bytes:
        """Close the worker. Returns End."""
        with self._worker:
            return msgspec.json.encode(self._worker.end())


@dataclass(eq=False)
class _Seat:
    """The place of a worker: the actor that holds it, its questions to come, and those at work by the references of
    their results. None stands for the actor's beginning."""

    actor: Any = None
    file: str = ""
    ready: bool = False
    failures: int = 0
    waiting: deque[Question] = field(default_factory=deque)
    working: dict[Any, Question | None] = field(default_factory=dict)


class ClusterMethod(contextlib.ExitStack):
    """A `Runner`: a method on the cluster at an address, as of `queries.cluster`, until the block ends.

    Raises InputError where there is no cluster, StoreError where workers die again and again before their first
    question, and what a worker cannot do.
    """

    def __init__(self, address: str, job: Job, bench: Bench) -> None:
        super().__init__()
        self._options, job = job.options, job.absolute()
        self._calls = Path(job.calls)
        self._started = 0
        self._spent: dict[str, float] = {}
        if (price := job.options.price) is not None:
            self._spent[""] = price.cost(*Calls(self._calls).tokens())
        self._deaths: Counter[str] = Counter()
        self._seats = [_Seat()]
        self._shape: Any = None
        """What the first worker was, and all others must be."""
        self._finish: Callable[[Question, Done], None] | None = None
        self._stopped: RunStoppedError | None = None
        self.name = self.changed = ""
        self.settings: dict[str, Any] = {}
        self.endpoint_settings: dict[str, Any] = {}
        self.warnings: list[str] = []
        self.counts: dict[str, int] | None = None
        try:
            self._ray = self.enter_context(connected(address))
            self.callback(self._kill)
            processors = int(self._ray.cluster_resources().get("CPU", 1))
            self._most = max(1, min(processors, len(bench.questions), job.options.rpm or processors))
            self._job = msgspec.structs.replace(job, options=_share(job, self._most))
            self._actor = self._ray.remote(num_cpus=1, max_concurrency=job.concurrency + 1)(_Actor)
            self._assignment = self._ray.put(msgspec.json.encode(Assignment([], bench.observed, bench.folders)))
            self._start(self._seats[0])
            while not self._seats[0].ready:
                self._step()
        except BaseException:
            self.close()
            raise

    def answer_all(self, run: Run, bench: Bench, advance: Callable[[int], None]) -> None:
        """Have the questions answered that the run lacks, or holds as errors. Raises as `answering.answer_all`."""
        # A worker stays with a sequence, whose pictures it has in memory.
        due = sorted(unanswered(bench.questions, run.finished), key=lambda question: question.sequence)
        advance(len(bench.questions) - len(due))

        def finish(question: Question, message: Done) -> None:
            try:
                check_entry(message.entry, question)
            except (ValueError, TypeError, msgspec.MsgspecError):
                raise _no_answer() from None
            run.append(message.entry)
            advance(1)

        self._finish = finish
        self._seats += [_Seat() for _ in range(min(self._most, len(due)) - 1)]
        size = -(-len(due) // len(self._seats))
        for number, seat in enumerate(self._seats):
            seat.waiting.extend(due[number * size : (number + 1) * size])
            if seat.actor is None:
                self._start(seat)
        while True:
            for seat in self._seats:
                self._fill(seat)
            if not any(question is not None for seat in self._seats for question in seat.working.values()) and (
                self._stopped is not None or not any(seat.waiting for seat in self._seats)
            ):
                break
            self._step()
        if self._stopped is not None:
            raise self._stopped
        self._end()

    def _start(self, seat: _Seat) -> None:
        """Put a new actor into a seat; its calls go into a file that no other process writes to."""
        self._started += 1
        seat.file = str(self._calls.with_name(f"{self._calls.stem}-{self._started}{self._calls.suffix}"))
        seat.ready, seat.actor = False, self._actor.remote()
        job = msgspec.json.encode(msgspec.structs.replace(self._job, calls=seat.file))
        seat.working = {seat.actor.begin.remote(job, self._assignment): None}

    def _fill(self, seat: _Seat) -> None:
        """Hand questions to a seat's actor, as many as it may work on at a time."""
        while seat.ready and self._stopped is None:
            # Whoever has none left helps where most are left, from the end.
            part = seat.waiting or max((other.waiting for other in self._seats), key=len)
            if not part:
                return
            question = part[0] if part is seat.waiting else part[-1]
            at_work = [own for own in seat.working.values() if own is not None]
            alone = any(own.question_id in self._deaths for own in (question, *at_work))
            if len(at_work) >= (1 if alone else self._job.concurrency):
                return
            try:
                check_cost(sum(self._spent.values()), self._options.max_cost)
            except RunStoppedError as error:
                self._stopped = error
                return
            part.popleft() if part is seat.waiting else part.pop()
            seat.working[seat.actor.answer.remote(msgspec.json.encode(question))] = question

    def _step(self) -> None:
        """Wait for a result, and take all that are there."""
        waited = [result for seat in self._seats for result in seat.working]
        self._ray.wait(waited, num_returns=1)
        there, _ = self._ray.wait(waited, num_returns=len(waited), timeout=0)
        for result in there:
            for seat in self._seats:
                if result in seat.working and not self._take(seat, result):
                    self._replace(seat)

    def _take(self, seat: _Seat, result: Any) -> bool:
        """Take a result that is there; whether its actor lived to give it. Raises what a worker could not do."""
        try:
            message = read_message(self._ray.get(result))
        except RunStoppedError as error:
            if seat.working[result] is None:
                raise
            self._stopped = error
        except (msgspec.DecodeError, UnicodeDecodeError):
            raise _no_answer() from None
        except self._ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except self._ray.exceptions.RayError:
            return False
        else:
            match message, seat.working[result]:
                case Ready(), None:
                    self._check(message)
                    seat.ready, seat.failures = True, 0
                    self._spent[seat.file] = message.spent
                case Done(), Question() as question:
                    assert self._finish is not None, "questions are handed out by answer_all"
                    self._spent[seat.file] = max(message.spent, self._spent.get(seat.file, 0.0))
                    self._finish(question, message)
                case _:
                    raise _no_answer()
        del seat.working[result]
        return True

    def _replace(self, seat: _Seat) -> None:
        """Start a new worker in place of one that died, and hand it the questions that were being answered."""
        self._kill_actor(seat)
        for result in list(seat.working):
            # Some had ended before.
            if self._take(seat, result):
                continue
            question = seat.working.pop(result)
            if question is None:
                seat.failures += 1
                if seat.failures == _DEATHS:
                    raise StoreError(f"workers of the cluster died {_DEATHS} times before a question (out of memory?)")
                continue
            self._deaths[question.question_id] += 1
            if self._deaths[question.question_id] == _DEATHS:
                reason = f"its worker on the cluster died {_DEATHS} times (out of memory?)"
                assert self._finish is not None, "questions are handed out by answer_all"
                self._finish(question, Done(finished_entry(question, Prediction("error", reason=reason), [], [], 0.0)))
            else:
                seat.waiting.appendleft(question)
        self._start(seat)

    def _check(self, ready: Ready) -> None:
        """Keep what the first worker is; raise StoreError where another one is not the same."""
        if ready.endpoint:
            # The whole run's limits, not this worker's share of them.
            ready.endpoint["endpoint"] |= {"rpm": self._options.rpm, "tpm": self._options.tpm}
        if self._shape is None:
            self._shape, self.name, self.settings = _shape(ready), ready.name, ready.settings
            self.endpoint_settings, self.warnings = ready.endpoint, ready.warnings
        elif _shape(ready) != self._shape:
            raise StoreError("workers of the cluster differ in the method's settings or in what the server reports")

    def _end(self) -> None:
        results = [seat.actor.end.remote() for seat in self._seats if seat.ready]
        counts: Counter[str] = Counter()
        for result in results:
            # The answers of one that dies now are in the journal.
            with contextlib.suppress(self._ray.exceptions.RayError):
                message = read_message(self._ray.get(result))
                assert isinstance(message, End), "an actor ends with it"
                self.changed = self.changed or message.changed
                if message.counts is not None:
                    counts.update(message.counts)
                    self.counts = dict(counts)

    def _kill(self) -> None:
        for seat in self._seats:
            self._kill_actor(seat)

    def _kill_actor(self, seat: _Seat) -> None:
        if seat.actor is not None:
            with contextlib.suppress(Exception):
                self._ray.kill(seat.actor)


def _share(job: Job, workers: int) -> Any:
    """The request settings of one worker: the run's limits per minute, divided by the number of workers."""
    shares = {name: getattr(job.options, name) for name in ("rpm", "tpm")}
    return replace(job.options, **{name: most and max(1, most // workers) for name, most in shares.items()})


def _shape(ready: Ready) -> Any:
    """The method's name and settings, and those of the server, which must be the same in all workers of a run."""
    endpoint = {name: value for name, value in ready.endpoint.items() if name not in _OF_ONE_WORKER}
    if endpoint:
        endpoint["endpoint"] = endpoint["endpoint"] | {"base_url": ""}
    return ready.name, ready.settings, endpoint


def _no_answer() -> StoreError:
    return StoreError("a worker of the cluster sent what is no answer: run again with --resume")
