"""`python -m jrdb_avr.agent.simulated [--port N] [--log FILE] [--knob NAME=VALUE ...]`: serve until the process ends.

Prints one line, `marker ready at URL`, once it takes requests. Ends by itself when its standard input is a pipe that
the parent process has closed, so that a killed run leaves no server behind.
"""

from __future__ import annotations

import argparse
import os
import stat
import sys
import threading
from pathlib import Path

from jrdb_avr.agent.simulated.noise import Knobs, parse
from jrdb_avr.agent.simulated.server import READY, Server
from jrdb_avr.schema.errors import InputError


def main() -> None:
    """Serve until stopped."""
    names = ", ".join(Knobs.__struct_fields__)
    parser = argparse.ArgumentParser(prog="python -m jrdb_avr.agent.simulated", description="Serve the marker model.")
    parser.add_argument("--port", type=int, default=0, help="port on 127.0.0.1; a free one if left out")
    parser.add_argument("--log", type=Path, help="file for one JSON line per answer")
    parser.add_argument(
        "--knob", action="append", default=[], metavar="NAME=VALUE", help=f"imperfection; NAME is one of {names}"
    )
    options = parser.parse_args()
    try:
        knobs = parse(options.knob)
    except InputError as error:
        parser.error(str(error))
    with Server(options.port, options.log, knobs) as server:
        print(f"{READY}{server.url}", flush=True)
        if stat.S_ISFIFO(os.fstat(0).st_mode):
            threading.Thread(target=_watch, args=(server,), daemon=True).start()
        server.serve_forever()


def _watch(server: Server) -> None:
    sys.stdin.buffer.read()
    server.shutdown()


if __name__ == "__main__":
    main()
