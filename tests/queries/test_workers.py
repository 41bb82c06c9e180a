"""Sequences as shards: every result once, whatever the worker count; a dead worker is an error, not a hang."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from multiprocessing import current_process
from multiprocessing.process import BaseProcess
from pathlib import Path

import pytest

from jrdb_avr.queries.workers import map_sequences, run_alone
from jrdb_avr.schema.errors import InputError, StoreError


def square(value: int) -> int:
    return value * value


def refuse(value: int) -> int:
    raise InputError(f"shard {value} is broken", field="value")


def die(value: int) -> int:
    os._exit(9)


@pytest.mark.parametrize("workers", [1, 2])
def test_every_shard_gives_its_result_once(workers):
    items = [3, 1, 2]
    assert dict(map_sequences(square, items, workers, weight=float)) == {0: 9, 1: 1, 2: 4}


def test_the_heaviest_shard_starts_first():
    assert [index for index, _ in map_sequences(square, [3, 9, 5], 1, weight=float)] == [1, 2, 0]


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_a_shard_is_raised_as_it_is(workers):
    with pytest.raises(InputError, match="is broken"):
        list(map_sequences(refuse, [1, 2], workers, weight=float))


def test_a_dead_worker_is_an_error_that_says_what_to_do():
    with pytest.raises(StoreError, match="fewer --workers"):
        list(map_sequences(die, [1, 2], 2, weight=float))


def test_a_daemonic_process_starts_no_process(monkeypatch):
    monkeypatch.setattr(current_process(), "daemon", True)
    assert sorted(map_sequences(lambda value: value, [2, 1], 2, float)) == [(0, 2), (1, 1)]
    assert run_alone(os.getpid) == os.getpid()


@pytest.mark.parametrize("given", [True, False])
def test_a_script_without_a_guard_or_from_standard_input_runs_once(tmp_path, given):
    script = tmp_path / "script.py"
    script.write_text(
        "print('begun')\n"
        "from jrdb_avr.queries.workers import map_sequences, run_alone\n"
        "print(sorted(map_sequences(abs, [-1, -2], 2, float)), run_alone(dict))\n"
    )
    with script.open() as lines:
        command = [sys.executable, *([] if given else [script])]
        done = subprocess.run(command, stdin=lines, capture_output=True, text=True, timeout=300)
    assert (done.stdout, done.stderr) == ("begun\n[(0, 1), (1, 2)] {}\n", "")


def sleep_or_die(folder: Path | None) -> None:
    if folder is None:
        os._exit(9)
    time.sleep(60)
    (folder / "waited").touch()


def test_the_last_worker_that_dies_is_noticed_before_another_one_has_a_result(tmp_path, monkeypatch):
    start = BaseProcess.start
    # Whoever watches the processes is awake before the last one is there.
    monkeypatch.setattr(BaseProcess, "start", lambda process: time.sleep(0.1) or start(process))
    with pytest.raises(StoreError, match="fewer --workers"):
        list(map_sequences(sleep_or_die, [tmp_path, None], 2, weight=lambda folder: folder is not None))
    assert not (tmp_path / "waited").exists()
