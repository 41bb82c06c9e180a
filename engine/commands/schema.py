"""`jrdb-avr schema`: print or draw the definitions of the tables of the graph and of the store."""

from __future__ import annotations

import click

from jrdb_avr.engine.commands._options import form_option
from jrdb_avr.engine.console import RowFormat, print_rows


@click.command()
@click.argument("what", metavar="graph|tables", type=click.Choice(["graph", "tables"]))
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--mermaid", is_flag=True, help="Print a Mermaid diagram of the tables.")
@form_option
def command(what: str, names: tuple[str, ...], mermaid: bool, form: RowFormat) -> None:
    """Print the tables of the graph (for queries with 'cypher') or the tables of the store (for queries with 'sql').

    If NAMEs are given, the command prints the columns of these tables. A NAME is the name of one table, or the name of
    a part, which selects all tables of the part. The parts of the graph are scene, keyframes and beliefs. The parts of
    the store are annotations, intervals, questions and runs. The command needs no store.

    Examples:
      jrdb-avr schema graph scene
      jrdb-avr schema tables predictions
      jrdb-avr schema graph --mermaid
    """
    from jrdb_avr.schema import catalog

    if form and mermaid:
        raise click.UsageError(f"choose one of --{form} and --mermaid")
    graph = what == "graph"
    tables = catalog.named(catalog.graph_tables() if graph else catalog.store_tables(), names)
    if mermaid:
        click.echo((catalog.graph_diagram if graph else catalog.store_diagram)(tables), nl=False)
    elif form or names:
        print_rows(catalog.column_rows(tables), form=form)
    else:
        rows = catalog.table_rows(tables)
        print_rows(rows if graph else [{name: row[name] for name in ("table", "part", "columns")} for row in rows])
