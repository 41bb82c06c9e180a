"""Serve the simulated model: `python -m jrdb_avr.agent.simulated --store S [--port N]`.

The command prints one line, `simulated model ready at URL`, and serves until it is stopped.
"""

from __future__ import annotations

import argparse

from jrdb_avr.agent.simulated.profiles import PROFILES, USUAL_PROFILE, parse_errors
from jrdb_avr.agent.simulated.server import Server
from jrdb_avr.agent.simulated.sight import Sight
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrError


def main() -> None:
    """Serve until stopped."""
    about = "Serve the simulated model, which reads the annotations of a store."
    parser = argparse.ArgumentParser("python -m jrdb_avr.agent.simulated", description=about)
    parser.add_argument("--store", required=True, help="store with annotations")
    parser.add_argument("--port", type=int, default=0, help="port on 127.0.0.1; default: a free one")
    parser.add_argument("--profile", choices=PROFILES, help="errors; default: the profile in the name of the model")
    parser.add_argument("--simulate", action="append", default=[], metavar="KEY=VALUE", help="change one setting")
    options = parser.parse_args()
    try:
        errors = parse_errors(options.simulate, PROFILES[options.profile or USUAL_PROFILE])
        sight = Sight(Store(options.store))
        server = Server(sight, errors if options.profile or options.simulate else None, options.port)
    except AvrError as error:
        parser.error(str(error))
    with server:
        print(f"simulated model ready at {server.url}", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    main()
