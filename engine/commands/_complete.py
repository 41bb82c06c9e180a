"""Shell completion for the names of runs, sequences and saved queries.

The runs and sequences belong to the store that `--store` or the environment variable JRDB_AVR_STORE names. In bash, the
line `eval "$(_JRDB_AVR_COMPLETE=bash_source jrdb-avr)"` switches completion on. In zsh or fish, replace bash_source by
zsh_source or fish_source.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import click

from jrdb_avr.schema.errors import AvrError

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store

Complete = Callable[[click.Context, click.Parameter, str], list[str]]


def _of_store(names: Callable[[Store], Iterable[str]]) -> Complete:
    """Return a function that completes the names in a store. It suggests nothing if the command line names no store."""

    def complete(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
        store = ctx.params.get("store")
        try:
            return [] if store is None else [name for name in names(store) if name.startswith(incomplete)]
        except (AvrError, OSError):
            return []

    return complete


def _runs(store: Store) -> list[str]:
    from jrdb_avr.queries.runs import run_ids

    return run_ids(store)


complete_run = _of_store(_runs)
complete_sequence = _of_store(lambda store: sorted(store.manifest().sequences))


def complete_query(ctx: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Return the saved queries of the command `cypher` or `sql` with names that begin with the typed text."""
    from jrdb_avr.queries.named import named_queries

    return [name for name in named_queries(str(ctx.info_name)) if name.startswith(incomplete)]
