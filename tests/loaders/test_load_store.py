"""Loading as a whole: the same store whatever happens on the way, and the old one where it fails."""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from loaded_stores import without_graph
from processes import COMMAND, run, run_program
from random_worlds import random_world
from worlds import load_reported, load_world, person, person_3d, write_root

from jrdb_avr.engine.rederive.labels import Annotations
from jrdb_avr.loaders import load as loading
from jrdb_avr.loaders.load import rebuild
from jrdb_avr.loaders.root import find_root
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError, LockedError, QueryError, StoreError
from jrdb_avr.schema.graph import SCENE_NODES, SCENE_RELS
from jrdb_avr.schema.rules import LoadRules, Rules

GOOD = {"2d": {f: [person(1, (100 + f, 60, 50, 200), {"walking": 1}, (5, 1))] for f in range(40)}}


@pytest.fixture(scope="module")
def world():
    """Three sequences of different lengths and layers."""
    worlds = [random_world(random.Random(seed), f"yard-2020-01-0{seed}_0") for seed in (1, 2, 3)]
    return {name: layers for one in worlds for name, layers in one.items()}


@pytest.fixture(scope="module")
def loaded_world(tmp_path_factory, world):
    """The store of `world`, loaded by one worker from the root beside it. Not to be written to."""
    return load_world(tmp_path_factory.mktemp("world"), world)


@pytest.fixture(scope="module")
def loaded_one(tmp_path_factory):
    """The store of one short sequence. Not to be written to."""
    return load_world(tmp_path_factory.mktemp("one"), {"yard-1": GOOD})


@pytest.fixture(scope="module")
def loaded_two(tmp_path_factory):
    """The store of two short sequences. Not to be written to."""
    return load_world(tmp_path_factory.mktemp("two"), {"yard-1": GOOD, "yard-2": GOOD})


@pytest.fixture
def graphless():
    with without_graph():
        yield


def copied(store, place):
    """A store of the same, to be written to."""
    return Store(shutil.copytree(store.path, place))


def files(store):
    """Content of every file of a store that is a record: path -> hash; the graph counts by its answers."""
    found = {}
    for path in sorted(store.path.rglob("*")):
        name = path.relative_to(store.path).as_posix()
        if path.is_file() and not name.startswith(("graph.kuzu", ".writing")):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def answers(store):
    """Everything in the graph, as sorted rows."""
    result = {}
    with Graph.open(store.graph_path, read_only=True) as graph:
        for table in SCENE_NODES:
            rows = graph.query(f"MATCH (n:{table}) RETURN n", ordered=False)["n"].to_pylist()
            result[table] = sorted(repr({k: v for k, v in row.items() if k != "_ID"}) for row in rows)
        for table in SCENE_RELS:
            query = f"MATCH (a)-[r:{table}]->(b) RETURN a, r, b"
            rows = graph.query(query, ordered=False).to_pylist()
            result[table] = sorted(
                repr([{k: v for k, v in part.items() if k not in ("_ID", "_SRC", "_DST")} for part in row.values()])
                for row in rows
            )
    return result


remembered = cache(answers)


def same(store, expected):
    """`expected` is not written to."""
    assert files(store) == files(expected)
    assert answers(store) == remembered(expected)


@pytest.mark.slow
def test_the_number_of_workers_does_not_show(tmp_path, loaded_world):
    store = Store(tmp_path / "store")
    loading.load(find_root(loaded_world.path.parent / "root"), store, LoadRules(), 2)
    same(store, loaded_world)


def test_rebuild_gives_the_same_tables_and_graph_without_the_root(tmp_path, loaded_world):
    # The root was never beside this copy.
    store = copied(loaded_world, tmp_path / "store")
    store.graph_path.unlink()
    for path in (store.path / "intervals").rglob("*.parquet"):
        path.unlink()
    loading.rebuild(store, LoadRules(), 1)
    same(store, loaded_world)


