"""`view` and `play` as commands: they print an address that works, end when they are told to, and refuse in a line."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import urllib.request

import pytest
from processes import run

from jrdb_avr.queries.runs import read_run_manifest
from jrdb_avr.queries.store import Store

PROGRAM = "from jrdb_avr.engine.cli import main; main()"


@contextlib.contextmanager
def started(*arguments):
    """A command as a process, and the address that it prints."""
    command = [sys.executable, "-c", PROGRAM, *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_person_may_end_a_session_at_any_time(small_demo, tmp_path):
    """A run that was begun can be resumed, and its manifest says who plays what."""
    shutil.copytree(small_demo.folder / "store", tmp_path / "store")
    store = tmp_path / "store"
    with started("play", "--store", store, "--name", "ada", "--limit", 2) as (process, url):
        assert url.startswith("http://127.0.0.1:") and b"ada plays" in urllib.request.urlopen(url, timeout=300).read()
        process.send_signal(signal.SIGTERM)
        assert process.wait(300) == 0 and "Traceback" not in process.stderr.read()
    manifest = read_run_manifest(Store(store), "human-ada")
    assert (manifest.method, manifest.model, len(manifest.question_ids)) == ("human", "ada", 2)
    assert manifest.settings["method"] == {"budget": 24} and manifest.synthetic
    code, _, err = run("play", "--store", store, "--name", "ada")
    assert code == 1 and "--resume" in err and err.count("\n") == 1
    with started("view", "--store", store) as (process, url):
        page = urllib.request.urlopen(url, timeout=300).read().decode()
        assert "answers and scores are not shown" in page
        process.send_signal(signal.SIGINT)
        assert process.wait(300) == 130 and "Traceback" not in process.stderr.read()


def test_answers_are_shown_of_scored_runs_alone(sample_benchmark):
    code, out, err = run("view", "--answers", "--store", sample_benchmark.path)
    assert (code, out) == (1, "") and "has no runs yet" in err
