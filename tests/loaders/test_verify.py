"""`load --verify` finds what has happened to a store since it was loaded, and a rebuild mends it."""

import contextlib
import json
import os
import random
import shutil
import subprocess
import time
from collections import defaultdict

import pyarrow as pa
import pytest
import warm
from entry import run
from scene_tables import table_store

from jrdb_avr.engine.generate import keyframe_graph
from jrdb_avr.engine.generate.keyframe_graph import DERIVED, ensure_layer
from jrdb_avr.loaders import verify
from jrdb_avr.loaders.graph import column_names
from jrdb_avr.loaders.load import load, rebuild
from jrdb_avr.loaders.root import find_root
from jrdb_avr.loaders.synthetic.write import plan, write
from jrdb_avr.loaders.verify import FILE, TABLES, UNFINISHED, VERIFY_STEPS, checks_of
from jrdb_avr.queries.beliefs.graph import make_world_tables
from jrdb_avr.queries.graph.file import PAGE, check_fingerprint, fingerprint_of, fingerprint_path
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.named import named_queries
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.beliefs import EpisodeRow
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS
from jrdb_avr.schema.rules import LoadRules, Rules

# Another way to everything than the one that is checked: whole nodes and edges, by the plans that the engine likes,
# keys one by one, and filters, which look at what the pages say of their own least and greatest values.
DUMP = """
import hashlib, sys
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.graph import KEYFRAME_NODES, KEYFRAME_RELS, SCENE_NODES, SCENE_RELS
with Graph.open(sys.argv[1], read_only=True) as graph:
    def ask(query, **params):
        rows = sorted(map(repr, graph.query(query, params, ordered=False, timeout_s=8).to_pylist()))
        print(hashlib.sha256("\\n".join(rows).encode()).hexdigest(), len(rows), flush=True)
    for table in SCENE_NODES | KEYFRAME_NODES:
        ask(f"MATCH (n:`{table}`) RETURN n")
    for table, (source, target, columns) in KEYFRAME_RELS.items():
        ask(f"MATCH (a)-[r:`{table}`]->(b) RETURN a, r, b")
        end, found = "b" if source == "Person" else "a", f"MATCH (a:{source})-[r:`{table}`]->(b:{target}) WHERE"
        for low in (0, 1 << 32):
            ask(f"{found} {end}.id >= $low AND {end}.id < $high RETURN a, r, b", low=low, high=low + (1 << 32))
    for table, (source, target, columns) in SCENE_RELS.items():
        ask(f"MATCH (a)-[r:{table}]->(b) RETURN a, r, b")
        time = "frame" if table == "SeenIn" else "first"
        for least in (20, 60, 100):
            ask(f"MATCH (a:{source})-[r:{table}]->(b:{target}) WHERE r.{time} >= $least RETURN r", least=least)
            ask(f"MATCH (b:{target})<-[r:{table}]-(a:{source}) WHERE r.{time} < $least RETURN b, r", least=least)
    for track in range(36):
        ask("MATCH (p:Person) WHERE p.id = $key RETURN p", key=f"yard-1_0/{track}")
"""

LAYER = KEYFRAME_NODES | KEYFRAME_RELS
LAST = 6
"""The id of the last node of a made-up table of the layer."""


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return with_layer(table_store(tmp_path_factory.mktemp("verify"), frames=91, people=10))


@pytest.fixture(scope="module")
def answers(store):
    """What queries answer about the store as it was loaded."""
    return dump(store)


@pytest.fixture
def copy(store, tmp_path):
    shutil.copytree(store.path, tmp_path / "store")
    return Store(tmp_path / "store")


@pytest.fixture(scope="module")
def small_store(tmp_path_factory):
    """One short sequence: a graph that has grown is read key by key."""
    return with_layer(table_store(tmp_path_factory.mktemp("small"), sequences=("yard-1_0",), frames=61, people=8))


