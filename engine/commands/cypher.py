"""`jrdb-avr cypher`: ask the scene graph."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from jrdb_avr.engine.commands._query_options import asking_options, run_asking


@click.command(
    epilog="Examples: jrdb-avr cypher who_is_where --store S --param sequence=gates-ai-lab-2019-02-08_0 "
    "--param frame=15   |   jrdb-avr cypher 'MATCH (p:Person) RETURN count(*) AS people' --store S --json"
)
@asking_options
def command(**options: Any) -> None:
    """Ask the scene graph: QUERY is one reading Cypher statement, or the name of a kept one (see --list)."""

    def ask(store: Path, cypher: str, params: dict[str, Any], timeout_s: float) -> Any:
        from jrdb_avr.queries.graph.guard import ask_graph
        from jrdb_avr.queries.store import Store

        opened = Store(store)
        opened.manifest()
        return ask_graph(opened.graph_path, cypher, opened.known(params), timeout_s=timeout_s)

    run_asking("cypher", ask, **options)
