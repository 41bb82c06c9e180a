"""The commands that the matrix kills, each with the state that it starts from, and what of its results is compared."""

import contextlib
import http.client
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from shlex import split

import pyarrow.parquet as pq

from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.schema.beliefs import WORLD_NODES, WORLD_RELS
from jrdb_avr.schema.graph import LAYER_NODES, LAYER_RELS, SCENE_NODES, SCENE_RELS

COMMAND = (sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()")
STORE = ("--store", "store")
REACT = (*split("evaluate --method react --model simulated:independent --limit 3 --run-id r --concurrency 2"), *STORE)
AGENT = (*split("evaluate --method agent --model simulated --limit 2 --run-id a --concurrency 2"), *STORE)
PLAY = (*split("play --limit 3 --run-id p"), *STORE)
FILLED = "is not empty"
LONGEST_S = 300
ENDING_S = 60


@dataclass(frozen=True)
class Case:
    """A command: the state that it starts from, its words, and whether its rerun needs --resume."""

    name: str
    state: str
    words: tuple[str, ...]
    resumed: bool = False
    done: str = "nothing"
    """What the rerun says where the killed command had done its work, and which is no failure then."""

    @property
    def rerun(self):
        return (*self.words, "--resume") if self.resumed else self.words


def all_cases(base):
    """Every case; `base` is the folder of the states."""
    tiny, lines = str(base / "tiny"), str(base / "mine.jsonl")
    return [
        Case("load", "empty", ("load", tiny, *STORE)),
        Case("load again", "answered", ("load", tiny, *STORE)),
        Case("rebuild", "answered", ("load", "--rebuild", *STORE)),
        Case("generate", "loaded", ("generate", *STORE)),
        Case("generate again", "answered", ("generate", *STORE, "--seed", "1", "--rule", "max_per_person=1")),
        Case("evaluate", "generated", REACT, resumed=True),
        Case("evaluate agent", "generated", AGENT, resumed=True),
        Case("score", "answered", ("score", "r", "a", *STORE)),
        Case("score lines", "answered", ("score", "--jsonl", lines, *STORE)),
        Case("report", "scored", ("report", "r", "a", "--html", "report.html", *STORE)),
        Case("export lines", "answered", ("export", "r", "--jsonl", "r.jsonl", *STORE)),
        Case("export public", "answered", ("export", "--public", "public", *STORE), done=FILLED),
        Case("export hf", "answered", ("export", "--hf", "hf", *STORE), done=FILLED),
        Case("submit", "answered", ("submit", "r", "bundle", *STORE), done=FILLED),
        Case("play", "generated", PLAY, resumed=True),
        Case("runs remove", "answered", ("runs", "remove", "a", "--yes", *STORE), done="has no run"),
        Case(
            "sample",
            "empty",
            tuple(split("sample made --sequences 1 --frames 60 --people 3 --images keyframes")),
            done=FILLED,
        ),
    ]


def make_states(base):
    """The states, each a folder, that cases start from. Made once."""
    done = base / "done"
    if done.exists():
        return
    shutil.rmtree(base, ignore_errors=True)
    (base / "empty").mkdir(parents=True)

    def run(state, *words):
        subprocess.run([*COMMAND, *words], cwd=base / state, check=True, stdout=subprocess.DEVNULL, stderr=2)

    def grown(state, source, *commands):
        shutil.copytree(base / source, base / state)
        for words in commands:
            run(state, *words)

    run("", *split("sample tiny --sequences 2 --frames 60 --people 3 --no-images"))
    run("", *split("sample root --sequences 1 --frames 200 --people 8 --images keyframes"))
    grown("loaded", "empty", ("load", str(base / "root"), *STORE))
    grown("generated", "loaded", ("generate", *STORE))
    # A key is drawn at random: one made here keeps exports equal.
    (base / "generated/store/opaque.key").write_text("a" * 64)
    (base / "generated/store/opaque.key").chmod(0o600)
    grown("answered", "generated", REACT, AGENT)
    grown("scored", "answered", ("score", *STORE))
    run("answered", "export", "r", "--jsonl", str(base / "mine.jsonl"), *STORE)
    done.touch()


# -- a command as a process --------------------------------------------------------------------------------------------


class Running:
    """A command in a process group of its own, its output in files; somebody plays where the command is `play`."""

    def __init__(self, words, work, streams, **environment):
        self.out, self.err = streams / "out", streams / "err"
        with self.out.open("wb") as out, self.err.open("wb") as err:
            self.process = subprocess.Popen(
                [*COMMAND, *words],
                cwd=work,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
                env={**os.environ, **environment},
            )
        if words[0] == "play":
            threading.Thread(target=self._play, daemon=True).start()

    @property
    def code(self):
        return self.process.poll()

    def wait(self):
        """Wait for the command itself to end; its exit code."""
        try:
            return self.process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            self.kill("group")
            self.process.wait()
            raise Finding(f"did not end within {LONGEST_S} s") from None

    def kill(self, whom):
        """Kill the process, its whole group, or one of its children: who was killed."""
        pid = self.process.pid
        with contextlib.suppress(ProcessLookupError):
            if whom == "child" and (children := descendants(pid)):
                os.kill(children[-1], signal.SIGKILL)
                return "child"
            if whom == "group":
                os.killpg(pid, signal.SIGKILL)
                return "group"
            os.kill(pid, signal.SIGKILL)
        return "parent"

    def said(self):
        return self.err.read_text("utf-8", "replace")

    def _play(self):
        """Play whatever is due: one look and an answer for each question; then end the command."""
        while not (url := self.out.read_text().strip()):
            if self.code is not None:
                return
        # A server that is gone was killed; one that refuses a move has no room for it, and is ended.
        with contextlib.suppress(ConnectionError, http.client.HTTPException, urllib.error.URLError):
            state = post(url, "state", {})
            while state.get("play") and (state["due"] or not state["play"]["over"]):
                play = state["play"]
                if play["over"]:
                    state = post(url, "next", {})
                    continue
                look = {"action": "observe", "frame_id": f"{play['frames'][0]:06d}", "angle_deg": 90}
                move = answer(play) if play["looks"] else look
                state = post(url, "move", {"question_id": play["question_id"], "move": move})
        if self.code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.process.pid, signal.SIGTERM)


