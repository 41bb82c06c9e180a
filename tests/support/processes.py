"""The command line in the tests' own process, and programs in processes of their own."""

import contextlib
import io
import json
import os
import resource
import subprocess
import sys
import time

import pyarrow as pa
import pytest
from environment import SUPPORT

from jrdb_avr.engine.cli import main
from jrdb_avr.queries.graph import guard
from jrdb_avr.schema.errors import QueryError, StoreError

COMMAND = "from jrdb_avr.engine.cli import main; main()"
"""The command line as a program's text."""


def run(*arguments):
    """Run the command line in this process and return its exit code, stdout and stderr."""
    out, err = (io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["jrdb-avr", *map(str, arguments)])
        patch.setattr(sys, "stdout", out)
        patch.setattr(sys, "stderr", err)
        try:
            main()
            code = 0
        except SystemExit as exit_:
            code = exit_.code
            if isinstance(code, str):
                # As Python ends a process.
                code = print(code, file=err) or 1
    return code, *(stream.buffer.getvalue().decode() for stream in (out, err))


def run_program(text, *arguments, stdin=b"", limits=None, timeout=300):
    """Run a program's text as `python -c` does and return the CompletedProcess with its bytes.

    limits: {resource: bytes} for `resource.setrlimit`.
    """
    return subprocess.run(
        **_program(text, arguments, limits), input=stdin, capture_output=True, timeout=timeout, check=False
    )


@contextlib.contextmanager
def started(text, *arguments, until):
    """Start a program in a process group of its own; yield its Popen if `until(process)` is true, and kill it then."""
    with subprocess.Popen(**_program(text, arguments), start_new_session=True, stdout=subprocess.PIPE) as process:
        try:
            while process.poll() is None and not until(process):
                time.sleep(0.002)
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, 9)


def _program(text, arguments, limits=None):
    def lower():
        for which, size in (limits or {}).items():
            resource.setrlimit(which, (size, size))

    paths = os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-P", "-c", text, *map(str, arguments)]
    return {"args": command, "env": os.environ | {"PYTHONPATH": paths}, "preexec_fn": lower if limits else None}


def run_statement_here(request, timeout_s):
    """Run a Cypher statement in this process, in place of `guard.run_child`, which starts one."""
    try:
        table = guard._read(**json.loads(request))
    except (QueryError, StoreError) as error:
        line = json.dumps([type(error).__name__, str(error)]).encode()
        return subprocess.CompletedProcess("statement", 1, b"", line)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return subprocess.CompletedProcess("statement", 0, sink.getvalue().to_pybytes(), b"")
