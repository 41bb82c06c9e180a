"""The whole program from an object store on a cluster: `python tests/benchmarks/bench_cluster.py [--questions 100]`.

Sample annotations are put on a local server of S3's protocol, and load, generate, evaluate, score and report are run
twice: with folders alone, and with URLs alone on a Ray cluster of two workers, of which one is killed now and then.
Printed per stage: seconds of both, the highest resident memory of the command's own process, the machines whose worker
was killed, and whether the results are the same, byte by byte but for the run's time. Where they are not, or nothing
could be killed, the script ends with 1. Where `unshare` is allowed, the second machine has a host name of its own and
does not see the cache of the command, as one without a shared disk.

Needs the extras s3 and ray: `pip install '.[test,s3]' && pip install '.[test,ray]'`. Synthetic, all of it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import secrets
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

from jrdb_avr.queries.mirror import Mirror

BUCKET, RUN = "bucket", "run"
STORE, ROOT = f"s3://{BUCKET}/store", f"s3://{BUCKET}/root"

COMMAND = """
import re, sys
from pathlib import Path
from jrdb_avr.engine.cli import main
peak = Path(sys.argv.pop(1))
try:
    main()
finally:
    peak.write_text(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])
"""

ELSEWHERE = 'hostname elsewhere && mount --bind "$0" "$1" && shift && exec "$@"'
"""An empty folder in place of the cache, which all other processes see as it was."""

AT_WORK = ("ray::_at_place", "ray::_Actor")
"""Titles of workers while they work on a sequence, or answer questions."""

WORKING_S = 0.2
"""How long a worker must have worked when it is killed."""


@dataclass(frozen=True)
class Stage:
    """A command of the scenario.

    words: its arguments; writes: beginnings of the names of the files that it writes; kills: for each worker to kill,
    whether it is time, by the store's folder.
    """

    words: tuple[str, ...]
    writes: tuple[str, ...] = ()
    on_cluster: bool = True
    kills: tuple[Callable[[Path], bool], ...] = ()


@dataclass(frozen=True)
class Outcome:
    """Result of a command: its output, its cost, and the machines whose workers were killed while it ran."""

    printed: str
    seconds: float
    peak_mb: float
    killed: list[str]


def stages(questions: int, seed: int) -> dict[str, Stage]:
    """The five commands; all but their places."""
    chosen = ("--method", "react", "--model", "simulated", "--limit", str(questions), "--run-id", RUN)
    # Few at a time, and each reply waits, so that the work is not over before workers are killed.
    few = ("--concurrency", "2", "--marker", "latency=0.15")
    return {
        "load": Stage((), ("annotations/", "intervals/"), kills=(begun,)),
        "generate": Stage(
            ("--profile", "paper", "--seed", str(seed)), ("questions/",), kills=(makes_keyframes, searches)
        ),
        "evaluate": Stage(
            (*chosen, *few),
            tuple(f"runs/{RUN}/{name}.parquet" for name in ("predictions", "steps", "world")),
            kills=tuple(partial(has_answered, questions // part) for part in (10, 2)),
        ),
        "score": Stage((), (f"runs/{RUN}/scores.parquet",), on_cluster=False),
        "report": Stage(("--table", "all", "--json"), on_cluster=False),
    }


def begun(store: Path) -> bool:
    return True


def makes_keyframes(store: Path) -> bool:
    return (store / ".keyframes").exists()


def searches(store: Path) -> bool:
    return (store / ".candidates").exists() and not makes_keyframes(store)


def has_answered(count: int, store: Path) -> bool:
    journal = store / "runs" / RUN / "journal"
    return sum(path.read_bytes().count(b"\n") for path in journal.glob("*.jsonl")) >= max(count, 1)


# -- processes ---------------------------------------------------------------------------------------------------------


def command(scratch: Path, words: list[str], watch: Callable[[subprocess.Popen], list[str]] | None = None) -> Outcome:
    """Run a command of the program, and `watch` meanwhile. Ends the script where it fails."""
    out, err, peak = (scratch / name for name in ("out", "err", "peak"))
    began = time.monotonic()
    with out.open("wb") as printed, err.open("wb") as said:
        process = subprocess.Popen([sys.executable, "-c", COMMAND, peak, *words], stdout=printed, stderr=said)
    killed = watch(process) if watch else []
    if code := process.wait():
        sys.exit(f"jrdb-avr {' '.join(words)} ended with {code}:\n{err.read_text()}")
    return Outcome(out.read_text(), time.monotonic() - began, int(peak.read_text()) / 1024, killed)


def descendants(pid: int) -> list[int]:
    """A process, and all that it started."""
    found = [pid]
    for parent in found:
        for thread in Path(f"/proc/{parent}/task").glob("*/children"):
            with contextlib.suppress(OSError):
                found += map(int, thread.read_text().split())
    return found


@dataclass
class Killer:
    """Kills workers of a cluster's machines, each time of another one where one is at work there.

    machines: the processes that started them, by name. store: the folder that the command writes to.
    """

    machines: dict[str, int]
    store: Path
    working: dict[int, float] = field(default_factory=dict)
    """Since when the worker of a process is at work."""

    def watch(self, stage: Stage, process: subprocess.Popen) -> list[str]:
        """Kill the stage's workers while its command runs; returns the machines whose workers were killed."""
        killed: list[str] = []
        while process.poll() is None and len(killed) < len(stage.kills):
            for name in sorted(self.machines, key=killed.count):
                if self._kill(self.machines[name], partial(stage.kills[len(killed)], self.store)):
                    killed.append(name)
                    break
            time.sleep(0.02)
        return killed

    def _kill(self, machine: int, due: Callable[[], bool]) -> bool:
        for pid in descendants(machine):
            with contextlib.suppress(OSError):
                if not Path(f"/proc/{pid}/cmdline").read_text().startswith(AT_WORK):
                    self.working.pop(pid, None)
                elif time.monotonic() - self.working.setdefault(pid, time.monotonic()) > WORKING_S and due():
                    os.kill(pid, signal.SIGKILL)
                    return True
        return False


