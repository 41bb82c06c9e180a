"""A run's method in a process of its own that sees the public files alone.

    python -m jrdb_avr.engine.run.isolated FD    # started by `confine`; the job as JSON on standard input

The process opens a folder with copies of the public tables, the panoramas, the method's file, the file of the run's
finished calls, and what Python needs; no other file of the machine. It holds bench, client and method. Finished
questions come back as lines of JSON, which the run's own process checks and writes into the journal: whatever the
method does, it can but answer.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, Any, Final

import msgspec

from jrdb_avr.agent.beliefs.world_model import WorldModel
from jrdb_avr.agent.model.options import Options
from jrdb_avr.agent.reference.method import Policy
from jrdb_avr.engine.run.answering import answer_all
from jrdb_avr.engine.run.bench import Bench, root_of_images
from jrdb_avr.engine.run.confine import DEVICES, check_confinable, program_files
from jrdb_avr.engine.run.endpoint import Endpoint, convention_path
from jrdb_avr.engine.run.journal import Finished, check_entry, unanswered
from jrdb_avr.engine.run.methods import WORLD_METHODS, is_custom, load_custom_method, make_method
from jrdb_avr.engine.run.opaque import key_path, opaque_names
from jrdb_avr.engine.run.run import Run
from jrdb_avr.queries.beliefs.graph import WorldGraph
from jrdb_avr.queries.questions import read_questions
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, AvrWarning, EndpointError, InputError, RunStoppedError, StoreError
from jrdb_avr.schema.method import Question

_ERRORS: Final = {kind.__name__: kind for kind in (InputError, StoreError, EndpointError, RunStoppedError)}
_LONGEST: Final = 1 << 28
"""Bytes of a message; a question's steps are texts of some megabytes at most."""


class Job(msgspec.Struct, frozen=True):
    """The job of the isolated process: the arguments of `evaluate` that it needs."""

    run_id: str
    method: str
    policy: Policy | None
    history: int | None
    player: str
    model: str
    url: str | None
    options: Options
    strict: bool
    concurrency: int
    images: str | None
    opaque: bool
    calls: str


class _Ready(msgspec.Struct, frozen=True, tag="ready"):
    name: str
    settings: dict[str, Any]
    endpoint: dict[str, Any]
    warnings: list[str]


class _Done(msgspec.Struct, frozen=True, tag="done"):
    entry: Finished


class _End(msgspec.Struct, frozen=True, tag="end"):
    changed: str
    counts: dict[str, int] | None


class _Failed(msgspec.Struct, frozen=True, tag="failed"):
    kind: str
    text: str


_MESSAGE: Final = msgspec.json.Decoder(_Ready | _Done | _End | _Failed)


# -- the run's own process --------------------------------------------------------------------------------------------


class IsolatedMethod(contextlib.ExitStack):
    """A method in its process, from its start until the block ends.

    `name`, `settings`: the method's; `endpoint_settings`, `warnings`: what `Endpoint` has of them, if there is a model.
    After `answer_all`: `changed`, as of `Endpoint`; `counts` of its world model, None without.

    Raises StoreError where this system cannot isolate a process or prepare it, and what the process cannot do.
    """

    def __init__(self, store: Store, job: Job) -> None:
        super().__init__()
        check_confinable()
        self.changed = ""
        self.counts: dict[str, int] | None = None
        try:
            self._start(store, _absolute(job))
            ready = self._next()
            if not isinstance(ready, _Ready):
                raise _ended()
        except OSError as error:
            self.close()
            raise StoreError(f"--isolated: the process cannot be prepared: {error}") from None
        except BaseException:
            self.close()
            raise
        self.name, self.settings = ready.name, ready.settings
        self.endpoint_settings, self.warnings = ready.endpoint, ready.warnings

    def _start(self, store: Store, job: Job) -> None:
        folder = Path(self.enter_context(tempfile.TemporaryDirectory(prefix="jrdb-avr-")))
        _copy_public(store, folder / "store", job)
        calls, private = Path(job.calls), folder / "own"
        calls.touch()
        private.mkdir()
        program = {
            "read": [*program_files(_hidden(store, job)), str(folder / "store"), *_pictures(job.images)],
            "write": [str(calls), str(private), *DEVICES],
            "run": [sys.executable, "-m", "jrdb_avr.engine.run.isolated"],
        }
        if is_custom(job.method) and (file := Path(job.method.rpartition(":")[0])).is_file():
            program["read"].append(str(file.resolve()))
        # The store's place is nobody's business there.
        environment = {name: value for name, value in os.environ.items() if not name.startswith("JRDB_")}
        environment |= {
            "HOME": str(private),
            "TMPDIR": str(private),
            "PYTHONPATH": os.pathsep.join(str(Path(path).absolute()) for path in sys.path if path),
        }
        receiving, sending = os.pipe()
        self._messages: IO[bytes] = self.enter_context(os.fdopen(receiving, "rb"))
        program["run"].append(str(sending))
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "jrdb_avr.engine.run.confine", msgspec.json.encode(program).decode()],
                stdin=subprocess.PIPE,
                # What the method prints is no result of the command.
                stdout=2,
                pass_fds=(sending,),
                cwd=private,
                env=environment,
                # Ctrl-C ends the run, which ends this process.
                start_new_session=True,
            )
        finally:
            os.close(sending)
        self.callback(self._kill)
        self._send(job)

    def answer_all(self, run: Run, questions: Sequence[Question], advance: Callable[[int], None]) -> None:
        """Have the questions answered that the run lacks, or holds as errors. Raises as `answering.answer_all`."""
        due = {question.question_id: question for question in unanswered(questions, run.finished)}
        advance(len(questions) - len(due))
        self._send(list(due))
        while not isinstance(message := self._next(), _End):
            if not isinstance(message, _Done) or message.entry.question_id not in due:
                raise _ended()
            try:
                check_entry(message.entry, due.pop(message.entry.question_id))
            except (ValueError, TypeError, msgspec.MsgspecError):
                raise _ended() from None
            run.append(message.entry)
            advance(1)
        if due:
            raise _ended()
        self.changed, self.counts = message.changed, message.counts

    def _send(self, message: Job | list[str]) -> None:
        assert self._process.stdin is not None, "stdin is a pipe"
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(msgspec.json.encode(message) + b"\n")
            self._process.stdin.flush()

    def _next(self) -> _Ready | _Done | _End | _Failed:
        """The next message. Raises the error that it tells, StoreError where the process has ended."""
        try:
            message: _Ready | _Done | _End | _Failed = _MESSAGE.decode(self._messages.readline(_LONGEST))
        except (msgspec.DecodeError, UnicodeDecodeError):
            raise _ended() from None
        if isinstance(message, _Failed):
            raise _ERRORS.get(message.kind, StoreError)(message.text)
        return message

    def _kill(self) -> None:
        # All that it had to say is in the journal.
        # It leads a session of its own: what the method started ends with it.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        with contextlib.suppress(OSError), self._process:
            pass


