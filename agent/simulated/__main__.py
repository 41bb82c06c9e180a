"""`python -m jrdb_avr.agent.simulated [--port N] [--log FILE] [--profile P] [--knob NAME=VALUE ...]`: serve.

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

from jrdb_avr.agent.simulated.knobs import PROFILES, knob_table, parse
from jrdb_avr.agent.simulated.server import READY, Server
from jrdb_avr.schema.errors import InputError


def main() -> None:
    """Serve until stopped."""
    table = "\n".join(f"  {name}={value}  {what}" for name, value, what in knob_table())
    parser = argparse.ArgumentParser(
        prog="python -m jrdb_avr.agent.simulated",
        description="Serve the simulated model.",
        epilog=f"Knobs, with their defaults:\n{table}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--port", type=int, default=0, help="port on 127.0.0.1; a free one if left out")
    parser.add_argument("--log", type=Path, help="file for one JSON line per answer")
    parser.add_argument(
        "--profile", choices=PROFILES, default="perfect", help="knobs to begin with, but for models named as a profile"
    )
    parser.add_argument("--knob", action="append", default=[], metavar="NAME=VALUE", help="imperfection")
    options = parser.parse_args()
    try:
        knobs = parse(options.knob, PROFILES[options.profile])
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
