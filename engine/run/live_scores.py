"""Scores of a run that is in progress, from a separate process: `python -m jrdb_avr.engine.run.live_scores STORE RUN`.

The process that talks to a model never opens the private files. So a child process reads the answers and the run's
journal, and sends lines of four whole numbers: questions judged, and how many of them score in answer, in evidence and
in both. Nothing else comes back, and nothing of it reaches a method. Where there are no answers (a machine that has the
public files alone), or anything is wrong, the child ends silently.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store

EVERY_S: Final = 1.0
"""Seconds between two readings of the journal."""

_LINE: Final = re.compile(r"(\d{1,9}) (\d{1,9}) (\d{1,9}) (\d{1,9})")


@dataclass(frozen=True, slots=True)
class LiveScore:
    """Scores so far: the questions judged, and how many of them score."""

    judged: int
    answer: int
    evidence: int
    combined: int

    def __str__(self) -> str:
        words = (("answer", self.answer), ("evidence", self.evidence), ("combined", self.combined))
        return ", ".join(f"{word} {100 * n / max(self.judged, 1):.1f} %" for word, n in words) + f" of {self.judged}"


@contextlib.contextmanager
def report_scores(store: Store, run_id: str, report: Callable[[LiveScore], None]) -> Iterator[None]:
    """Call `report` with a run's scores whenever they change, from another thread, while the block lasts."""
    command = [sys.executable, "-m", "jrdb_avr.engine.run.live_scores", str(store.path), run_id]
    # It has no business with the model's server.
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_API_KEY")}
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment, text=True
    ) as process:
        assert process.stdout is not None, "stdout is a pipe"
        reader = threading.Thread(target=_report_all, args=(process.stdout, report), daemon=True)
        reader.start()
        try:
            yield
        finally:
            # Killed at once: it holds nothing that a run needs.
            process.kill()
            reader.join(1.0)


def _report_all(lines: Iterator[str], report: Callable[[LiveScore], None]) -> None:
    with contextlib.suppress(ValueError, OSError):
        for line in lines:
            if found := _LINE.fullmatch(line.rstrip("\n")):
                report(LiveScore(*map(int, found.groups())))


# -- the child --------------------------------------------------------------------------------------------------------


def print_scores() -> None:
    """Print a line whenever the scores change, until standard input closes: the parent's end is the child's."""
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.errors import AvrError

    store, run_id = Store(sys.argv[1]), sys.argv[2]
    with contextlib.suppress(AvrError, OSError, msgspec.DecodeError, BrokenPipeError):
        last: LiveScore | None = None
        for score in live_scores(store, run_id, _open_input):
            if score != last:
                print(score.judged, score.answer, score.evidence, score.combined, flush=True)
                last = score


def live_scores(store: Store, run_id: str, go_on: Callable[[], bool]) -> Iterator[LiveScore]:
    """Yield a run's scores after each call of `go_on`, which waits; the last time once it returns False.

    The last line of a question counts; an error scores nothing. Raises StoreError where there are no answers or no run,
    or they do not fit together.
    """
    import pyarrow as pa

    from jrdb_avr.engine.report.scoring import read_truth, score_predictions
    from jrdb_avr.engine.run.journal import Finished
    from jrdb_avr.queries.runs import questions_hash, read_run_manifest
    from jrdb_avr.schema.errors import StoreError
    from jrdb_avr.schema.tables import RUNS

    manifest, truth = read_run_manifest(store, run_id), read_truth(store)
    if manifest.questions_sha256 != questions_hash(store):
        raise StoreError(f"run {run_id} is of another questions file than this store's")
    scored: dict[str, tuple[int, int, int]] = {}
    rest = b""
    with (store.run_path(run_id) / "journal.jsonl").open("rb") as journal:
        while True:
            more = go_on()
            *lines, rest = (rest + journal.read()).split(b"\n")
            entries = {
                entry.question_id: entry for entry in (msgspec.json.decode(line, type=Finished) for line in lines)
            }
            if entries:
                rows = [{"run_id": run_id, **entry.prediction} for entry in entries.values()]
                predictions = pa.Table.from_pylist(rows, RUNS["predictions"])
                for row in score_predictions(truth, run_id, list(entries), predictions).to_pylist():
                    scored[row["question_id"]] = (row["answer_score"], row["evidence_score"], row["combined_score"])
            yield LiveScore(len(scored), *(sum(row[i] for row in scored.values()) for i in range(3)))
            if not more:
                return


def _open_input() -> bool:
    """Wait `EVERY_S`; return whether standard input is still open."""
    ready, _, _ = select.select([sys.stdin], [], [], EVERY_S)
    return not ready


if __name__ == "__main__":
    print_scores()
