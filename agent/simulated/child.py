"""The marker model as a child process, for as long as a `with` block lasts."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from jrdb_avr.agent.simulated.noise import PERFECT, Knobs, settings
from jrdb_avr.schema.errors import EndpointError

_READY: Final = "marker ready at "


@contextmanager
def marker_server(log: Path | None = None, knobs: Knobs = PERFECT) -> Iterator[str]:
    """Start the server on a free loopback port and yield its base URL; `log` and `knobs` as in `server.Server`.

    Raises EndpointError if it does not start.
    """
    command = [sys.executable, "-m", "jrdb_avr.agent.simulated"]
    if log is not None:
        command += ["--log", str(log)]
    command += [part for setting in settings(knobs) for part in ("--knob", setting)]
    # The pipe to its standard input is its lifeline: it ends when this process does, however that happens.
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None, "the pipe was asked for"
            line = process.stdout.readline()
            if not line.startswith(_READY):
                raise EndpointError("the marker model's server did not start: run 'python -m jrdb_avr.agent.simulated'")
            yield line.removeprefix(_READY).strip()
        finally:
            process.kill()
