"""Sequences on a Ray cluster of this machine: the same results as in processes; what dies is run again."""

from __future__ import annotations

import hashlib
import os
import signal
import sys
from types import SimpleNamespace

import pytest
from entry import run

from jrdb_avr.queries.cluster import map_on_cluster
from jrdb_avr.queries.workers import map_shards
from jrdb_avr.schema.errors import InputError, StoreError


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"pip install 'jrdb-avr\[ray\]'"):
        list(map_on_cluster("ray", len, ["a"], [0]))


@pytest.mark.parametrize("kind", [ConnectionError, LookupError])
def test_a_cluster_that_refuses_is_one_line(monkeypatch, kind):
    """Ray's own errors, such as that of a missing token, are of its own kind, here LookupError."""

    def init(**options):
        raise kind("no token was found.\nMore about it.")

    exceptions = SimpleNamespace(RayError=LookupError)
    monkeypatch.setitem(
        sys.modules, "ray", SimpleNamespace(is_initialized=lambda: False, init=init, exceptions=exceptions)
    )
    with pytest.raises(InputError, match=r"at ray: no token was found; where .* set RAY_AUTH_MODE=token$"):
        list(map_on_cluster("ray", len, ["a"], [0]))


@pytest.mark.parametrize("address", ["spark", "ray:10", "http://ray"])
def test_what_is_no_address_is_refused(tmp_path, address):
    code, _, err = run("load", "--rebuild", "--store", tmp_path, "--executor", address)
    assert code == 2 and "write ray, or ray://HOST:PORT" in err


@pytest.fixture(scope="module")
def ray():
    if "REQUIRE_EXTRAS" not in os.environ:
        pytest.importorskip("ray", minversion="2")  # not a mere folder of that name
    import ray

    # The functions of this file are sent by value: no worker can import it.
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()


def square(value):
    return value * value


def refuse(value):
    raise InputError(f"shard {value} is broken", field="value")


def die_once(place):
    if not place.exists():
        place.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return place


def die(value):
    os._exit(9)


@pytest.mark.usefixtures("ray")
def test_every_shard_gives_its_result_once_and_a_dead_worker_is_replaced(tmp_path):
    assert dict(map_shards(square, [3, 1, 2], "ray", weight=float)) == {0: 9, 1: 1, 2: 4}
    places = [tmp_path / name for name in "ab"]
    assert dict(map_shards(die_once, places, "ray", weight=lambda place: 1.0)) == dict(enumerate(places))
    with pytest.raises(InputError, match="is broken"):
        list(map_shards(refuse, [1, 2], "ray", weight=float))
    with pytest.raises(StoreError, match="4 times on one sequence"):
        list(map_shards(die, [1], "ray", weight=float))


@pytest.mark.usefixtures("ray")
def test_a_store_made_on_a_cluster_is_that_of_one_machine(small_demo, tmp_path):
    root = small_demo.folder / "sample"
    found = []
    for place, where in (("here", ("--workers", 1)), ("there", ("--executor", "ray"))):
        for command in (("load", root), ("generate",), ("validate", "--replay")):
            code, _, err = run(*command, "--store", tmp_path / place, *where)
            assert code == 0, err
        found.append(
            {
                path.relative_to(tmp_path / place): hashlib.sha256(path.read_bytes()).hexdigest()
                for path in sorted((tmp_path / place).rglob("*.parquet"))
            }
        )
    assert found[0] == found[1] and len(found[0]) > 20