def _absolute(job: Job) -> Job:
    """The job with paths that hold in any folder."""
    where, _, made = job.method.rpartition(":")
    return msgspec.structs.replace(
        job,
        method=f"{Path(where).absolute()}:{made}" if where.endswith(".py") else job.method,
        images=None if job.images is None else str(Path(job.images).absolute()),
        calls=str(Path(job.calls).absolute()),
    )


def _ended() -> StoreError:
    return StoreError("the isolated process has ended, or sent what is no answer: run again with --resume")


def _copy_public(store: Store, folder: Path, job: Job) -> None:
    """Copy what the process reads of a store into a folder."""
    public = [store.question_path(name) for name in ("questions", "sequences")]
    if job.opaque:
        # The key is made where there is none yet.
        opaque_names(store, ())
        public.append(key_path(store))
    for path in (*public, convention_path(store, job.model)):
        if path.exists():
            place = folder / path.relative_to(store.path)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, place)


def _hidden(store: Store, job: Job) -> list[Path]:
    """Folders of which nothing may be readable: the store, and the root that the panoramas lie in."""
    found = [store.path.resolve()]
    if job.images is not None:
        found.append(root_of_images(job.images))
    return found


def _pictures(images: str | None) -> list[str]:
    """The folder of panoramas, and the folders of sequences that are links."""
    if images is None:
        return []
    root = Path(images).resolve()
    return [str(root), *(str(path.resolve()) for path in root.iterdir() if path.is_symlink())]


# -- the isolated process ---------------------------------------------------------------------------------------------


class _Sender:
    """Takes finished questions in place of a journal, and sends them."""

    def __init__(self, messages: IO[bytes]) -> None:
        self._messages = messages
        self.finished: dict[str, Finished] = {}

    def send(self, message: msgspec.Struct) -> None:
        self._messages.write(msgspec.json.encode(message) + b"\n")
        self._messages.flush()

    def append(self, entry: Finished) -> None:
        self.send(_Done(entry))


def _work(lines: IO[bytes], sender: _Sender) -> None:
    job = msgspec.json.decode(_line(lines), type=Job)
    store = Store(Path.cwd().parent / "store")
    endpoint = None
    if job.url is not None:
        endpoint = Endpoint(store, job.model, job.url, job.options, Path(job.calls), job.player, job.strict)
    with _world(job) as world:
        if is_custom(job.method):
            runner: Any = load_custom_method(job.method, None if endpoint is None else endpoint.client)
        else:
            assert endpoint is not None, "built-in methods need a model"
            runner = make_method(job.method, endpoint.client, endpoint.convention, world, job.policy, job.history)
        settings, warned = ({}, []) if endpoint is None else (endpoint.settings, endpoint.warnings)
        sender.send(_Ready(runner.name, runner.settings(), settings, warned))
        wanted = set(msgspec.json.decode(_line(lines), type=list[str]))
        threading.Thread(target=_end_with, args=(lines,), daemon=True).start()
        with warnings.catch_warnings():
            # The run's own process has warned of questions without panoramas.
            warnings.simplefilter("ignore", AvrWarning)
            bench = Bench(store, [q for q in read_questions(store) if q.question_id in wanted], job.images, job.opaque)
        see = bench.observer
        answer_all(runner, bench.questions, bench.sequences, see, see.stored, sender, job.concurrency)
        changed = "" if endpoint is None else endpoint.changed()
        sender.send(_End(changed, None if world is None else dict(world.graph.counts)))


def _line(lines: IO[bytes]) -> bytes:
    """A line of the run's process; ends this one where that was killed."""
    return lines.readline() or os._exit(1)


def _end_with(lines: IO[bytes]) -> None:
    """End this process once the run's process is gone, even killed: a method may never come to an end."""
    lines.read()
    os._exit(1)


@contextlib.contextmanager
def _world(job: Job) -> Iterator[WorldModel | None]:
    """A world model in memory; its record goes into the journal, and from there into any graph."""
    if job.method not in WORLD_METHODS:
        yield None
        return
    with WorldGraph.memory() as world:
        yield WorldModel(world, job.run_id)


def work() -> None:
    """Entry point of the process."""
    with os.fdopen(int(sys.argv[1]), "wb") as messages, contextlib.suppress(BrokenPipeError):
        sender = _Sender(messages)
        try:
            _work(sys.stdin.buffer, sender)
        except AvrError as error:
            sender.send(_Failed(type(error).__name__, str(error)))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        work()
    # Threads of the method may be at work still.
    os._exit(0)
