"""The graph handle: what the engine gets wrong is refused, locks hold, a build is all or nothing."""

import subprocess
import sys
import threading
from enum import IntEnum
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from processes import run_program

from jrdb_avr.queries.graph import database
from jrdb_avr.queries.graph.file import ENGINE, ENGINES, check_fingerprint
from jrdb_avr.queries.graph.handle import Graph, build_graph, hold_graph, open_worker_graph
from jrdb_avr.queries.graph.parameters import bind, parameters, strip_literals
from jrdb_avr.schema.errors import LockedError, QueryError, StoreError
from jrdb_avr.schema.graph import STORAGE_VERSION

NODES = "CREATE NODE TABLE N(id INT64 PRIMARY KEY, s STRING)"
EDGES = "CREATE REL TABLE R(FROM N TO N, k INT64)"


def fill(graph, edges, nodes=range(1, 5)):
    graph.execute(NODES)
    graph.execute(EDGES)
    graph.copy("N", pa.table({"id": pa.array(list(nodes), pa.int64()), "s": ["x"] * len(list(nodes))}))
    columns = [pa.array([edge[i] for edge in edges], pa.int64()) for i in range(3)]
    graph.copy("R", pa.table(columns, names=["from", "to", "k"]))


@pytest.fixture
def path(tmp_path):
    place = tmp_path / "graph.kuzu"
    with build_graph(place) as graph:
        fill(graph, [(1, 2, 0), (1, 2, 1)])
    return place


# -- plans ---------------------------------------------------------------------------------------------------------


def test_plans_are_made_anew_when_the_data_changes(memory):
    memory.execute(NODES)
    memory.execute(EDGES)
    memory.query("MATCH (n:N) RETURN count(*) AS n")
    assert memory._shared.plans
    memory.copy("N", pa.table({"id": [1], "s": ["x"]}))
    assert not memory._shared.plans


# -- results --------------------------------------------------------------------------------------------------------


def test_results_are_ordered_or_one_row(memory):
    fill(memory, [(1, 2, 0)])
    for fine in (
        "MATCH (n:N) RETURN n.id AS i ORDER BY i",
        "MATCH (n:N) RETURN n.id AS i ORDER BY i DESC LIMIT 2",
        "MATCH (n:N) RETURN n.id AS i ORDER BY i SKIP 1",
        "MATCH (n:N) RETURN count(*) AS c, max(n.id) AS m",
        "MATCH (n:N) RETURN n.s AS s, count(*) AS c ORDER BY s;",
    ):
        assert isinstance(memory.query(fine), pa.Table)
    for open_order in (
        "MATCH (n:N) RETURN n.id",
        "MATCH (n:N) RETURN n.s, count(*)",
        "MATCH (n:N) RETURN n.id LIMIT 2",
        "UNWIND [1, 2] AS x RETURN x",
        "MATCH (n:N) WITH n ORDER BY n.id LIMIT 3 MATCH (n)-[:R]->(m:N) RETURN n.id, m.id",
    ):
        with pytest.raises(QueryError, match="ORDER BY"):
            memory.query(open_order)
        memory.query(open_order, ordered=False)
    assert memory.query("MATCH (n:N) RETURN n.id AS i ORDER BY i DESC")["i"].to_pylist() == [4, 3, 2, 1]


def test_reading_refuses_writes_and_second_statements(memory):
    fill(memory, [])
    for writes in ("CREATE (n:N {id: 9})", "MATCH (n:N) SET n.s = 'y'", "MATCH (n:N) DELETE n", "MERGE (n:N {id: 9})"):
        with pytest.raises(QueryError, match="writes"):
            memory.query(writes)
    with pytest.raises(QueryError, match="one statement"):
        memory.query("MATCH (n:N) RETURN count(*); MATCH (n:N) DELETE n")
    assert memory.query("MATCH (n:N) WHERE n.s = 'x' RETURN count(*) AS n")["n"].to_pylist() == [4]
    with pytest.raises(QueryError) as error:
        memory.query("MATCH bogus")
    assert "\n" not in str(error.value)


