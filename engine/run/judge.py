"""Score one prediction at a time in a process apart: the private half of a benchmark.

    python -m jrdb_avr.engine.run.judge STORE

The process that talks to a model never opens the private files. A child process reads the answers. It gets rows of
`predictions` as lines of JSON and returns four digits per row: answer, evidence and combined score, and whether the
output was unreadable. If it cannot score, it returns one line with the reason. It ends when its standard input closes.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any, Final, NamedTuple

import msgspec

from jrdb_avr.engine.run.journal import finished_entry
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, InputError, StoreError
from jrdb_avr.schema.method import Prediction, Question

_READY: Final = "ready"
_UNKNOWN: Final = "unknown"
_SCORE: Final = re.compile(r"[01]{4}")


class QuestionScore(NamedTuple):
    """Scores of one prediction, each 0 or 1; `invalid` marks unreadable output of the model."""

    answer: int
    evidence: int
    combined: int
    invalid: bool


class Judge(contextlib.ExitStack):
    """Judge of predictions of the questions of a store. Safe for many threads, which take turns.

    Example:
        with Judge.open("store") as judge:
            judge.score(question, prediction).combined
    """

    def __init__(self, store: Store) -> None:
        """Start the process. Raise StoreError if the answers of the store are missing or unfit."""
        super().__init__()
        # The child never talks to the server of the model.
        environment = {name: value for name, value in os.environ.items() if not name.endswith("_API_KEY")}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "jrdb_avr.engine.run.judge", str(store.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            text=True,
        )
        self._lock = threading.Lock()
        self.callback(self._end)
        if (line := self._line()) != _READY:
            self.close()
            raise StoreError(line or "the process that judges ended: score the run afterwards")

    @classmethod
    def open(cls, store: Store | str | Path) -> Judge:
        """Return the judge of the questions of a store. Raise StoreError if its answers are missing or unfit."""
        return cls(Store.of(store))

    def score(self, question: Question, prediction: Prediction) -> QuestionScore:
        """Score a prediction.

        Args:
            question: The question.
            prediction: The prediction.

        Returns:
            The scores.

        Raises:
            InputError: The store has no answer to the question.
            StoreError: The process has ended.
            ValueError: No table can hold the prediction.
        """
        return self.score_row(finished_entry(question, prediction, (), (), 0.0).prediction)

    def score_row(self, row: Mapping[str, Any]) -> QuestionScore:
        """Score a row of `predictions`. Raise errors as `score` does."""
        with self._lock:
            try:
                assert self._process.stdin is not None, "stdin is a pipe"
                self._process.stdin.write(msgspec.json.encode(row).decode() + "\n")
                self._process.stdin.flush()
            except (OSError, ValueError):
                raise StoreError("the process that judges has ended: score the run afterwards") from None
            line = self._line()
        if line == _UNKNOWN:
            raise InputError(f"the store has no answer of question {row['question_id']!r}", field="question_id")
        if not _SCORE.fullmatch(line):
            raise StoreError(line or "the process that judges has ended: score the run afterwards")
        answer, evidence, combined, invalid = map(int, line)
        return QuestionScore(answer, evidence, combined, bool(invalid))

    def _line(self) -> str:
        assert self._process.stdout is not None, "stdout is a pipe"
        try:
            return self._process.stdout.readline().rstrip("\n")
        except (OSError, ValueError):
            return ""

    def _end(self) -> None:
        # Killed at once, because it holds nothing to save.
        self._process.kill()
        with contextlib.suppress(OSError), self._process:
            pass


# -- the child --------------------------------------------------------------------------------------------------------


def judge_lines(store: Store, lines: IO[str]) -> None:
    """Print the scores of the prediction in each line."""
    import pyarrow as pa

    from jrdb_avr.engine.report.scoring import score_predictions
    from jrdb_avr.engine.report.truth import read_truth
    from jrdb_avr.schema.tables import RUNS

    try:
        truth = read_truth(store)
    except (AvrError, OSError) as error:
        print(" ".join(str(error).split()), flush=True)
        return
    ids = set(truth.ids.to_pylist())
    print(_READY, flush=True)
    for line in lines:
        row = {"run_id": "", **msgspec.json.decode(line)}
        if row["question_id"] not in ids:
            print(_UNKNOWN, flush=True)
            continue
        table = pa.Table.from_pylist([row], RUNS["predictions"])
        scores = score_predictions(truth, "", [row["question_id"]], table)
        (score,) = scores.to_pylist()
        digits = (score["answer_score"], score["evidence_score"], score["combined_score"], int(score["invalid"]))
        print("".join(map(str, digits)), flush=True)


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        judge_lines(Store(sys.argv[1]), sys.stdin)