def answer(play):
    value = {"frame": "000000", "frame_viewpoint": "000000", "span": ["000000", "000015"]}.get(play["mode"], 1)
    return {"action": "answer", "answer": value, "evidence_bboxes": []}


def post(url, path, body):
    with urllib.request.urlopen(urllib.request.Request(url + path, json.dumps(body).encode()), timeout=60) as reply:
        return json.loads(reply.read())


def descendants(pid):
    """The processes that a process started, and those that they did, oldest first."""
    parents = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
    found = [pid]
    for parent in found:
        found += sorted(child for child, own in parents.items() if own == parent)
    return found[1:]


def await_group(pid):
    """Wait until no process of a group is left."""
    end = time.monotonic() + ENDING_S
    while time.monotonic() < end:
        try:
            os.killpg(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.02)
    os.killpg(pid, signal.SIGKILL)
    raise Finding(f"processes were left over for {ENDING_S} s")


class Finding(Exception):  # noqa: N818
    """What is wrong after a kill."""


# -- what is compared --------------------------------------------------------------------------------------------------


def snapshot(folder, *, graphs=True):
    """A text or a set of texts for each file below a folder, equal where the files are but for times and processes."""
    return {
        path.relative_to(folder).as_posix(): content(path, graphs)
        for path in sorted(folder.rglob("*"))
        if not path.is_dir()
    }


