"""One small synthetic benchmark, made once per test process; tests that alter it copy it first."""

import shutil

import pytest


@pytest.fixture(scope="session")
def sample_benchmark(tmp_path_factory):
    """A store with questions of every template, of a sample world without images. Not to be written to."""
    from jrdb_avr.engine.generate import generate
    from jrdb_avr.loaders.layers import find_root
    from jrdb_avr.loaders.load import load
    from jrdb_avr.loaders.sample.writer import plan, write
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import LoadRules, Rules

    folder = tmp_path_factory.mktemp("sample")
    list(write(plan(folder / "root", [(450, 15)] * 3, 0, "none"), 1))
    store = Store(folder / "store")
    load(find_root(folder / "root"), store, LoadRules(), 1)
    generate(store, Rules(), workers=1)
    return store


@pytest.fixture
def benchmark_copy(sample_benchmark, tmp_path):
    """The same, to be spoiled."""
    from jrdb_avr.queries.store import Store

    shutil.copytree(sample_benchmark.path, tmp_path / "store")
    return Store(tmp_path / "store")
