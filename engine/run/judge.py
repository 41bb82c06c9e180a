"""Score one prediction at a time in a separate process, so that the process of the model never reads the answers.

    python -m jrdb_avr.engine.run.judge STORE

The child process reads the answers and prints `ready`. If it cannot read the answers, it prints one line with the
reason, and ends. Each line of its standard input is a row of `predictions` as JSON. For each row, the child prints a
line with four digits: the answer score, the evidence score, the combined score, and 1 if the output of the model could
not be read (else 0). If the store lacks the question of the row, this line is `unknown`. The child ends when its
standard input closes.
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
_ENDED: Final = "the process that judges has ended: score the run afterwards"
_SCORE: Final = re.compile(r"[01]{4}")


class QuestionScore(NamedTuple):
    """Scores of one prediction, each 0 or 1. `invalid` is true if the output of the model could not be read."""

    answer: int
    evidence: int
    combined: int
    invalid: bool


class Judge(contextlib.ExitStack):
    """Scorer of single predictions, which uses the answers of a store. If threads share a judge, they take turns.

    Example:
        with Judge.open("store") as judge:
            judge.score(question, prediction).combined
    """

    def __init__(self, store: Store) -> None:
        """Start the child process. Raise StoreError if the store's answers are missing or cannot be read."""
        super().__init__()
        # API keys are removed, because the child never talks to the server of the model.
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
        if (line := self._ask("")) != _READY:
            self.close()
            raise StoreError(line or _ENDED)

    @classmethod
    def open(cls, store: Store | str | Path) -> Judge:
        """Start a judge that uses the answers of a store, and return the judge.

        Raise StoreError if the store's answers are missing or cannot be read.
        """
        return cls(Store.of(store))

    def score(self, question: Question, prediction: Prediction) -> QuestionScore:
        """Score a prediction.

        Args:
            question: The question.
            prediction: The prediction.

        Returns:
            The scores.

        Raises:
            InputError: If the store has no answer to the question.
            StoreError: If the child process has ended.
            ValueError: If the table `predictions` cannot hold a value of the prediction.
        """
        return self.score_row(finished_entry(question, prediction, (), (), 0.0).prediction)

    def score_row(self, row: Mapping[str, Any]) -> QuestionScore:
        """Return the scores of a row of `predictions`.

        Raise InputError if the store has no answer to the question, or StoreError if the child process has ended.
        """
        with self._lock:
            line = self._ask(msgspec.json.encode(row).decode() + "\n")
        if line == _UNKNOWN:
            raise InputError(f"the store has no answer of question {row['question_id']!r}", field="question_id")
        if not _SCORE.fullmatch(line):
            raise StoreError(line or _ENDED)
        answer, evidence, combined, invalid = map(int, line)
        return QuestionScore(answer, evidence, combined, bool(invalid))

    def _ask(self, text: str) -> str:
        """Send a text to the child, and return its next line. Return "" if the child has ended."""
        assert self._process.stdin is not None and self._process.stdout is not None, "both are pipes"
        try:
            self._process.stdin.write(text)
            self._process.stdin.flush()
            return self._process.stdout.readline().rstrip("\n")
        except (OSError, ValueError):
            return ""

    def _end(self) -> None:
        # The child has nothing to save, so it need not end by itself.
        self._process.kill()
        with contextlib.suppress(OSError), self._process:
            pass


# -- the child --------------------------------------------------------------------------------------------------------


def judge_lines(store: Store, lines: IO[str]) -> None:
    """Read rows of `predictions` from lines of JSON, and print one line of scores for each row.

    The docstring of this module describes the printed lines.
    """
    import pyarrow as pa

    from jrdb_avr.engine.report.scoring import score_predictions
    from jrdb_avr.engine.report.truth import read_truth
    from jrdb_avr.queries.opaque import stored_ids
    from jrdb_avr.schema.tables import RUNS

    try:
        truth, stored = read_truth(store), stored_ids(store)
    except (AvrError, OSError) as error:
        print(" ".join(str(error).split()), flush=True)
        return
    ids = set(truth.ids.to_pylist())
    print(_READY, flush=True)
    for line in lines:
        row = {"run_id": "", **msgspec.json.decode(line)}
        row["question_id"] = stored.get(row["question_id"], row["question_id"])
        if row["question_id"] not in ids:
            print(_UNKNOWN, flush=True)
            continue
        table = pa.Table.from_pylist([row], RUNS["predictions"])
        (score,) = score_predictions(truth, "", [row["question_id"]], table).to_pylist()
        digits = (score["answer_score"], score["evidence_score"], score["combined_score"], int(score["invalid"]))
        print("".join(map(str, digits)), flush=True)


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        judge_lines(Store(sys.argv[1]), sys.stdin)
