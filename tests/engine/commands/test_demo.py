"""The demo in small: every step runs, and leaves what it should."""

from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest
import warm

from jrdb_avr.engine.commands import demo
from jrdb_avr.engine.commands.demo import Size, run_demo, steps
from jrdb_avr.schema.errors import InputError


def forked(command, check):
    """A step in a process of its own that has everything imported; the failing step below starts its from nothing."""
    return warm.run(warm.command_line, *command[3:])


def test_the_whole_system_runs_once(tmp_path, monkeypatch):
    monkeypatch.setattr(demo, "subprocess", SimpleNamespace(run=forked))
    said = []
    folder = tmp_path / "demo"
    size = Size(sequences=1, frames=240, people=12, questions=6)
    run_demo(folder, size, said.append)
    for arguments in steps(folder, size):
        assert any(line.startswith(f"\n$ jrdb-avr {arguments[0]} ") for line in said)
    assert (folder / "look.png").read_bytes().startswith(b"\x89PNG")
    (run,) = (folder / "store" / "runs").iterdir()
    scores = pq.read_table(run / "scores.parquet")
    assert scores.num_rows == 6 and sum(scores["combined_score"].to_pylist()) >= 3
    assert "synthetic" in said[-2]
    with pytest.raises(InputError, match="not empty"):
        run_demo(folder, size, said.append)


def test_a_step_that_fails_ends_the_demo(tmp_path):
    with pytest.raises(InputError, match="the step 'jrdb-avr sample' failed"):
        run_demo(tmp_path / "demo", Size(frames=1), lambda line: None)