def test_timeout(memory):
    memory.execute(NODES)
    memory.copy("N", pa.table({"id": range(3000), "s": ["x"] * 3000}))
    with pytest.raises(QueryError, match=r"stopped after 0\.2 s"):
        memory.query("MATCH (a:N), (b:N), (c:N) WHERE a.id + b.id > c.id RETURN count(*) AS n", timeout_s=0.2)
    assert memory.query("MATCH (a:N) RETURN count(*) AS n")["n"].to_pylist() == [3000]


# -- parameters -----------------------------------------------------------------------------------------------------


def test_small_integers_are_bound_wide(memory):
    fill(memory, [])
    assert memory.query("RETURN $n + 1000 AS x ORDER BY x", {"n": 5})["x"].type == pa.int64()
    rows = [{"k": 1, "s": "a"}, {"k": 2000, "s": None}]
    found = memory.query("UNWIND $rows AS r RETURN r.k AS k, r.s AS s ORDER BY k", {"rows": rows})
    assert found.to_pylist() == rows
    wide = memory.query(
        "MATCH (n:N) WHERE n.id IN $ids RETURN n.id AS i ORDER BY i LIMIT $k", {"ids": [3, 2**40], "k": 2}
    )
    assert wide["i"].to_pylist() == [3]
    numpy_given = memory.query("MATCH (n:N) WHERE n.id = $i RETURN count(*) AS c", {"i": np.int64(3)})
    assert numpy_given["c"].to_pylist() == [1]
    member_given = memory.query("MATCH (n:N) WHERE n.id = $i RETURN count(*) AS c", {"i": IntEnum("E", {"A": 3}).A})
    assert member_given["c"].to_pylist() == [1]


@pytest.mark.parametrize(
    ("cypher", "params"),
    [
        ("RETURN $a AS x", {}),
        ("RETURN 1 AS x", {"a": 1}),
        ("RETURN '$a' AS x", {"a": 1}),
        ("RETURN $A AS x", {"a": 1}),
        ("RETURN $a AS x", {"a": 2**63}),
        ("RETURN $a AS x", {"a": object()}),
        ("RETURN $a AS x", {"a": [1, "x"]}),
        ("RETURN $a AS x", {"a": [{"k": 1}, {"j": 1}]}),
    ],
)
def test_wrong_parameters_are_refused(cypher, params):
    with pytest.raises(QueryError):
        bind(cypher, params)


INTEGERS = st.integers(-(2**63), 2**63 - 1)
TEXTS = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=8)


@given(st.one_of(st.booleans(), INTEGERS, st.floats(allow_nan=False), TEXTS, st.lists(INTEGERS, max_size=4)))
@settings(max_examples=80, deadline=None)
def test_values_come_back_as_they_went(value):
    assert _shared_memory().query("RETURN $v AS v", {"v": value}, ordered=False)["v"].to_pylist() == [value]


_kept = []


def _shared_memory():
    if not _kept:
        _kept.append(Graph.memory())
    return _kept[0]


def test_quotes_and_comments_hold_no_parameters():
    text = "RETURN '$a', \"$b\", `$c`, $d // $e\n/* $f */ + $g"
    assert parameters(text) == ["d", "g"]
    assert "$" not in strip_literals(text).replace("$d", "").replace("$g", "")


# -- processes ------------------------------------------------------------------------------------------------------

CHILD = """
import sys
from jrdb_avr.queries.graph.handle import Graph, build_graph, hold_graph, open_worker_graph
from jrdb_avr.queries.graph.file import check_fingerprint
from jrdb_avr.schema.errors import LockedError
try:
    if sys.argv[2] == "build":
        with build_graph(sys.argv[1]):
            pass
    with Graph.open(sys.argv[1], read_only=sys.argv[2] == "read") as graph:
        print(graph.query("MATCH (n:N) RETURN count(*) AS n")["n"].to_pylist()[0], flush=True)
        if len(sys.argv) > 3:
            sys.stdin.read()
except LockedError as error:
    print("LOCKED", error)
"""