def test_rebuild_under_other_rules_and_back(tmp_path, world, loaded_world):
    store = copied(loaded_world, tmp_path / "store")
    before = files(store)
    with without_graph():
        loading.rebuild(store, LoadRules(gap_frames=0), 1)
    assert store.manifest().load_rules == LoadRules(gap_frames=0)
    assert not any(any(store.interval("possible_actions", name)["gap"].to_pylist()) for name in world)
    loading.rebuild(store, LoadRules(), 1)
    assert files(store) == before


def test_rebuild_refuses_an_annotation_file_that_is_not_the_one_loaded(tmp_path, loaded_two):
    store = copied(loaded_two, tmp_path / "store")
    other = store.annotation_path("boxes_2d", "yard-2")
    store.annotation_path("boxes_2d", "yard-1").write_bytes(other.read_bytes())
    with pytest.raises(StoreError, match="boxes_2d/yard-1"):
        loading.rebuild(store, LoadRules(), 1)


def test_sequences_and_layers_that_are_gone_do_not_linger(tmp_path, loaded_one):
    first = {"yard-1": GOOD | {"3d": {0: [person_3d(1, 3, 0)]}}, "yard-2": GOOD}
    store = load_world(tmp_path, first)
    loading.load(find_root(write_root(tmp_path / "second", {"yard-1": GOOD})), store, LoadRules(), 1)
    same(store, loaded_one)
    assert list(store.manifest().sequences) == ["yard-1"]
    assert "3d" not in store.manifest().sequences["yard-1"].layers


# -- what goes wrong on the way ------------------------------------------------------------------------------------


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "first", "again"),
    [
        (0, "load", "rebuild"),
        (0, "rebuild", "load"),
        (1, "load", "load"),
        (1, "rebuild", "rebuild"),
    ],
)
def test_killed_between_any_two_moves_no_table_is_lost(
    tmp_path, monkeypatch, loaded_one, loaded_two, call, first, again
):
    """Also without the label files: they may be gone by then."""
    store = copied(loaded_two, tmp_path / "old")
    root = find_root(write_root(tmp_path / "new", {"yard-1": GOOD}))
    expected = loaded_one if first == "load" else loaded_two
    swap, calls = loading._swap, []

    def dying(place, new, gone):
        if len(calls) == call:
            raise Killed
        calls.append(place)
        swap(place, new, gone)

    monkeypatch.setattr(loading, "_swap", dying)
    with monkeypatch.context() as killed:
        # Nothing is tidied up by a process that is killed.
        killed.setattr(loading.shutil, "rmtree", lambda *a, **k: None)
        with pytest.raises(Killed):
            if first == "load":
                loading.load(root, store, LoadRules(), 1)
            else:
                loading.rebuild(store, LoadRules(), 1)
                raise Killed
    monkeypatch.setattr(loading, "_swap", swap)
    if again == "load":
        with pytest.raises(AvrError):
            loading.load(find_root(write_root(tmp_path / "bad", {"yard-1": {"2d": b"x"}})), store, LoadRules(), 1)
    assert run("load", "--rebuild", "--store", store.path, "--workers", 1)[0] == 0
    same(store, expected)


@pytest.mark.slow
@pytest.mark.parametrize(("limit_kb", "people"), [(20, 60), (300, 10)], ids=["a table", "the graph"])
def test_a_full_disk_is_one_line_and_leaves_the_old_store(tmp_path, loaded_one, limit_kb, people):
    store = copied(loaded_one, tmp_path / "store")
    large = {f"yard-{i}": {"2d": {f: crowd(f, people) for f in range(40)}} for i in range(2)}
    root = write_root(tmp_path / "large", large)
    size = {resource.RLIMIT_FSIZE: limit_kb << 10}
    result = run_program(COMMAND, "load", root, "--store", store.path, "--workers", 1, limits=size)
    said = result.stderr.decode()
    assert result.returncode == 1, said
    assert len(said.strip().splitlines()) == 1 and said.startswith("jrdb-avr: ")
    assert "Traceback" not in said
    assert ("graph" in said.replace(str(tmp_path), "")) == (limit_kb == 300)
    same(store, loaded_one)
    assert run("load", root, "--store", store.path, "--workers", 1)[0] == 0
    assert list(store.manifest().sequences) == ["yard-0", "yard-1"]


