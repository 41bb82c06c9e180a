"""Runs that are killed at random points: resumed, they end as if nothing had been, and no finished call is made again.

A call is finished once its reply is in the run's `calls.jsonl`. What a server has served and the run has not kept when
it is killed was in flight: at most one call of each question at work. The server here counts by content, so the number
of times that it serves anything twice must be that of the calls in flight at the kills, to the very call.
"""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
from collections import Counter
from hashlib import sha256

import pyarrow.parquet as pq
import pytest
from fake_server import FakeServer, images, sound, texts
from painted import write_store
from world_calls import PLAN, tables_of

from jrdb_avr.queries.beliefs.graph import make_world_tables
from jrdb_avr.queries.beliefs.record import replay
from jrdb_avr.queries.graph.handle import Graph, build_graph
from jrdb_avr.schema.plan import canonical

AT_ONCE = 3
ASKED = 8

# One process that has everything imported and no thread forks each run: a run costs its own work alone.
LAUNCHER = """
import os, sys
import jrdb_avr.agent.methods.react, jrdb_avr.agent.reference.method, jrdb_avr.agent.world.episode
import jrdb_avr.engine.commands.evaluate, jrdb_avr.engine.run.evaluate, jrdb_avr.queries.beliefs.graph
from jrdb_avr.agent.model import transport
from jrdb_avr.engine import cli
transport._certificates(False)
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, 0); os.dup2(null, 1)
        sys.argv = ["jrdb-avr", *line.split()]
        try:
            cli.main()
        except SystemExit as end:
            os._exit(end.code or 0)
        os._exit(0)
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@pytest.fixture(scope="module")
def launcher():
    with subprocess.Popen(
        [sys.executable, "-c", LAUNCHER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process
        process.stdin.close()


def react(request):
    """Looks twice, then answers."""
    if len(images(request)) < 2:
        turn = {"action": "observe", "frame_id": "000000", "angle_deg": 180 * len(images(request))}
    else:
        turn = {"action": "answer", "answer": 1, "evidence_bboxes": [{"frame_id": "000000", "bbox": [1, 2, 30, 40]}]}
    return json.dumps(turn)


def agent(request):
    """Plans, looks, writes what it cannot know, and gives up."""
    text = texts(request)
    if text.rstrip().endswith("Your plan, as one JSON object:"):
        return canonical(PLAN)
    look = {"tool": "observe", "frame_id": "000000", "angle_deg": 10}
    person = {"tool": "add_entity", "id": "p1", "observation": "o1", "box": [0, 0, 90, 500]}
    other = {**person, "id": "p2", "box": [100, 0, 300, 500]}
    sits = {"tool": "add_attribute", "entity": "p1", "name": "pose", "value": "sitting", "observation": "o1"}
    walks, ungrounded = {**sits, "value": "walking"}, {**sits, "observation": "o7"}
    talks = {"tool": "add_relation", "source": "p1", "name": "relation conversation", "target": "p2"}
    state = text.rpartition("World: ")[2].partition("\n")[0]
    if "observation o1" not in text and "p1" not in state:
        return json.dumps({"calls": [look]})
    if "p2" not in state:
        talks["observation"] = "o1"
        return json.dumps({"calls": [person, other, sits, walks, ungrounded, talks, {"tool": "get_graph"}]})
    return "no more"


class Counted:
    """A server that counts by content what it serves, and kills the run at the calls it is told."""

    def __init__(self, script):
        self.script, self.served, self.lock = script, Counter(), threading.Lock()
        self.seen, self.at, self.before, self.pid = 0, 0, True, 0

    def __call__(self, request, n):
        with self.lock:
            self.served[sha256(json.dumps(request).encode()).hexdigest()] += 1
            self.seen += 1
            due = self.seen == self.at
        if due and self.before:
            self.kill()
        elif due:
            # While the reply is read, kept, acted upon, or the line of the journal written.
            threading.Timer(random.uniform(0, 0.02), self.kill).start()
        return self.script(request)

    def kill(self):
        # It may have ended by itself meanwhile.
        with contextlib.suppress(ProcessLookupError):
            if self.pid:
                os.kill(self.pid, signal.SIGKILL)


def start(launcher, store, url, method):
    options = f"--method {method} --model fake --base-url {url} --run-id r --limit {ASKED}"
    launcher.stdin.write(f"evaluate --store {store.path} {options} --concurrency {AT_ONCE} --no-scores --resume\n")
    launcher.stdin.flush()
    return int(launcher.stdout.readline())


def ended(launcher):
    return int(launcher.stdout.readline())


def kept(store):
    """What a run leaves, but for the time that it took."""
    tables = {n: pq.read_table(store.run_path("r") / f"{n}.parquet") for n in ("predictions", "steps", "world")}
    rows = {n: table.drop_columns([c for c in ("seconds",) if c in table.column_names]) for n, table in tables.items()}
    return {n: table.to_pylist() for n, table in rows.items()}


def in_graph(store):
    with Graph.open(store.graph_path, read_only=True) as graph:
        return tables_of(graph)


def new_store(path, asked_world):
    store = write_store(path, asked_world / "images")
    with build_graph(store.graph_path) as graph:
        make_world_tables(graph)
    return store


def finished_calls(path):
    """Requests with a whole line; a kill may have cut one short."""
    found = set()
    for line in path.read_bytes().splitlines() if path.exists() else ():
        with contextlib.suppress(ValueError):
            found.add(json.loads(line)["request"])
    return len(found)


def kill_and_resume(launcher, asked_world, folder, method, script, kills, seed):
    """Kill runs until so many were killed; each one is resumed until it ends. The store of an undisturbed one."""
    whole = new_store(folder / "whole", asked_world)
    with FakeServer(sound(counted := Counted(script))) as server:
        start(launcher, whole, server.url, method)
        assert ended(launcher) == 0
        calls = counted.seen
        assert set(counted.served.values()) == {1}
    expected = kept(whole), in_graph(whole)
    rng, run, deaths = random.Random(seed), 0, 0
    while deaths < kills:
        killed = new_store(folder / f"killed_{run}", asked_world)
        with FakeServer(sound(counted := Counted(script))) as server:
            in_flight = 0
            while deaths < kills:
                flying = killed_once(launcher, killed, server, counted, method, rng)
                if flying is None:
                    break
                in_flight += flying
                deaths += 1
            counted.at = 0
            start(launcher, killed, server.url, method)
            assert ended(launcher) == 0
            assert sum(counted.served.values()) - len(counted.served) <= in_flight
            assert len(counted.served) == calls
            served = counted.seen
            start(launcher, killed, server.url, method)
            assert ended(launcher) == 0
            assert counted.seen == served
        assert (kept(killed), in_graph(killed)) == expected
        run += 1
        # A slow machine may kill a run only after its end.
        assert run < 20, "runs of a few calls were never killed"
    return whole


def killed_once(launcher, store, server, counted, method, rng):
    """Run, and be killed: how many calls are in flight then. None where the run ended before."""
    counted.at = counted.seen + rng.randint(1, AT_ONCE)
    counted.before = rng.random() < 0.4
    # No call is counted before it is known what to kill.
    with counted.lock:
        counted.pid = start(launcher, store, server.url, method)
    code, counted.pid = ended(launcher), 0
    assert code in (0, -signal.SIGKILL)
    if not code:
        return None
    server.hear_out()
    flying = len(counted.served) - finished_calls(store.run_path("r") / "calls.jsonl")
    assert 0 <= flying <= AT_ONCE
    return flying


@pytest.mark.slow
def test_react_killed_and_resumed(launcher, asked_world, tmp_path):
    kill_and_resume(launcher, asked_world, tmp_path, "react", react, 1, 1)


@pytest.mark.slow
def test_agent_killed_and_resumed(launcher, asked_world, tmp_path):
    whole = kill_and_resume(launcher, asked_world, tmp_path, "agent", agent, 2, 2)
    record = pq.read_table(whole.run_path("r") / "world.parquet")
    assert {row["tool"] for row in record.to_pylist()} >= {"begin", "plan", "observe", "add_people", "add_relation"}
    made = {name: table.num_rows for name, table in replay(record).items()}
    assert made == {name: len(rows) for name, rows in in_graph(whole).items()}
