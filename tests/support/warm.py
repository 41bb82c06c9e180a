"""Processes that begin with everything imported: each is forked off one that has, where starting Python anew would cost
more than what the process is for."""

import contextlib
import ctypes
import multiprocessing
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

from jrdb_avr.queries.graph import guard
from jrdb_avr.queries.graph.file import ENGINE

IMPORTED = (
    "warm",
    "cv2",
    "duckdb",
    ENGINE,
    "httpx2",
    "httpcore2",
    "rich.progress",
    "rich.table",
    "pyarrow.parquet",
    # What Arrow asks whether it has pandas' columns before it.
    "pandas",
    "jrdb_avr.agent.preflight",
    "jrdb_avr.agent.model.client",
    "jrdb_avr.agent.simulated.__main__",
    "jrdb_avr.agent.methods.react",
    "jrdb_avr.agent.reference.method",
    "jrdb_avr.agent.beliefs.world_model",
    "jrdb_avr.engine.cli",
    "jrdb_avr.engine.commands.evaluate",
    "jrdb_avr.engine.commands.inspect",
    "jrdb_avr.engine.commands.load",
    "jrdb_avr.engine.commands.observe",
    "jrdb_avr.engine.commands.report",
    "jrdb_avr.engine.commands.sample",
    "jrdb_avr.engine.commands.validate",
    "jrdb_avr.engine.generate.run",
    "jrdb_avr.engine.run.evaluate",
    "jrdb_avr.engine.run.methods",
    "jrdb_avr.engine.run.judge",
    "jrdb_avr.engine.run.live_scores",
    "jrdb_avr.engine.validate.checks",
    "jrdb_avr.loaders.load",
    "jrdb_avr.loaders.synthetic.write",
    "jrdb_avr.loaders.verify",
)


def keep_memory():
    """Keep freed memory in the process.

    The allocator gives large pieces back to the system otherwise, which fills the next ones with zeros again: twenty
    megabytes for each table of a graph, and as many for the pictures of a sample.
    """
    trim_threshold, map_threshold = -1, -3
    # Only glibc has it.
    with contextlib.suppress(AttributeError):
        allocator = ctypes.CDLL(None)
        allocator.mallopt(trim_threshold, 256 << 20)
        allocator.mallopt(map_threshold, 32 << 20)


# Here and, as they import this first, in the processes that are forked.
keep_memory()


def context():
    """Of multiprocessing: its processes are new ones, without the threads and files of this, like spawned ones."""
    found = multiprocessing.get_context("forkserver")
    found.set_forkserver_preload(list(IMPORTED))
    return found


def started(function, *arguments, stdin=b"", limit=None, folder):
    """Start `function` in a process and a group of its own, its streams the files `in`, `out` and `err` of `folder`.

    `limit`: resources as for `resource.setrlimit`, {which: bytes}.
    """
    (folder / "in").write_bytes(stdin)
    process = context().Process(target=_child, args=(function, arguments, str(folder), limit or {}))
    process.start()
    return process


def run(function, *arguments, stdin=b"", limit=None, timeout=300):
    """As `subprocess.run` that captures: return code, stdout and stderr as bytes. Raises TimeoutExpired."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        process = started(function, *arguments, stdin=stdin, limit=limit, folder=folder)
        process.join(timeout)
        late = process.is_alive()
        if late:
            process.kill()
            process.join()
        code = process.exitcode
        process.close()
        if late:
            raise subprocess.TimeoutExpired(function.__name__, timeout)
        return subprocess.CompletedProcess(
            function.__name__, code, (folder / "out").read_bytes(), (folder / "err").read_bytes()
        )


def command_line(*arguments):
    """The command line, to be run in such a process."""
    from jrdb_avr.engine.cli import main

    sys.argv = ["jrdb-avr", *map(str, arguments)]
    main()


def script(text, *arguments):
    """A program's text, as `python -c` takes it."""
    sys.argv = ["-c", *map(str, arguments)]
    exec(text, {"__name__": "__main__"})


def _child(function, arguments, folder, limit):
    import resource

    os.setsid()
    for number, name in enumerate(("in", "out", "err")):
        opened = os.open(f"{folder}/{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC if number else os.O_RDONLY)
        os.dup2(opened, number)
        os.close(opened)
    sys.stdin, sys.stdout, sys.stderr = (os.fdopen(n, "w" if n else "r", closefd=False) for n in range(3))
    for which, size in limit.items():
        resource.setrlimit(which, (size, size))
    function(*arguments)


def run_statement(request, timeout_s):
    """For `guard.run_child`: the child that runs a Cypher statement."""
    return run(guard.serve, stdin=request, timeout=timeout_s)


@contextlib.contextmanager
def start_server(command, *, stdin, stdout, text):
    """As `subprocess.Popen` of `python -m jrdb_avr.agent.simulated`: its output and its lifeline are pipes too."""
    assert command[1:3] == ["-m", "jrdb_avr.agent.simulated"] and stdin == stdout == subprocess.PIPE and text
    held, lifeline = multiprocessing.Pipe(duplex=False)
    said, told = multiprocessing.Pipe(duplex=False)
    process = context().Process(target=_marker, args=(command[3:], held, told), daemon=True)
    process.start()
    held.close()
    told.close()
    with lifeline, said, os.fdopen(said.fileno(), closefd=False) as lines:
        try:
            yield SimpleNamespace(stdout=lines, kill=process.kill)
        finally:
            process.join()
            process.close()


def _marker(arguments, held, told):
    from jrdb_avr.agent.simulated.__main__ import main

    for number, pipe in enumerate((held, told)):
        os.dup2(pipe.fileno(), number)
        pipe.close()
    sys.stdin, sys.stdout = os.fdopen(0, closefd=False), os.fdopen(1, "w", closefd=False)
    sys.argv = ["marker", *arguments]
    main()