def crowd(frame, people):
    rng = random.Random(frame)
    return [person(i, (rng.uniform(0, 3700), 60, 50, 200), {"walking": 1}, (i, 1)) for i in range(people)]


def test_a_second_writer_is_refused_and_told_who_writes(tmp_path):
    root = write_root(tmp_path / "root", {"yard-1": GOOD})
    store = Store(tmp_path / "store")
    with store.writing("load"):
        result = run_program(COMMAND, "load", root, "--store", store.path)
        with pytest.raises(LockedError):
            store.writing("generate").__enter__()
    said = result.stderr.decode()
    assert result.returncode == 1 and f"'load', process {os.getpid()}" in said and len(said.strip().splitlines()) == 1
    with store.writing("generate"):
        pass


def test_an_open_graph_is_not_replaced_under_its_reader(tmp_path, loaded_one):
    store = copied(loaded_one, tmp_path / "store")
    before = files(store)
    root = write_root(tmp_path / "root", {"yard-1": GOOD})
    with Graph.open(store.graph_path, read_only=True), pytest.raises(LockedError):
        loading.load(find_root(root), store, LoadRules(), 1)
    assert files(store) == before


@pytest.mark.parametrize("place", ["a file", "under a file", "no permission"])
def test_a_store_that_cannot_be_written_is_one_line(tmp_path, place):
    root = write_root(tmp_path / "root", {"yard-1": GOOD})
    (tmp_path / "file").write_text("x")
    store = {"a file": tmp_path / "file", "under a file": tmp_path / "file" / "store"}.get(place, tmp_path / "locked")
    if place == "no permission":
        if os.geteuid() == 0:
            pytest.skip("the superuser may write everywhere")
        store.mkdir(mode=0o500)
    code, _, err = run("load", root, "--store", store)
    assert code == 2 if place == "a file" else (code == 1 and "choose another --store" in err and err.count("\n") == 1)
    assert (tmp_path / "file").read_text() == "x"


def test_a_file_that_is_gone_is_a_fault_and_not_fewer_rows(tmp_path, loaded_two):
    store = copied(loaded_two, tmp_path / "store")
    store.annotation_path("boxes_2d", "yard-1").unlink()
    with pytest.raises(QueryError, match=r"cannot read the files of annotations_boxes_2d: .*yard-1"):
        store.sql("SELECT count(*) FROM annotations_boxes_2d")
    assert store.sql("SELECT count(DISTINCT sequence) AS n FROM intervals_sightings")["n"].to_pylist() == [2]
    with pytest.raises(StoreError, match=r"boxes_2d.yard-1\.parquet"):
        Annotations.read(store, "yard-1", Rules()).people(0)


@pytest.mark.usefixtures("graphless")
def test_panoramas_that_lie_in_the_store_move_with_it(tmp_path):
    write_root(tmp_path / "store" / "root", {"yard-1": GOOD | {"images": range(40)}})
    assert run("load", tmp_path / "store" / "root", "--store", tmp_path / "store", "--workers", 1)[0] == 0
    moved = Store((tmp_path / "store").rename(tmp_path / "moved"))
    place = Path(moved.manifest().image_root)
    assert place.is_relative_to(moved.path) and (place / "yard-1").is_dir()
    rebuild(moved, LoadRules(), 1)
    assert moved.manifest().image_root == str(place)


