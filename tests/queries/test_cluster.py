"""Sequences on a Ray cluster of this machine: the results of local processes, even if workers die."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
from types import SimpleNamespace

import pytest
from environment import needs
from processes import run

from jrdb_avr.queries.workers import map_sequences
from jrdb_avr.schema.errors import InputError, StoreError

pytestmark = pytest.mark.slow


def test_without_ray_the_message_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'jrdb-avr\[ray\]'"):
        list(map_sequences(len, ["a"], "ray", len))


@pytest.mark.parametrize("kind", [ConnectionError, LookupError])
def test_a_cluster_that_refuses_is_reported_in_one_line(monkeypatch, kind):
    """Ray raises its own class of errors, here LookupError, for example if a token is missing."""

    def init(**options):
        raise kind("no token was found.\nMore about it.")

    ray = SimpleNamespace(
        is_initialized=lambda: False, init=init, exceptions=SimpleNamespace(RayError=LookupError, RayTaskError=KeyError)
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    with pytest.raises(InputError, match=r"at ray: no token was found; if .* set RAY_AUTH_MODE=token$"):
        list(map_sequences(len, ["a"], "ray", len))


@pytest.mark.parametrize("address", ["spark", "ray:10", "http://ray"])
def test_other_addresses_are_refused(tmp_path, address):
    code, _, err = run("load", "--rebuild", "--store", tmp_path, "--executor", address)
    assert code == 2 and "write ray, or ray://HOST:PORT" in err


@pytest.fixture(scope="module")
def ray():
    needs("ray")
    import ray

    # Workers cannot import this file, so its functions are sent by value.
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()


def refuse(value):
    raise InputError(f"sequence {value} is broken", field="value")


def die_once(path):
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path


def die(value):
    os._exit(9)


@pytest.mark.usefixtures("ray")
def test_a_sequence_is_run_again_if_its_worker_dies_but_not_forever(tmp_path):
    paths = [tmp_path / name for name in "abc"]
    assert dict(map_sequences(die_once, paths, "ray", lambda path: 1.0)) == dict(enumerate(paths))
    with pytest.raises(InputError, match="is broken"):
        list(map_sequences(refuse, [1, 2], "ray", float))
    with pytest.raises(StoreError, match="4 times on one sequence"):
        list(map_sequences(die, [1], "ray", float))


@pytest.mark.usefixtures("ray")
def test_a_store_made_on_a_cluster_has_the_bytes_of_one_made_locally(tmp_path, monkeypatch):
    from jrdb_avr.loaders import load
    from jrdb_avr.loaders.synthetic.write import plan, write

    root = tmp_path / "root"
    sequences = [written.name for written in write(plan(root, [(120, 8)] * 2, 7, "none"), 1)]
    # The worker of each sequence is killed once while it loads.
    load_shard = load.load_shard

    def killed_once(files, **settings):
        die_once(tmp_path / files.sequence)
        return load_shard(files, **settings)

    hashes = []
    for folder, executor in ((tmp_path / "local", ("--workers", 1)), (tmp_path / "cluster", ("--executor", "ray"))):
        if folder.name == "cluster":
            monkeypatch.setattr(load, "load_shard", killed_once)
        for command in (("load", root), ("generate",)):
            code, _, err = run(*command, "--store", folder, *executor)
            assert code == 0, err
        hashes.append(
            {
                path.relative_to(folder): hashlib.sha256(path.read_bytes()).hexdigest()
                for path in folder.rglob("*.parquet")
            }
        )
    assert hashes[0] == hashes[1] and len(hashes[0]) > 20
    assert all((tmp_path / name).exists() for name in sequences)
