"""Completion in the shell: names of runs, sequences and saved queries.

Runs and sequences come from the store of the command line or of the environment. In bash, the line
`eval "$(_JRDB_AVR_COMPLETE=bash_source jrdb-avr)"` switches completion on. Other shells need zsh_source or fish_source.
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
    """Return a completion by `names(store)`. If no store is named, it completes nothing."""

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
    """Return the names of saved queries, in the language of the command, that begin with the typed text."""
    from jrdb_avr.queries.named import named_queries

    return [name for name in named_queries(str(ctx.info_name)) if name.startswith(incomplete)]
