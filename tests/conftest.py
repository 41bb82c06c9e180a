"""Settings and fixtures of all tests."""

import fcntl
import os
import random
import shutil
import signal
import tempfile
from pathlib import Path

import pytest
from environment import examples
from hypothesis import settings

# Tables are as wide as a terminal says; the tests and the tour expect those of no terminal.
os.environ.pop("COLUMNS", None)
# Readline, which pytest loads, sets it for processes that this one starts, past `os.environ`.
os.unsetenv("COLUMNS")

# The workers share the cores already: threads of numpy, scikit-learn and Arrow would only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# What a shell starts in the background ignores Ctrl-C, which tests send to themselves and to processes.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine is no fault of the code, so there is no deadline.
settings.register_profile("tests", deadline=None, max_examples=examples(30))
settings.load_profile("tests")


# Fixtures of more than one file.
pytest_plugins = ["painted", "small_demo"]

MEMORY = Path("/dev/shm")
"""A file system in memory, where Linux has one."""


def pytest_configure():
    """Temporary files lie in memory where there is plenty: nothing waits for a disk. `TMPDIR` goes before."""
    if "TMPDIR" not in os.environ and os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > 8 << 30:
        os.environ["TMPDIR"] = str(MEMORY)
        tempfile.tempdir = None


@pytest.fixture
def memory():
    """An empty graph in memory."""
    from jrdb_avr.queries.graph.handle import Graph

    with Graph.memory() as graph:
        yield graph


@pytest.fixture(scope="session", autouse=True)
def one_process():
    """Write graphs and run Cypher statements in the tests' process: starting another takes longer than the work."""
    from processes import run_statement_here

    from jrdb_avr.queries import workers
    from jrdb_avr.queries.graph import guard

    started = workers.run_alone, guard.run_child
    workers.run_alone, guard.run_child = (lambda function: function()), run_statement_here
    yield started
    workers.run_alone, guard.run_child = started


@pytest.fixture
def own_processes(one_process, monkeypatch):
    """Start the processes that the program starts: for tests of what they withstand."""
    from jrdb_avr.queries import workers
    from jrdb_avr.queries.graph import guard

    monkeypatch.setattr(workers, "run_alone", one_process[0])
    monkeypatch.setattr(guard, "run_child", one_process[1])


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """`once(name, make)`: the folder that `make(folder)` has filled, by whichever worker of the run came first."""
    base = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent

    def made(name, make):
        folder, done = base / f"shared-{name}", base / f"shared-{name}.done"
        with (base / f"shared-{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                make(folder)
                done.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def sample_benchmark(once):
    """A store with questions of every template, of a sample world without images. Not to be written to."""
    from jrdb_avr.queries.store import Store

    return Store(once("benchmark", make_benchmark) / "store")


@pytest.fixture(scope="session")
def twin_benchmark(once):
    """A store with time twins of each template that has them, beside its root. Not to be written to."""
    from jrdb_avr.queries.store import Store

    return Store(once("twins", make_twins) / "store")


def make_twins(folder):
    from keyframe_layers import layers_in_memory
    from loaded_stores import graphless_store
    from random_worlds import sociable_world, with_chorus

    from jrdb_avr.engine.generate.run import generate

    rng, worlds = random.Random(19), {}
    for number in range(3):
        worlds |= with_chorus(sociable_world)(rng, f"yard-2020-01-0{number + 1}_0")
    with layers_in_memory():
        generate(graphless_store(folder, worlds), profile="paper", workers=1)


def make_benchmark(folder):
    from jrdb_avr.engine.generate.run import generate
    from jrdb_avr.loaders.load import load
    from jrdb_avr.loaders.root import find_root
    from jrdb_avr.loaders.synthetic import coco_files
    from jrdb_avr.loaders.synthetic.write import plan, write
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import LoadRules, Rules

    with pytest.MonkeyPatch.context() as patch:
        # Things are named by the file's categories; no question hangs on the segments, which take longest to draw.
        patch.setattr(coco_files, "_segments", lambda world: iter(()))
        list(write(plan(folder / "root", [(450, 15)] * 2, 42, "none"), 1))
    store = Store(folder / "store")
    load(find_root(folder / "root"), store, LoadRules(), 1)
    generate(store, Rules(), workers=1)


@pytest.fixture
def benchmark_copy(sample_benchmark, tmp_path):
    """The same, to be spoiled."""
    from jrdb_avr.queries.store import Store

    shutil.copytree(sample_benchmark.path, tmp_path / "store")
    return Store(tmp_path / "store")