def with_layer(store):
    """The store with a keyframe layer, made where `generate` would, but of made-up rows."""

    def made_up(context, tables):
        return {name: layer_rows(name, context.scene, context.low) for name in tables}

    first = [name for name in LAYER if name not in (*DERIVED, "Keyframes")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(keyframe_graph, "keyframe_tables", lambda context: made_up(context, first).items())
        patch.setattr(keyframe_graph, "derived_tables", lambda context: made_up(context, DERIVED))
        ensure_layer(store, Rules(), 1)
    return store


def layer_rows(name, scene, low):
    """Six nodes and one without edges, and six edges, from each node to that of the same number; nulls in the first."""
    persons = [f"{scene.sequence}/{track}" for track in scene.tracks]
    keys = defaultdict(lambda: range(low, low + LAST + 1), Person=persons)
    if name in KEYFRAME_NODES:
        rows = [keys[name], [scene.sequence] * (LAST + 1)]
    else:
        rows = [keys[end][:LAST] for end in KEYFRAME_RELS[name][:2]]
    made = {"STRING": "{} quartz".format, "INT64": int, "DOUBLE": float, "BOOLEAN": bool}
    rows += [[made[kind](n) if n else None for n in range(len(rows[0]))] for kind in layer_types(name)]
    return pa.table(rows, [column.strip("`") for column in column_names(name)])


def layer_types(name):
    """Types of the columns after the id and the sequence of a node, or after the ends of an edge."""
    columns = KEYFRAME_NODES[name].split(", ")[2:] if name in KEYFRAME_NODES else KEYFRAME_RELS[name][2]
    return [column.split()[1] for column in columns if name != "Keyframes"]


@pytest.fixture
def small(small_store, tmp_path):
    return Store(shutil.copytree(small_store.path, tmp_path / "small"))


def faults(store, timeout_s=60):
    return {check.what: check.fault for check in checks_of(store, timeout_s=timeout_s) if check.fault}


def dump(store):
    """What queries answer; ends early where one fails, crashes or does not end."""
    try:
        return warm.run(warm.script, DUMP, store.graph_path, timeout=60).stdout.decode()
    except subprocess.TimeoutExpired:
        return "timeout"


def overwrite(path, rng, page=None):
    """Write over one page: noise, zeros, another page or a few bytes. Returns which."""
    data = bytearray(path.read_bytes())
    at = PAGE * (rng.randrange(1, len(data) // PAGE) if page is None else page)
    kind = rng.choice(["noise", "zeros", "other page", "bytes"])
    if kind == "noise":
        data[at : at + PAGE] = rng.randbytes(PAGE)
    elif kind == "zeros":
        data[at : at + PAGE] = bytes(PAGE)
    elif kind == "other page":
        other = PAGE * rng.randrange(1, len(data) // PAGE)
        data[at : at + PAGE] = data[other : other + PAGE]
    else:
        for _ in range(8):
            data[at + rng.randrange(PAGE)] ^= rng.randrange(1, 256)
    path.write_bytes(data)
    return kind


def test_a_loaded_store_is_what_was_loaded(store):
    steps = []
    checks = checks_of(store, steps.append)
    assert [check.what for check in checks] == ["annotations", "intervals", *TABLES]
    assert not [check for check in checks if check.fault]
    assert sum(steps) == VERIFY_STEPS
    # Every part of the scene and of the layer is there to be compared.
    rows = store.manifest().graph
    assert all(check.checked == rows.get(check.what, check.checked) > 0 for check in checks[3:])


def test_every_overwritten_page_is_found_by_the_checksum(store, tmp_path):
    place = tmp_path / "graph.kuzu"
    before, data = fingerprint_of(store.graph_path), store.graph_path.read_bytes()
    kinds = set()
    for seed in range(8):
        place.write_bytes(data)
        kinds.add(overwrite(place, random.Random(seed)))
        assert (fingerprint_of(place) == before) == (place.read_bytes() == data)
    assert len(kinds) == 4


def damaged(store, answers, copy, seed):
    """Whether a damage that the checksum is blind to changes an answer, and what is found of it."""
    shutil.copy(store.graph_path, copy.graph_path)
    rng = random.Random(seed)
    for _ in range(40):
        overwrite(copy.graph_path, rng)
    reseal(copy)
    return dump(copy) != answers, faults(copy, 8)


def reseal(store):
    """Make the checksum that of the damaged file."""
    fingerprint_path(store.graph_path).write_text(json.dumps({**as_dict(fingerprint_of(store.graph_path))}))


def as_dict(seal):
    return {name: getattr(seal, name) for name in seal.__struct_fields__}


def test_a_damage_that_changes_answers_is_found_by_the_answers_alone(answers, copy):
    """Whole pages, with crashes and hangs, are damaged by the longer test below."""
    copy.graph_path.write_bytes(copy.graph_path.read_bytes().replace(b"walking", b"wolking"))
    reseal(copy)
    assert dump(copy) not in (answers, "timeout")
    found = faults(copy)
    assert set(found) == {"Action", "Performs", "MayPerform", "SeenIn", "Interacts", "MayInteract"}
    assert all("\n" not in fault for fault in found.values())


@pytest.mark.slow
def test_every_damage_that_changes_an_answer_is_found(store, answers, copy):
    changes = 0
    for seed in range(100, 200):
        changed, found = damaged(store, answers, copy, seed)
        changes += changed
        assert found or not changed, seed
    assert changes > 20


def test_a_graph_that_crashes_the_engine_is_a_line_each(copy):
    data = bytearray(copy.graph_path.read_bytes())
    rng = random.Random(3)
    data[PAGE:] = rng.randbytes(len(data) - PAGE)
    copy.graph_path.write_bytes(data)
    found = faults(copy, 12)
    assert set(found) == set(TABLES)


@pytest.mark.parametrize(("ends", "said"), [("os._exit(1)", "crashed while reading"), ("time.sleep(300)", "not end")])
def test_an_engine_that_crashes_or_hangs_is_waited_for_once(store, monkeypatch, ends, said):
    # The child reads one table and then ends so.
    serve_by(monkeypatch, {"os._exit(1)": _crash, "time.sleep(300)": _hang}[ends])
    began = time.monotonic()
    found = faults(store, 2)
    assert time.monotonic() - began < 120
    assert said in found["Sequence"]
    assert set(found) == {*TABLES} - {FILE}
    assert found["Handles"] == "not read, after Sequence"


@pytest.mark.slow
def test_a_table_may_take_long_while_its_reading_goes_on(store, monkeypatch):
    serve_by(monkeypatch, _slow)
    began = time.monotonic()
    assert not faults(store, 1)
    assert time.monotonic() - began > 2


def serve_by(monkeypatch, serve):
    """Let the child be another one."""
    monkeypatch.setattr(verify, "_serve", serve)
    child = verify._child

    @contextlib.contextmanager
    def started(path, tables):
        with child(path, tables) as answers:
            # On a busy machine its start alone may take longer than a table.
            answers.poll(60)
            yield answers

    monkeypatch.setattr(verify, "_child", started)


def _crash(answers, path, tables):
    answers.send([])
    os._exit(1)


def _slow(answers, path, tables):
    for at, _ in enumerate(tables):
        for _ in range(0 if at else 6):
            answers.send(None)
            time.sleep(0.4)
        answers.send([])


def _hang(answers, path, tables):
    answers.send([])
    time.sleep(300)


def test_tables_beside_the_scene_do_no_harm(small):
    with Graph.open(small.graph_path) as graph:
        make_world_tables(graph)
        ids = [f"r/{n}" for n in range(3_000)]
        graph.copy("Episode", pa.table(dict.fromkeys(EpisodeRow.__struct_fields__, ids)))
    now, built = fingerprint_of(small.graph_path), check_fingerprint(small.graph_path)
    assert now.crc32 != built.crc32
    assert now.size > built.size
    assert not faults(small)


def layer_changes(start):
    """For every second table of the layer a statement that changes a row, takes one away or adds one."""
    changes = {}
    for number, name in list(enumerate(LAYER))[start::2]:
        kind = number // 2 % 3
        if name == "Keyframes":
            changes[name] = "MATCH (k:Keyframes) SET k.rules = '{}'"
        elif name in KEYFRAME_NODES:
            found = f"MATCH (n:`{name}`) WHERE n.id = {LAST} "
            changes[name] = (found + "SET n.sequence = 's'", found + "DELETE n", f"CREATE (:`{name}` {{id: 9}})")[kind]
        else:
            source, target, columns = KEYFRAME_RELS[name]
            end = "b" if source == "Person" else "a"
            found = f"MATCH (a:{source})-[r:`{name}`]->(b:{target}) WHERE {end}.id = 2 "
            changed = f"SET r.{columns[0].split()[0]} = NULL" if columns else "DELETE r"
            changes[name] = found + (changed, "DELETE r", f"CREATE (a)-[:`{name}`]->(b)")[kind]
    return changes


@pytest.mark.parametrize(
    "changes",
    [
        layer_changes(0),
        layer_changes(1),
        {
            "Person": "MATCH (p:Person) WHERE p.track >= 0 SET p.age = 'ageless'",
            "Interacts": "MATCH (:Person)-[r:Interacts]->(:Person) WHERE r.first < 20 DELETE r",
            "Object": "MATCH (o:Object {id: 'yard-1_0/1:1'}) SET o.last_frame = NULL",
        },
        {
            "Action": "CREATE (:Action {name: 'flying', pose: true})",
            "SocialGroup": "MATCH (g:SocialGroup {id: 'yard-1_0/1'}) SET g.aim = ['none']",
            "SeenIn": "MATCH (:Person)-[r:SeenIn]->(:Frame) WHERE r.frame = 40 SET r.distance = 1.0",
        },
    ],
    ids=" ".join,
)
def test_changed_rows_are_found_in_their_tables(small, changes):
    with Graph.open(small.graph_path) as graph:
        for change in changes.values():
            graph.execute(change)
        graph.execute("CHECKPOINT")
        # An agent has written into the file as well: the answers alone must tell.
        make_world_tables(graph)
        graph.execute("CREATE (:Episode {id: 'r/q', run: 'r', question: 'q', sequence: 's', plan: ''})")
    assert faults(small).keys() == changes.keys()


def test_a_damaged_layer_alone_is_found(small):
    data = small.graph_path.read_bytes()
    small.graph_path.write_bytes(data.replace(b"quartz", b"quarks"))
    code, _, err = run("load", "--verify", "--store", small.path)
    assert code == 1
    assert err.splitlines() == [
        f"{small.path} is not what was loaded: run 'jrdb-avr load --rebuild --store {small.path}'"
    ]
    assert faults(small).keys() == {FILE, *(name for name in LAYER if "STRING" in layer_types(name))}


def test_generate_does_not_search_a_damaged_graph(small):
    small.graph_path.write_bytes(small.graph_path.read_bytes().replace(b"walking", b"wolking"))
    with pytest.raises(StoreError, match="is damaged: run 'jrdb-avr load --verify"):
        ensure_layer(small, Rules(), 1)


def test_a_layer_without_its_stamp_is_named_and_no_fault(small):
    with Graph.open(small.graph_path) as graph:
        graph.execute("MATCH (k:Keyframes) DELETE k")
        graph.execute("CHECKPOINT")
    reseal(small)
    checks = checks_of(small)
    assert [check.what for check in checks][-1] == UNFINISHED
    assert not [check for check in checks if check.fault]


def test_a_damaged_graph_is_rebuilt_to_the_same_answers(answers, copy):
    copy.graph_path.write_bytes(copy.graph_path.read_bytes()[:-PAGE])
    assert answers.count("\n") > 70
    assert dump(copy) != answers
    code, _, err = run("load", "--verify", "--store", copy.path)
    assert code == 1
    assert err.splitlines() == [
        f"{copy.path} is not what was loaded: run 'jrdb-avr load --rebuild --store {copy.path}'"
    ]
    again = err.partition("jrdb-avr ")[2].strip().strip("'").split()
    assert run(*again)[0] == 0
    assert not faults(copy)


def test_what_is_opened_checkpointed_or_copied_raises_no_alarm(copy, tmp_path):
    for _ in range(2):
        with Graph.open(copy.graph_path) as graph:
            graph.execute("CHECKPOINT")
    shutil.copytree(copy.path, tmp_path / "elsewhere")
    assert not faults(Store(tmp_path / "elsewhere"))


def test_a_deleted_graph_of_every_layer_is_rebuilt_to_the_same_kept_queries(tmp_path):
    list(write(plan(tmp_path / "root", [(120, 8)], 0, "none"), 1))
    store = Store(tmp_path / "store")
    load(find_root(tmp_path / "root"), store, LoadRules(), 1)
    (sequence,) = store.manifest().sequences
    given = {"sequence": sequence, "frame": 60, "track": 0}

    def answers():
        with Graph.open(store.graph_path, read_only=True) as graph:
            return {
                name: graph.query(query.text, query.values({k: given[k] for k in query.types if k in given}))
                for name, query in named_queries("cypher").items()
                # What asks for a run asks the world tables, for a range of ids the keyframe layer.
                if "run" not in query.types and "$low" not in query.text
            }

    before = answers()
    assert sum(table.num_rows > 0 for table in before.values()) >= len(before) - 4
    store.graph_path.unlink()
    assert "does not exist" in faults(store)[FILE]
    with pytest.raises(StoreError, match="load --rebuild"):
        answers()
    rebuild(store, LoadRules())
    assert answers() == before
    assert not faults(store)
