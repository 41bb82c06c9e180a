"""The demo in small: every step runs, and leaves what it should."""

import pyarrow.parquet as pq
import pytest
from small_demo import SIZE

from jrdb_avr.engine.commands.demo import Size, run_demo, steps
from jrdb_avr.schema.errors import InputError


def test_the_whole_system_runs_once(small_demo):
    folder, printed = small_demo.folder, small_demo.printed.splitlines()
    for arguments in steps(folder, SIZE):
        assert any(line.startswith(f"$ jrdb-avr {arguments[0]} ") for line in printed)
    assert (folder / "look.png").read_bytes().startswith(b"\x89PNG")
    (run,) = (folder / "store" / "runs").iterdir()
    scores = pq.read_table(run / "scores.parquet")
    assert scores.num_rows == SIZE.questions and sum(scores["combined_score"].to_pylist()) >= 3
    assert any("synthetic" in line for line in printed)
    with pytest.raises(InputError, match="not empty"):
        run_demo(folder, SIZE, print)


def test_a_step_that_fails_ends_the_demo(tmp_path):
    with pytest.raises(InputError, match="the step 'jrdb-avr sample' failed"):
        run_demo(tmp_path / "demo", Size(frames=1), lambda line: None)
