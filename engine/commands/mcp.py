"""`jrdb-avr mcp`: serve the questions to an MCP agent."""

from __future__ import annotations

import signal
from typing import Any

import click

from jrdb_avr.engine.commands._declared import field_options
from jrdb_avr.engine.commands._next import scoring_steps
from jrdb_avr.engine.commands._options import Store, store_option
from jrdb_avr.engine.console import note, warnings_as_notes
from jrdb_avr.engine.run.options import MethodOptions, QuestionSelection, RunOptions
from jrdb_avr.schema.errors import InputError


@click.command()
@store_option()
@click.option(
    "--http",
    "port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help="Serve over HTTP on this port of 127.0.0.1. 0 chooses a free port.",
)
@click.option("--i-trust-the-agent", "trusted", is_flag=True, help="Serve over stdio even if the store holds answers.")
@click.option("--model", default="agent", show_default=True, help="Name of the agent in the run and in reports.")
@field_options(RunOptions, "run_id", "resume", "images")
@field_options(QuestionSelection, "limit")
@field_options(MethodOptions, "opaque")
def command(store: Store, port: int | None, trusted: bool, model: str, **options: Any) -> None:
    """Serve the questions of a store to an agent over MCP, and record the agent's answers as a run.

    With --http, the command prints the address and the token of the server. Without --http, the server uses standard
    input and output (stdio). Over stdio, the command refuses a store with answers, because an agent on the same machine
    could read the answers from the disk.

    The command needs more packages: pip install 'jrdb-avr[mcp]'.

    Examples:
      jrdb-avr mcp --store S --http 8765 --model claude   prints address and token
      jrdb-avr mcp --store S --images DIR                 is started by an MCP client
    """
    try:
        from jrdb_avr.engine.integrations.mcp import serve
    except ModuleNotFoundError as error:
        raise InputError(
            f"the package {(error.name or '').partition('.')[0]} is missing: pip install 'jrdb-avr[mcp]'"
        ) from None

    def ready(url: str, token: str) -> None:
        click.echo(f"{url} {token}")

    # A terminated server must stop as after Ctrl-C, because it writes the tables of the run when it stops.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with warnings_as_notes():
        run = serve(store, port=port, trusted=trusted, model=model, ready=ready, **options)
    note(f"next: {scoring_steps(store.path, run)}")
