"""Let a method answer several questions at the same time, and append each finished question to a journal."""

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
from typing import Any, Final, TypeVar

from jrdb_avr.engine.run.journal import Finished, Journal, finished_entry, unanswered
from jrdb_avr.schema.beliefs import Write
from jrdb_avr.schema.errors import AvrError, FilteredError, RunStoppedError
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
"""Maximum seconds to wait for the worker threads when a run ends early."""

_SWITCH_S: Final = 0.05
"""Seconds between switches of Python threads. Shorter intervals gain nothing: most threads wait for a server."""


_PACKAGE: Final = f"{__name__.partition('.')[0]}."
_LIBRARIES: Final = tuple({sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")})
"""Folders of the standard library and of installed packages. Code in these folders is not a method's own."""


HOPELESS: Final = 20
"""Number of finished questions without a readable reply after which a run stops."""
_UNREADABLE: Final = ("the reply ", "the model refused", "refused: ")
"""Beginnings of the reasons of questions with an unreadable last reply (`decode.reply_object`)."""


class _Stopped(BaseException):
    """Exception that ends the work of a method because the run has ended.

    It is a BaseException, so that `except Exception` in a method does not catch it.
    """


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
        observe: The function that returns a crop of a frame.
        panorama: The function that returns the whole panorama of a frame.
        stopped: Function that is called each time before the method looks at a picture or records something. If
            `stopped` returns True, the question ends without an entry.

    Returns:
        The entry for the journal. Its status is "error" if the method raises an exception or returns no prediction, and
            "invalid" if a content filter refuses a prompt.

    Raises:
        RunStoppedError: If no further question can be answered now, for example at the cost limit of the run.
        KeyboardInterrupt: If the user interrupts the program while this function runs in the main thread.
    """
    steps: list[Step] = []
    writes: list[Write] = []
    calls: Counter[str] = Counter()

    def counted(name: str, function: Callable[..., R]) -> Callable[..., R]:
        """Return a function that calls `function` and counts the successful calls under `name`.

        If `stopped()` is true, the returned function raises _Stopped instead.
        """

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
        # Python interrupts only the main thread. In any other thread, the method itself raised KeyboardInterrupt.
        if isinstance(error, KeyboardInterrupt) and threading.current_thread() is threading.main_thread():
            raise
        kinds = [step.kind for step in steps if isinstance(step, Step) and isinstance(step.kind, str)]
        failed = Prediction(
            status="invalid" if isinstance(error, FilteredError) else "error",
            reason=_reason(error),
            n_observations=calls["look"],
            n_model_calls=kinds.count("model"),
        )
        seconds = time.perf_counter() - started
        try:
            finished = finished_entry(question, failed, steps, writes, seconds)
        except Exception:
            # A recorded step or write cannot be stored, so the entry has none.
            finished = finished_entry(question, failed, [], [], seconds)
    return finished


def _is_unreadable(entry: Finished) -> bool:
    invalid = entry.prediction["status"] == "invalid"
    return entry.failed or (invalid and entry.prediction["reason"].startswith(_UNREADABLE))


def _hopeless(reason: str, raw: str) -> str:
    """Return why a run stops: the last question has the given reason, and its last reply the given text."""
    return (
        f"no question so far has a readable reply ({reason}; the last begins: {raw[:40]!a}): check --model, "
        "--response-format, --thinking, --max-tokens and --delimiter, or run again with --resume --keep-going"
    )


def _reason(error: BaseException) -> str:
    """Return an exception as one line of text: its message, and the line of the method's code that raised it.

    The message begins with the type of the exception, unless this package defines the exception.
    """
    text = " ".join(str(error).split()).encode("utf-8", "backslashreplace").decode()
    frames = list(traceback.walk_tb(error.__traceback__))
    outside = [(f.f_code, line) for f, line in frames if not str(f.f_globals.get("__name__")).startswith(_PACKAGE)]
    user_frames = [frame for frame in outside if not frame[0].co_filename.startswith(_LIBRARIES)]
    # The message of this package's errors says what to do. A line number in a library would add nothing to it.
    frames_shown = user_frames or ([] if isinstance(error, AvrError) else outside)
    message = text if isinstance(error, AvrError) else f"{type(error).__name__}: {text}"
    if not frames_shown:
        return message
    code, line = frames_shown[-1]
    return f"{message} ({Path(code.co_filename).name}:{line}, in {code.co_name})"


@contextlib.contextmanager
def for_many_threads() -> Iterator[None]:
    """Limit OpenCV to one thread and switch Python threads less often, in a `with` block or a decorated function."""
    import cv2

    pool, interval = cv2.getNumThreads(), sys.getswitchinterval()
    # After each small task, OpenCV's own threads busy-wait. The threads that answer questions then lack CPU time.
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
    journal: Journal,
    concurrency: int,
    advance: Callable[[int], None] = lambda steps: None,
    patience: int | None = None,
) -> None:
    """Let a method answer each question that has no entry in the journal, and each question that ended in an error.

    Worker threads call the method, and the calling thread alone appends to the journal. The workers are daemon threads,
    so that an interrupt ends the process within seconds. An interrupt loses only the questions that are in progress.

    Args:
        method: The method.
        questions: All questions of the run.
        sequences: The sequences of the questions, by name.
        observe: The function that returns a crop of a frame.
        panorama: The function that returns the whole panorama of a frame.
        journal: The journal, which gets an entry for each finished question.
        concurrency: Maximum number of questions that are in progress at the same time.
        advance: Called once at the start with the number of questions that need no answer, then with 1 after each
            finished question.
        patience: Number of questions that may finish without one readable reply. None means all.

    Raises:
        RunStoppedError: If no further question can be answered now, for example at the cost limit of the run, or if
            the first `patience` questions have no readable reply. It is raised after the questions in progress have
            ended.
    """
    waiting: queue.SimpleQueue[Question] = queue.SimpleQueue()
    done: queue.SimpleQueue[Finished | BaseException | None] = queue.SimpleQueue()
    # Questions are sorted by sequence, so that the panoramas of a sequence stay in memory, and only a few files of the
    # journal grow at the same time.
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
                patience = patience - 1 if patience and _is_unreadable(entry) else None
                if patience == 0:
                    stopped.append(RunStoppedError(_hopeless(entry.prediction["reason"], entry.prediction["raw"])))
        if stopped:
            raise stopped[0]
    finally:
        # Wait for the threads, because the process would abort if a thread were decoding an image when the interpreter
        # ends. The wait is limited, because a thread that only waits for a server causes no abort.
        stop.set()
        deadline = time.monotonic() + _STOP_S
        for thread in threads:
            # If an interrupt came early, some threads have not started, and `join` would raise an error.
            if thread.is_alive():
                thread.join(max(0.0, deadline - time.monotonic()))