# -- the command ---------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("graphless")
def test_json_is_one_array_of_rows_and_strict_fails_on_a_bad_record(tmp_path):
    bad = {"2d": {0: [person(1, (1, 1, 0, 0))], 15: [person(1, (1, 1, 20, 50))]}}
    root = write_root(tmp_path / "root", {"yard-1": GOOD, "yard-2": bad})
    code, out, err = run("load", root, "--store", tmp_path / "store", "--workers", 1, "--json")
    assert code == 0, err
    rows = json.loads(out)
    assert [row["sequence"] for row in rows] == ["yard-1", "yard-2"]
    expected = {
        "sequence": "yard-1",
        "layers": ["2d", "actions", "groups"],
        "boxes": 40,
        "problems": [],
        "files": {"2d": "labels_2d_stitched/yard-1.json"},
        "label_frames": {"first": 0, "last": 39, "count": 40},
    }
    assert {name: rows[0][name] for name in expected} == expected
    (problem,) = rows[1]["problems"]
    assert (problem["kind"], problem["count"], problem["file"]) == ("record", 1, "yard-2.json")
    assert (problem["frame"], problem["field"], problem["detail"]) == ("000000.jpg", "box", "[1.0, 1.0, 0.0, 0.0]")
    code, out, _ = run("load", root, "--store", tmp_path / "store", "--workers", 1, "--strict")
    assert code == 1
    assert "yard-2" in out and "2 sequences" in out
    # The good part is loaded all the same.
    assert len(Store(tmp_path / "store").manifest().sequences) == 2


@pytest.mark.usefixtures("graphless")
def test_rules_are_overridden_by_name(tmp_path):
    root = write_root(tmp_path / "root", {"yard-1": GOOD})
    store = Store(tmp_path / "store")
    assert run("load", root, "--store", store.path, "--rule", "gap_frames=3")[0] == 0
    assert store.manifest().load_rules == LoadRules(gap_frames=3)
    _, rebuilt, _ = run("load", "--rebuild", "--store", store.path, "--json")
    assert json.loads(rebuilt)[0]["sequence"] == "yard-1"
    assert store.manifest().load_rules == LoadRules(gap_frames=3)
    code, _, err = run("load", root, "--store", store.path, "--rule", "no_such_rule=3")
    assert code == 1 and "no_such_rule" in err


@pytest.mark.parametrize("arguments", ["", "root --rebuild", "root --rule x", "--rebuild --fingerprint f"])
def test_wrong_calls_are_usage_errors(tmp_path, monkeypatch, arguments):
    write_root(tmp_path / "root", {"yard-1": GOOD})
    monkeypatch.chdir(tmp_path)
    assert run("load", *arguments.split(), "--store", "store")[0] == 2


def test_missing_and_empty_roots_are_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    for root in (tmp_path / "empty", tmp_path / "missing"):
        code, _, err = run("load", root, "--store", tmp_path / "store")
        assert code == 1
        assert len(err.strip().splitlines()) == 1
    assert not (tmp_path / "store").exists()


@pytest.mark.usefixtures("graphless")
def test_terminal_escapes_of_a_file_are_not_printed(tmp_path):
    odd = {"2d": {0: [person(1, (1, 1, 20, 50), {"\x1b[31mred": 1})], "\x1b[2J.jpg": []}}
    root = write_root(tmp_path / "root", {"yard-1": odd})
    code, out, _ = run("load", root, "--store", tmp_path / "store")
    assert code == 0 and "red" in out and "\x1b" not in out


def test_reports_of_nothing_loadable_name_the_reason(tmp_path):
    with pytest.raises(AvrError, match="not UTF-8"):
        load_reported(tmp_path, {"yard-1": {"2d": b"\xff\xfe"}})


@pytest.mark.parametrize("gigabytes", [0.4, 1, 16])
def test_a_limited_address_space_is_told_in_a_line(tmp_path, gigabytes):
    store = load_world(tmp_path, {"yard-2020-01-01_0": GOOD})
    for command in (("load", tmp_path / "root"), ("load", "--rebuild"), ("cypher", "RETURN 1 AS n")):
        limited = ["prlimit", f"--as={int(gigabytes * 2**30)}", sys.executable, "-c", COMMAND]
        done = subprocess.run([*limited, *command, "--store", store.path], capture_output=True, text=True)
        assert done.returncode == 1 and re.fullmatch("jrdb-avr: .*ulimit -v.*\n", done.stderr), done.stderr