def child(path, mode, *more, **options):
    return [sys.executable, "-c", CHILD, str(path), mode, *more]


def ask_child(path, mode):
    done = run_program(CHILD, path, mode)
    assert done.returncode == 0, done.stderr
    return done.stdout.decode().strip()


@pytest.mark.parametrize(("read_only", "refused"), [(False, {"read", "write", "build"}), (True, {"write", "build"})])
def test_a_writer_keeps_other_processes_out_and_readers_keep_writers_out(path, read_only, refused):
    with Graph.open(path, read_only=read_only):
        for mode in ("read", "write", "build"):
            printed = ask_child(path, mode)
            assert printed.startswith("LOCKED") and "process" in printed if mode in refused else printed == "4"
    assert ask_child(path, "write") == "4"


@pytest.mark.slow
def test_the_holder_is_named(path):
    with subprocess.Popen(child(path, "write", "wait"), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout.readline().strip() == b"4"
        with pytest.raises(LockedError, match=f"process {other.pid}") as error:
            Graph.open(path)
        assert str(other.pid) in error.value.holder
        other.stdin.close()
    Graph.open(path).close()


@pytest.mark.slow
def test_a_killed_holder_lets_go(path):
    with subprocess.Popen(child(path, "write", "wait"), stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        other.stdout.readline()
        other.kill()
    with Graph.open(path) as graph:
        assert graph.query("MATCH (n:N) RETURN count(*) AS n")["n"].to_pylist() == [4]


# -- one process ----------------------------------------------------------------------------------------------------


def test_two_openings_share_one_database(path):
    with Graph.open(path) as one, Graph.open(path.parent / "." / path.name) as two:
        assert one._shared is two._shared
        one.execute("CREATE (n:N {id: $i, s: 'new'})", {"i": 77})
        assert two.query("MATCH (n:N {id: 77}) RETURN n.s AS s ORDER BY s")["s"].to_pylist() == ["new"]
        one.close()
        one.close()
        assert two.query("MATCH (n:N) RETURN count(*) AS n")["n"].to_pylist() == [5]
        with pytest.raises(QueryError, match="closed"):
            one.query("MATCH (n:N) RETURN count(*) AS n")
    assert not database._registry


def test_a_graph_is_read_by_one_thread(path):
    # By two, some two in a hundred results of eight rows came in the order of neither their keys nor their texts.
    for read_only in (True, False):
        with Graph.open(path, read_only=read_only) as graph:
            found = graph.query("CALL current_setting('threads') RETURN *", ordered=False)
            assert found["threads"].to_pylist() == ["1"]


def test_a_reader_here_keeps_a_writer_here_out(path):
    with Graph.open(path, read_only=True) as graph:
        with pytest.raises(LockedError, match="this process"):
            Graph.open(path)
        with pytest.raises(LockedError, match="this process"), build_graph(path):
            pass
        with pytest.raises(QueryError, match="reading only"):
            graph.execute("CREATE (n:N {id: 9})")
    with Graph.open(path), Graph.open(path, read_only=True) as graph, pytest.raises(QueryError, match="reading only"):
        graph.copy("N", pa.table({"id": [9], "s": ["x"]}))


def test_writers_of_several_threads_wait_for_each_other(path):
    def write(start):
        with Graph.open(path) as graph:
            for i in range(start, start + 20):
                with graph.transaction():
                    graph.execute("CREATE (n:N {id: $i, s: 'a'})", {"i": i})
                    graph.execute("MATCH (n:N {id: $i}) SET n.s = 'b'", {"i": i})

    with Graph.open(path) as keep:
        threads = [threading.Thread(target=write, args=(start,)) for start in (100, 200, 300, 400)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert keep.query("MATCH (n:N) WHERE n.s = 'b' RETURN count(*) AS n")["n"].to_pylist() == [80]


def test_a_transaction_is_all_or_nothing(path):
    with Graph.open(path) as graph:
        for fault in ("CREATE (n:N {id: 1})", "BOGUS"):
            with pytest.raises(QueryError), graph.transaction():
                graph.execute("CREATE (n:N {id: 500})")
                graph.execute(fault)
        with pytest.raises(ZeroDivisionError), graph.transaction():
            graph.execute("CREATE (n:N {id: 500})")
            raise ZeroDivisionError
        assert graph.query("MATCH (n:N {id: 500}) RETURN count(*) AS n")["n"].to_pylist() == [0]
        with graph.transaction():
            graph.execute("CREATE (n:N {id: 500})")
        assert graph.query("MATCH (n:N {id: 500}) RETURN count(*) AS n")["n"].to_pylist() == [1]


# -- building -------------------------------------------------------------------------------------------------------


def names(folder):
    return sorted(place.name for place in folder.iterdir())


def test_a_failed_build_leaves_the_old_graph(path):
    with pytest.raises(ZeroDivisionError), build_graph(path) as graph:
        graph.execute(NODES)
        raise ZeroDivisionError
    assert names(path.parent) == ["graph.kuzu", "graph.kuzu.json", "graph.kuzu.lock"]
    assert ask_child(path, "read") == "4"


def test_a_build_replaces_the_graph_and_sweeps_up(path):
    stale = path.with_name(".graph.kuzu.building")
    stale.write_bytes(b"left by a killed builder")
    stale.with_name(stale.name + ".wal").write_bytes(b"its log")
    path.with_name("graph.kuzu.wal").write_bytes(b"the old graph's log")
    with build_graph(path) as graph:
        fill(graph, [], range(10))
    assert names(path.parent) == ["graph.kuzu", "graph.kuzu.json", "graph.kuzu.lock"]
    assert ask_child(path, "read") == "10"


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: b"x" * len(data),
        lambda data: data[:-1],
        lambda data: data[: len(data) // 8192 * 4096],
        # Cut at a page's edge, by one page: the engine opens it and answers.
        lambda data: data[:-4096],
        lambda data: data[:4] + bytes([40]) + data[5:],
    ],
)
def test_a_damaged_graph_is_noticed_at_open_and_says_how_to_rebuild(path, damage):
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(StoreError, match=f"run 'jrdb-avr load --rebuild --store {path.parent}'") as error:
        Graph.open(path)
    assert "\n" not in str(error.value)
    assert not database._registry


@pytest.mark.parametrize(
    ("seal", "words"),
    [
        (None, "no readable graph.kuzu.json"),
        ("", "no readable graph.kuzu.json"),
        (
            '{"storage_version":1,"size":4096,"sha256":"","rows":{}}',
            f"version 1 of the tables, this program has {STORAGE_VERSION}",
        ),
    ],
)
def test_a_graph_of_another_version_is_noticed_at_open(path, seal, words):
    place = path.with_name("graph.kuzu.json")
    place.unlink() if seal is None else place.write_text(seal)
    with pytest.raises(StoreError, match=f"{words}.*run 'jrdb-avr load --rebuild --store"):
        Graph.open(path, read_only=True)
    with build_graph(path) as graph:
        fill(graph, [])
    Graph.open(path, read_only=True).close()


def test_a_graph_of_another_engine_is_noticed_at_open(path):
    magic, other = next(item for item in ENGINES.items() if item[1] != ENGINE)
    path.write_bytes(magic + path.read_bytes()[4:])
    with pytest.raises(StoreError, match=f"is a file of {other}, not of {ENGINE}: set JRDB_AVR_ENGINE={other}, or run"):
        Graph.open(path)


def test_an_engine_that_is_not_there_says_what_to_do(monkeypatch):
    monkeypatch.setattr(database, "ENGINE", "ladybug")
    monkeypatch.setitem(sys.modules, "ladybug", None)
    with pytest.raises(StoreError, match=r"not installed: pip install 'jrdb-avr\[ladybug\]'"):
        Graph.memory()
    monkeypatch.setattr(database, "ENGINE", "neo4j")
    with pytest.raises(StoreError, match="JRDB_AVR_ENGINE is neo4j: give kuzu or ladybug"):
        Graph.memory()


def test_writing_later_keeps_the_seal(path):
    """Opening for writing changes the first page; tables beside the scene's make the file longer."""
    before = check_fingerprint(path)
    Graph.open(path).close()
    assert check_fingerprint(path) == before
    with Graph.open(path) as graph:
        graph.execute("CREATE NODE TABLE Later(id INT64 PRIMARY KEY, s STRING)")
        graph.copy("Later", pa.table({"id": range(50_000), "s": [str(n) for n in range(50_000)]}))
    assert path.stat().st_size > before.size
    with Graph.open(path, read_only=True) as graph:
        assert graph.query("MATCH (n:Later) RETURN count(*) AS n")["n"].to_pylist() == [50_000]


def test_no_graph(tmp_path):
    with pytest.raises(StoreError, match="does not exist"):
        Graph.open(tmp_path / "graph.kuzu")
    with pytest.raises(StoreError):
        Graph.open(tmp_path / "nowhere" / "graph.kuzu", read_only=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError), build_graph(tmp_path / "file" / "graph.kuzu"):
        pass


def test_rows_are_handed_in_anew_each_time_where_statements_are_prepared():
    """The engine keeps a table of rows with the statement that was prepared with it."""
    with Graph.memory(prepares=True) as graph:
        graph.execute("CREATE NODE TABLE P(id INT64 PRIMARY KEY)")
        for start in (0, 2, 4):
            graph.copy("P", pa.table({"id": [start, start + 1]}))
            load = "LOAD FROM $rows WITH id WHERE id < $below RETURN id ORDER BY id"
            found = graph.query(load, {"rows": pa.table({"id": [start, 9]}), "below": 7})
            assert found["id"].to_pylist() == [start]
        assert graph.query("MATCH (p:P) RETURN p.id AS id ORDER BY id")["id"].to_pylist() == list(range(6))


def test_a_single_worker_opens_the_file_once_while_it_holds_the_graph(path):
    def opened():
        with open_worker_graph(path) as graph:
            return graph._shared

    with hold_graph(path, 1):
        assert opened() is opened()
    with hold_graph(path, 2):
        assert opened() is not opened()


def test_a_full_disk_is_told_before_anything_is_written_and_hinders_no_reading(path, monkeypatch):
    """In the middle of a transaction or a checkpoint the engine may abort the process where the disk is full."""
    before = path.read_bytes()
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=1 << 20))
    with pytest.raises(StoreError, match="free some space"):
        Graph.open(path)
    with pytest.raises(StoreError, match="free some space"), build_graph(path):
        pass
    with Graph.open(path, read_only=True) as graph:
        assert graph.query("RETURN 1 AS one", ordered=False)["one"].to_pylist() == [1]
    assert path.read_bytes() == before


@pytest.mark.parametrize(("error", "tried"), [("No space left on device", False), ("Binder exception: no", True)])
def test_after_a_write_that_failed_for_the_disk_no_checkpoint_is_tried(error, tried):
    """The engine may never come back from it; its log holds what was committed."""
    said = []

    class Disk:
        def __init__(self, connection):
            self.connection = connection

        def __getattr__(self, name):
            return getattr(self.connection, name)

        def execute(self, text, *given):
            said.append(text)
            if text.startswith("CREATE"):
                raise RuntimeError(error)
            return self.connection.execute(text, *given)

    graph = Graph.memory()
    graph._connection = Disk(graph._connection)
    with pytest.raises(QueryError if tried else StoreError):
        graph.execute("CREATE NODE TABLE Thing(id INT64 PRIMARY KEY)")
    graph.close()
    assert ("CALL force_checkpoint_on_close=false" not in said) == tried