def content(path, graphs):
    if path.name.endswith((".wal", ".shadow")):
        # Whoever opens the graph may finish what they hold, and removes them.
        return ""
    if path.parent.name == "journal":
        return lines_of(path)
    match path.name:
        case ".writing" | "graph.kuzu.lock" | "graph.kuzu.json":
            # Processes; the checksum of the graph's bytes, which differ; what the simulated model was sent.
            return ""
        case "graph.kuzu":
            return graph_content(path) if graphs else ""
        case "run.json":
            return run_content(path)
        case "calls.jsonl":
            return lines_of(path)
        case "predictions.parquet" | "steps.parquet" | "world.parquet":
            table = pq.read_table(path)
            kept = [name for name in table.column_names if name != "seconds"]
            return repr((table.schema.metadata, table.select(kept).to_pylist()))
    return sha256(path.read_bytes()).hexdigest()


def run_content(path):
    run = json.loads(path.read_bytes())
    run.pop("created")
    # How often the world model was read and written: a session that was killed is not counted.
    run.pop("world")
    run["settings"].get("endpoint", {}).pop("base_url", None)
    # What the checks of the server found when the run began; the child that is killed may be the server.
    run["settings"].pop("preflight", None)
    return json.dumps(run)


def lines_of(path):
    """The whole lines, in any order; of a question or a request the last, but none that ended in an error, as where the
    child that is killed is the model's server: they are answered again."""
    found = {}
    for line in path.read_bytes().splitlines():
        with contextlib.suppress(ValueError):
            entry = json.loads(line)
            for row in (entry.get("prediction", {}), *entry.get("steps", ())):
                row.pop("seconds", None)
            if entry.get("prediction", {}).get("status") != "error":
                found[entry.get("question_id") or entry["request"]] = json.dumps(entry)
    return frozenset(found.values())


def graph_content(path):
    """Every row of every table."""
    digest = sha256()
    with Graph.open(path, read_only=True) as graph:
        there = graph.tables()
        for name in sorted(there & (SCENE_NODES | LAYER_NODES | WORLD_NODES).keys()):
            add(digest, name, graph.query(f"MATCH (n:`{name}`) RETURN n.*", ordered=False))
        rels = SCENE_RELS | LAYER_RELS | WORLD_RELS
        keys = {name: columns.split()[0] for name, columns in (SCENE_NODES | LAYER_NODES | WORLD_NODES).items()}
        for name in sorted(there & rels.keys()):
            starts, target, columns = rels[name]
            for start in starts.split(":"):
                listed = "".join(f", r.{column.split()[0]} AS {column.split()[0]}" for column in columns)
                pattern = f"MATCH (a:`{start}`)-[r:`{name}`]->(b:`{target}`)"
                statement = f"{pattern} RETURN a.{keys[start]} AS source, b.{keys[target]} AS target{listed}"
                add(digest, name, graph.query(statement, ordered=False))
    return digest.hexdigest()


def add(digest, name, table):
    digest.update(name.encode())
    for row in sorted(map(repr, table.to_pylist())):
        digest.update(row.encode())


def differences(found, expected):
    """The files that differ between two snapshots, in a line each."""
    for name in sorted(found.keys() | expected.keys()):
        if name not in expected:
            yield f"{name} is left over"
        elif name not in found:
            yield f"{name} is missing"
        elif found[name] != expected[name]:
            yield f"{name} differs"


def half_written(found, before, after):
    """The files that are neither as they were nor as they are to be; hidden ones are nobody's, journals grow."""
    for name, own in found.items():
        # The engine's log and its half checkpoint: the next one who writes the graph finishes or drops them.
        hidden = any(part.startswith(".") for part in Path(name).parts) or name.endswith((".wal", ".shadow"))
        known = [state[name] for state in (before, after) if name in state]
        if hidden or own in known:
            continue
        if isinstance(own, frozenset) and any(own <= whole for whole in known):
            continue
        yield f"{name} is neither as it was nor as it is to be"
