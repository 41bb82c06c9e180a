"""`jrdb-avr mcp`: let an agent that speaks MCP answer the questions."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from jrdb_avr.engine.commands._options import FOLDER, store_option
from jrdb_avr.engine.console import note, warnings_as_notes
from jrdb_avr.schema.errors import InputError

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store

_EXAMPLE: Final = """\b
Examples:
  jrdb-avr mcp --store S --http 8765 --model claude   serve, and print address and token
  jrdb-avr mcp --store S --images DIR                 started by an MCP client, over stdio
"""


@click.command(epilog=_EXAMPLE)
@store_option()
@click.option(
    "--http",
    "port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help="Serve at this port of 127.0.0.1; 0 takes a free one.",
)
@click.option("--i-trust-the-agent", "trusted", is_flag=True, help="Serve over stdio where the store holds answers.")
@click.option("--model", default="agent", show_default=True, help="Name of the agent, for the run and its reports.")
@click.option("--run-id", help="Name of the run; mcp-MODEL if left out.")
@click.option("--limit", type=click.IntRange(1), metavar="N", help="At most N questions.")
@click.option("--resume", is_flag=True, help="Go on with a run: ask what it has not answered.")
@click.option("--images", type=FOLDER, help="Folder with a folder of panoramas per sequence; the store's if left out.")
@click.option("--opaque", is_flag=True, help="Give names of sequences that say nothing of the place.")
def command(
    store: Store,
    port: int | None,
    trusted: bool,
    model: str,
    run_id: str | None,
    limit: int | None,
    resume: bool,
    images: Path | None,
    opaque: bool,
) -> None:
    """Serve the questions of a store to an agent over MCP, and keep what it answers as a run.

    Over standard input and output without --http. An agent that can read the store's answers proves nothing: over stdio
    such a store is refused. Needs the extra 'mcp'.
    """
    try:
        from jrdb_avr.engine.integrations.mcp import serve
    except ModuleNotFoundError as error:
        raise InputError(
            f"the package {(error.name or '').partition('.')[0]} is missing: pip install 'jrdb-avr[mcp]'"
        ) from None

    # Whoever ends the server gets the tables.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with warnings_as_notes():
        run = serve(
            store,
            port=port,
            trusted=trusted,
            model=model,
            run_id=run_id,
            limit=limit,
            resume=resume,
            images=images,
            opaque=opaque,
            ready=lambda url, token: click.echo(f"{url} {token}"),
        )
    note(f"next: jrdb-avr score --store {store.path} {run}")
