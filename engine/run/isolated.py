"""A run's method in a process of its own that sees the public files alone.

    python -m jrdb_avr.engine.run.isolated FD    # started by `confine`; the job as JSON on standard input

The process opens the panoramas, the method's file, the file of the run's finished calls, and what Python needs; no
other file of the machine. It holds observer, client and method (`worker.py`). Questions go to it and finished ones come
back as lines of JSON, which the run's own process checks and writes into the journal: whatever the method does, it can
but answer.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import IO, Final

import msgspec

from jrdb_avr.engine.run.answering import answer_all
from jrdb_avr.engine.run.bench import Bench, root_of_images
from jrdb_avr.engine.run.confine import DEVICES, check_confinable, program_files
from jrdb_avr.engine.run.journal import Finished, check_entry, unanswered
from jrdb_avr.engine.run.methods import is_custom
from jrdb_avr.engine.run.run import Run
from jrdb_avr.engine.run.worker import Assignment, Done, End, Failed, Job, Message, Ready, Worker, read_message
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, StoreError

_LONGEST: Final = 1 << 28
"""Bytes of a message; a question's steps are texts of some megabytes at most."""


# -- the run's own process --------------------------------------------------------------------------------------------


class IsolatedMethod(contextlib.ExitStack):
    """A `Runner`: a method in its process, from its start until the block ends.

    Raises StoreError where this system cannot isolate a process or prepare it, and what the process cannot do.
    """

    def __init__(self, store: Store, job: Job) -> None:
        super().__init__()
        check_confinable()
        self.changed = ""
        self.counts: dict[str, int] | None = None
        try:
            self._start(store, job.absolute())
            ready = self._next()
            if not isinstance(ready, Ready):
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
        calls, private = Path(job.calls), folder / "own"
        calls.touch()
        private.mkdir()
        program = {
            "read": [*program_files(_hidden(store, job)), *_pictures(job.images)],
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

    def answer_all(self, run: Run, bench: Bench, advance: Callable[[int], None]) -> None:
        """Have the questions answered that the run lacks, or holds as errors. Raises as `answering.answer_all`."""
        due = {question.question_id: question for question in unanswered(bench.questions, run.finished)}
        advance(len(bench.questions) - len(due))
        self._send(Assignment(list(due.values()), bench.observed, bench.folders))
        while not isinstance(message := self._next(), End):
            if not isinstance(message, Done) or message.entry.question_id not in due:
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

    def _send(self, message: Job | Assignment) -> None:
        assert self._process.stdin is not None, "stdin is a pipe"
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(msgspec.json.encode(message) + b"\n")
            self._process.stdin.flush()

    def _next(self) -> Ready | Done | End:
        """The next message. Raises the error that it tells, StoreError where the process has ended."""
        try:
            return read_message(self._messages.readline(_LONGEST))
        except (msgspec.DecodeError, UnicodeDecodeError):
            raise _ended() from None

    def _kill(self) -> None:
        # All that it had to say is in the journal.
        # It leads a session of its own: what the method started ends with it.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        with contextlib.suppress(OSError), self._process:
            pass


def _ended() -> StoreError:
    return StoreError("the isolated process has ended, or sent what is no answer: run again with --resume")


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

    def send(self, message: Message) -> None:
        self._messages.write(msgspec.json.encode(message) + b"\n")
        self._messages.flush()

    def append(self, entry: Finished) -> None:
        self.send(Done(entry))


def _work(lines: IO[bytes], sender: _Sender) -> None:
    job = msgspec.json.decode(_line(lines), type=Job)
    with Worker(job) as worker:
        sender.send(worker.ready())
        assigned = msgspec.json.decode(_line(lines), type=Assignment)
        threading.Thread(target=_end_with, args=(lines,), daemon=True).start()
        see, sequences = assigned.observer(job.images), {info.sequence: info for info in assigned.sequences}
        answer_all(worker.method, assigned.questions, sequences, see, see.stored, sender, job.concurrency)
        sender.send(worker.end())


def _line(lines: IO[bytes]) -> bytes:
    """A line of the run's process; ends this one where that was killed."""
    return lines.readline() or os._exit(1)


def _end_with(lines: IO[bytes]) -> None:
    """End this process once the run's process is gone, even killed: a method may never come to an end."""
    lines.read()
    os._exit(1)


def work() -> None:
    """Entry point of the process."""
    with os.fdopen(int(sys.argv[1]), "wb") as messages, contextlib.suppress(BrokenPipeError):
        sender = _Sender(messages)
        try:
            _work(sys.stdin.buffer, sender)
        except AvrError as error:
            sender.send(Failed.of(error))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        work()
    # Threads of the method may be at work still.
    os._exit(0)
