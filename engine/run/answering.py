"""Let a method answer questions, several at a time; each question gets a line of the journal."""

from __future__ import annotations

import contextlib
import queue
import sys
import sysconfig
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

from jrdb_avr.engine.run.journal import Finished, finished_entry, unanswered
from jrdb_avr.schema.beliefs import Write
from jrdb_avr.schema.errors import AvrError, RunStoppedError
from jrdb_avr.schema.method import (
    GetPanorama,
    Method,
    Observe,
    Prediction,
    Question,
    SequenceInfo,
    Step,
    Task,
)

R = TypeVar("R")

_STOP_S: Final = 1.0
"""Maximum seconds to wait for the threads of a run that ends early."""

_SWITCH_S: Final = 0.05
"""Seconds between switches of Python threads. Shorter turns cost time, because most threads wait for a server."""


_PACKAGE: Final = f"{__name__.partition('.')[0]}."
_LIBRARIES: Final = tuple({sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")})
"""Folders of code that belongs neither to this package nor to a method."""


class Entries(Protocol):
    """A store of finished questions, such as a journal."""

    @property
    def finished(self) -> Mapping[str, Finished]:
        """The finished questions by id."""

    def append(self, entry: Finished) -> None:
        """Add a finished question."""


class _Stopped(BaseException):
    """End of a run while a method works on a question. It is not an Exception, so that a method does not catch it."""


def answer_one(
    method: Method,
    question: Question,
    sequence: SequenceInfo,
    observe: Observe,
    panorama: GetPanorama,
    stopped: Callable[[], bool] = lambda: False,
) -> Finished:
    """Let a method answer one question.

    Args:
        method: The method.
        question: The question.
        sequence: The sequence of the question.
        observe: Returns crops.
        panorama: Returns panoramas.
        stopped: Returns whether the run has ended.

    Returns:
        The line of the journal. Its status is "error", with the reason, if the method raises or returns no prediction.

    Raises:
        RunStoppedError: No question can be answered now.
        KeyboardInterrupt: The user interrupts the main thread.
    """
    steps: list[Step] = []
    writes: list[Write] = []
    calls: Counter[str] = Counter()

    def counted(name: str, function: Callable[..., R]) -> Callable[..., R]:
        """Count the successful calls of a function; a call after the run has stopped ends the question."""

        def call(*values: Any, **named: Any) -> R:
            if stopped():
                raise _Stopped
            result = function(*values, **named)
            calls[name] += 1
            return result

        return call

    task = Task(
        question,
        sequence,
        counted("look", observe),
        counted("look", panorama),
        counted("step", lambda step: steps.append(step)),
        counted("write", lambda write: writes.append(write)),
    )
    started = time.perf_counter()
    try:
        finished = finished_entry(question, method.answer(task), steps, writes, time.perf_counter() - started)
    except (RunStoppedError, _Stopped):
        raise
    except BaseException as error:
        # Python interrupts only the main thread; in another thread the method raised it.
        if isinstance(error, KeyboardInterrupt) and threading.current_thread() is threading.main_thread():
            raise
        kinds = [step.kind for step in steps if isinstance(step, Step) and isinstance(step.kind, str)]
        failed = Prediction(
            status="error",
            reason=_reason(error),
            n_observations=calls["look"],
            n_model_calls=kinds.count("model"),
        )
        seconds = time.perf_counter() - started
        try:
            finished = finished_entry(question, failed, steps, writes, seconds)
        except Exception:
            # A step or a write cannot be stored.
            finished = finished_entry(question, failed, [], [], seconds)
    return finished


def _reason(error: BaseException) -> str:
    """Return an exception in one line: type (unless this package raised it), message, and line of the method."""
    text = " ".join(str(error).split()).encode("utf-8", "backslashreplace").decode()
    frames = list(traceback.walk_tb(error.__traceback__))
    outside = [(f.f_code, line) for f, line in frames if not str(f.f_globals.get("__name__")).startswith(_PACKAGE)]
    user_frames = [frame for frame in outside if not frame[0].co_filename.startswith(_LIBRARIES)]
    # Errors of this package name a remedy; a line of a library would not help.
    frames_shown = user_frames or ([] if isinstance(error, AvrError) else outside)
    message = text if isinstance(error, AvrError) else f"{type(error).__name__}: {text}"
    if not frames_shown:
        return message
    code, line = frames_shown[-1]
    return f"{message} ({Path(code.co_filename).name}:{line}, in {code.co_name})"


@contextlib.contextmanager
def for_many_threads() -> Iterator[None]:
    """Configure OpenCV and Python for many threads while a block runs."""
    import cv2

    pool, interval = cv2.getNumThreads(), sys.getswitchinterval()
    # Threads of OpenCV spin after each small task, and the questions in flight already use all cores.
    cv2.setNumThreads(1)
    sys.setswitchinterval(_SWITCH_S)
    try:
        yield
    finally:
        cv2.setNumThreads(pool)
        sys.setswitchinterval(interval)


@for_many_threads()
def answer_all(
    method: Method,
    questions: Sequence[Question],
    sequences: Mapping[str, SequenceInfo],
    observe: Observe,
    panorama: GetPanorama,
    journal: Entries,
    concurrency: int,
    advance: Callable[[int], None] = lambda steps: None,
) -> None:
    """Answer the questions that the journal lacks or holds as errors.

    The threads are daemons, and one thread writes. An interrupt ends the process within seconds and loses only
    questions in flight.

    Args:
        method: The method.
        questions: The questions.
        sequences: The sequences by name.
        observe: Returns crops.
        panorama: Returns panoramas.
        journal: Receives each finished question.
        concurrency: The maximum number of questions in flight.
        advance: Called with numbers of finished questions.

    Raises:
        RunStoppedError: No further question can be answered now; the questions in flight have ended.
    """
    waiting: queue.SimpleQueue[Question] = queue.SimpleQueue()
    done: queue.SimpleQueue[Finished | BaseException | None] = queue.SimpleQueue()
    # By sequence, because its panoramas are in memory and few files of the journal change at a time.
    due = sorted(unanswered(questions, journal.finished), key=lambda question: question.sequence)
    advance(len(questions) - len(due))
    for question in due:
        waiting.put(question)

    stop = threading.Event()
    stopped: list[RunStoppedError] = []

    def work() -> None:
        try:
            while not stop.is_set() and not stopped:
                question = waiting.get_nowait()
                done.put(answer_one(method, question, sequences[question.sequence], observe, panorama, stop.is_set))
        except (queue.Empty, _Stopped):
            pass
        except RunStoppedError as error:
            stopped.append(error)
        except BaseException as error:
            done.put(error)
        finally:
            done.put(None)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(min(concurrency, len(due)))]
    try:
        for thread in threads:
            thread.start()
        working = len(threads)
        while working:
            entry = done.get()
            if isinstance(entry, BaseException):
                raise entry
            if entry is None:
                working -= 1
            else:
                journal.append(entry)
                advance(1)
        if stopped:
            raise stopped[0]
    finally:
        # A thread that decodes an image when the interpreter ends would abort the process. A thread that waits for a
        # server would not, so the wait has a deadline.
        stop.set()
        deadline = time.monotonic() + _STOP_S
        for thread in threads:
            # An interrupt may come before all threads are started.
            if thread.is_alive():
                thread.join(max(0.0, deadline - time.monotonic()))