# -- the server and the cluster ----------------------------------------------------------------------------------------


@contextlib.contextmanager
def object_store(root: Path) -> Iterator[Any]:
    """A client of a local S3 server, which the environment names; its bucket holds the annotations and panoramas."""
    import boto3
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    os.environ |= {
        "AWS_ENDPOINT_URL": "http://{}:{}".format(*server.get_host_and_port()),
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    client = boto3.client("s3")
    client.create_bucket(Bucket=BUCKET)
    for path in root.rglob("*"):
        if path.is_file():
            client.upload_file(str(path), BUCKET, f"root/{path.relative_to(root)}")
    try:
        yield client
    finally:
        server.stop()


@contextlib.contextmanager
def cluster(scratch: Path) -> Iterator[dict[str, int]]:
    """A cluster of two machines with a processor each, which the environment names: their processes by name."""
    cache, other_cache = scratch / "cache", scratch / "elsewhere"
    port, client_port = free_ports()
    os.environ |= {"RAY_ADDRESS": f"127.0.0.1:{port}", "JRDB_AVR_CACHE": str(cache)}
    # Whether the user has a token of Ray's or not.
    os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    line = [sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--num-cpus=1", "--disable-usage-stats"]
    line += ["--min-worker-port=0", "--max-worker-port=0", "--object-store-memory=100000000"]
    head = ["--head", f"--port={port}", f"--ray-client-server-port={client_port}", "--include-dashboard=false"]
    head.append(f"--temp-dir={scratch / 'ray'}")
    other = [*line, f"--address={os.environ['RAY_ADDRESS']}"]
    cache.mkdir()
    other_cache.mkdir()
    if subprocess.run(["unshare", "--mount", "--uts", "true"], stderr=subprocess.DEVNULL).returncode == 0:
        other = ["unshare", "--mount", "--uts", "sh", "-c", ELSEWHERE, str(other_cache), str(cache), *other]
    with contextlib.ExitStack() as stack:
        yield {
            name: stack.enter_context(machine(words, scratch / f"{name}.log"))
            for name, words in {"head": [*line, *head], "other": other}.items()
        }


@contextlib.contextmanager
def machine(line: list[str], log: Path) -> Iterator[int]:
    """The process of a machine of the cluster, which is there when the block begins, and ends with it."""
    with log.open("wb") as written:
        process = subprocess.Popen(line, stdout=written, stderr=written, start_new_session=True)
    try:
        while "Ray runtime started" not in log.read_text():
            if process.poll() is not None:
                sys.exit(f"no cluster: {log.read_text()}")
            time.sleep(0.1)
        yield process.pid
    finally:
        started = descendants(process.pid)
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(20)
        for pid in started:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.wait()


def free_ports() -> list[int]:
    """Two ports that nobody listens at."""
    with socket.socket() as one, socket.socket() as two:
        for probe in (one, two):
            probe.bind(("127.0.0.1", 0))
        return [probe.getsockname()[1] for probe in (one, two)]


# -- the comparison ----------------------------------------------------------------------------------------------------


def download(client: Any, folder: Path) -> None:
    """Write all objects of the store into a folder."""
    for page in client.get_paginator("list_objects_v2").paginate(Bucket=BUCKET, Prefix="store/"):
        for entry in page["Contents"]:
            path = folder / entry["Key"].removeprefix("store/")
            path.parent.mkdir(parents=True, exist_ok=True)
            client.download_file(BUCKET, entry["Key"], str(path))


def differing(here: Path, there: Path, writes: tuple[str, ...]) -> list[str]:
    """The names of the tables that differ between two stores, or that one of them lacks."""
    found = {path.relative_to(store).as_posix() for store in (here, there) for path in store.rglob("*.parquet")}
    own = sorted(name for name in found if name.startswith(writes))
    assert own, f"nothing is written to {writes}"
    return [name for name in own if content(here / name) != content(there / name)]


def content(path: Path) -> Any:
    """Content to compare: a file's bytes, or the rows without `seconds` of a table that has it; None without a file."""
    if path.name not in ("predictions.parquet", "steps.parquet"):
        return path.read_bytes() if path.exists() else None
    return pq.read_table(path).drop_columns(["seconds"]).to_pylist()


def figures(printed: str) -> list[dict[str, Any]]:
    """The rows that `report` printed, but for the run's time and the address of its server."""
    rows = json.loads(printed)
    for row in rows:
        row.get("settings", {}).get("endpoint", {}).pop("base_url", None)
    return [{name: value for name, value in row.items() if "seconds" not in name} for row in rows]


# -- both ways ---------------------------------------------------------------------------------------------------------


def run_stages(scratch: Path, plan: dict[str, Stage], root: str, store: str, killer: Killer | None) -> list[Outcome]:
    """Run every stage with a root and a store; on the cluster where there is a killer of its workers."""
    found = []
    for name, stage in plan.items():
        words = [name, *([root] if name == "load" else []), *stage.words, "--store", store]
        if killer is None or not stage.on_cluster:
            found.append(command(scratch, words))
        else:
            found.append(command(scratch, [*words, "--executor", "ray"], partial(killer.watch, stage)))
    return found


def compared(options: argparse.Namespace, scratch: Path) -> Iterator[tuple[str, Outcome, Outcome, list[str], int]]:
    """Run both ways. Per stage: its name, what came of both, what differs, and workers that were not killed."""
    plan = stages(options.questions, options.seed)
    root, here, there = (scratch / name for name in ("root", "here", "there"))
    size = [f"--{name}={getattr(options, name)}" for name in ("sequences", "frames", "people", "seed")]
    command(scratch, ["sample", str(root), *size])
    local = run_stages(scratch, plan, str(root), str(here), None)
    with object_store(root) as client, cluster(scratch) as machines:
        remote = run_stages(scratch, plan, ROOT, STORE, Killer(machines, Mirror(STORE).folder))
        download(client, there)
    for (name, stage), own, other in zip(plan.items(), local, remote, strict=True):
        if stage.writes:
            different = differing(here, there, stage.writes)
        else:
            different = ["figures"] if figures(own.printed) != figures(other.printed) else []
        yield name, own, other, different, len(stage.kills) - len(other.killed)


def main() -> None:
    """Print the comparison; end with 1 where anything differs or was not killed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in {"questions": 100, "sequences": 3, "frames": 300, "people": 14, "seed": 0}.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    options, wrong = parser.parse_args(), False
    with tempfile.TemporaryDirectory(prefix="avr-") as folder:
        scratch = Path(folder)
        rows = list(compared(options, scratch))
        questions = pq.read_metadata(scratch / "here" / "runs" / RUN / "predictions.parquet").num_rows
        own = sum(path.is_file() for path in (scratch / "elsewhere").rglob("*"))
    print(f"synthetic: {options.sequences} sequences, {questions} questions; ", end="")
    print(f"the second machine fetched {own} files" if own else "both machines saw one cache")
    print(f"{'stage':<10}{'local s':>9}{'cluster s':>11}{'local MB':>10}{'cluster MB':>12}  {'killed':<14}identical")
    for name, local, remote, different, missed in rows:
        costs = f"{local.seconds:9.1f}{remote.seconds:11.1f}{local.peak_mb:10.0f}{remote.peak_mb:12.0f}"
        same = f"no: {', '.join(different)}" if different else "yes"
        print(f"{name:<10}{costs}  {', '.join(remote.killed) or 'none':<14}{same}")
        if missed:
            print(f"{name} was over before {missed} more could be killed")
        wrong = wrong or bool(different or missed)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
