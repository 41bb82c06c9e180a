"""What the tests share: worlds made once per run, and the two costs of a load that few tests are about."""

import contextlib
import fcntl
import gc
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from effort import DEEP, examples
from hypothesis import settings

# Tables are as wide as a terminal says; the tests and the tour expect those of no terminal.
os.environ.pop("COLUMNS", None)

# A busy machine is no fault of the code, so there is no deadline.
settings.register_profile("tests", deadline=None, max_examples=examples(30))
settings.load_profile("tests")


# Fixtures of more than one file.
pytest_plugins = ["asked_world", "small_demo"]

DEAREST = (
    "test_verify",
    "test_docs",
    "test_generate_worlds",
    "test_simulated",
    "test_validate",
    "test_load_store",
    "test_evaluate_beliefs",
    "test_client",
    "test_generate",
    "test_hostile_scenes",
    "test_simulated_sample",
    "test_evaluate",
    "test_compiler",
    "test_sample",
    "test_pages",
    "test_leaks",
    "test_replay",
    "test_generators_sql",
    "test_statements_by_name",
    "test_extending",
    "test_kill",
    "test_guard",
    "test_scoring",
    "test_sample_images",
    "test_world_model",
    "test_live_scores",
    "test_search_graph",
    "test_text_reader",
    "test_belief_reads",
    "test_preflight",
    "test_wording",
    "test_load_broken",
    "test_generate_oracle",
    "test_handle",
    "test_rederive_agrees",
    "test_explore",
    "test_reference_hostile",
    "test_cli",
    "test_simulated_agent",
    "test_calibrate",
    "test_gap",
    "test_markers",
    "test_sample_formats",
    "test_simulated_baselines",
    "test_awkward_cases",
    "test_belief_graph",
    "test_load_facts",
    "test_react",
    "test_pose",
    "test_huggingface",
    "test_view",
    "test_human",
    "test_served",
)
"""Files of 2.5 seconds and more: begun first, so that the workers, who take a file at a time, end together."""


MEMORY = Path("/dev/shm")
"""A file system in memory, where Linux has one."""


def pytest_configure():
    """Temporary files lie in memory where there is plenty: nothing waits for a disk. `TMPDIR` goes before."""
    if "TMPDIR" not in os.environ and os.access(MEMORY, os.W_OK) and shutil.disk_usage(MEMORY).free > 8 << 30:
        os.environ["TMPDIR"] = str(MEMORY)
        tempfile.tempdir = None


def pytest_collection():
    """What is collected stays to the end: nothing looks for cycles in it, and seldom in the rest."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        gc.disable()


def pytest_collection_finish():
    gc.collect()
    gc.freeze()
    gc.enable()
    gc.set_threshold(20_000, 20, 20)


def pytest_unconfigure():
    """Otherwise modules of C++ tell at the end what nobody has freed."""
    gc.unfreeze()


def pytest_collection_modifyitems(items):
    rank = {name: place for place, name in enumerate(DEAREST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))


@pytest.fixture(scope="session", autouse=True)
def cheap_processes():
    """Processes of the tests' own program start with everything imported, and graphs are built in the tests' process.

    Commands that the tests run as processes start theirs from nothing, as users' do.
    """
    import warm

    from jrdb_avr.agent.simulated import server
    from jrdb_avr.queries import workers
    from jrdb_avr.queries.graph import guard

    workers.context = warm.context()
    workers.run_alone = lambda function: function()
    guard.run_child = warm.run_statement
    server.start_process = warm.start_server


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_the_disk():
    """Files are not synced, which a load does so that they outlive a power cut."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda file: None)
        yield


@pytest.fixture(scope="module")
def known_plans():
    """A statement's plan is looked at in the first of a module's graphs, and taken as known in the others.

    For tests that hold what many small graphs answer against brute force or what is written by hand: looking at a plan
    takes as long as the answer. `HYPOTHESIS_PROFILE=deep` looks at all of them.
    """
    with remembered_plans():
        yield


@contextlib.contextmanager
def remembered_plans():
    """A context in which a statement's plan is looked at once, in whichever graph it runs first."""
    from jrdb_avr.queries.graph.handle import Graph

    plans, look = {}, Graph._plan

    def remembered(graph, text, values):
        if text not in plans:
            plans[text] = look(graph, text, values)
        return plans[text]

    with pytest.MonkeyPatch.context() as patch:
        if not DEEP:
            patch.setattr(Graph, "_plan", remembered)
        yield


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
    with remembered_plans():
        generate(store, Rules(), workers=1)


@pytest.fixture
def benchmark_copy(sample_benchmark, tmp_path):
    """The same, to be spoiled."""
    from jrdb_avr.queries.store import Store

    shutil.copytree(sample_benchmark.path, tmp_path / "store")
    return Store(tmp_path / "store")
