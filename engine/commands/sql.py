"""`jrdb-avr sql`: ask the Parquet tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from jrdb_avr.engine.commands._query_options import asking_options, run_asking


@click.command(
    epilog="Examples: jrdb-avr sql question_counts --store S   |   "
    "jrdb-avr sql 'SELECT run_id, avg(answer_score) FROM scores GROUP BY 1 ORDER BY 1' --store S --csv   |   "
    "jrdb-avr sql 'SHOW TABLES' --store S"
)
@asking_options
def command(**options: Any) -> None:
    """Ask the Parquet tables: QUERY is one SELECT over the store's views, or the name of a kept one (see --list)."""

    def ask(store: Path, sql: str, params: dict[str, Any], timeout_s: float) -> Any:
        from jrdb_avr.queries.sql import ask_tables
        from jrdb_avr.queries.store import Store

        return ask_tables(Store(store), sql, params, timeout_s=timeout_s)

    run_asking("sql", ask, **options)
