"""`jrdb-avr import-questions`: import questions that another program wrote."""

from __future__ import annotations

from pathlib import Path

import click

from jrdb_avr.engine.commands._options import Store, store_option
from jrdb_avr.engine.console import note, warnings_as_notes


@click.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(exists=True, path_type=Path))
@store_option()
def command(files: tuple[Path, ...], store: Store) -> None:
    """Import questions that another program wrote, as JSON lines or Parquet.

    All FILEs together become the question set of the store. Give two folders, the public and the private one, to import
    what 'export --hf' wrote. The sequences of the questions must be loaded. A store with generated questions is
    refused. docs/export.md describes a line.

    Examples:
      jrdb-avr import-questions mine.jsonl --store S
      jrdb-avr import-questions folder/public folder/private --store S
    """
    from jrdb_avr.engine.integrations.import_questions import import_questions

    with warnings_as_notes():
        note(f"questions imported: {import_questions(store, files)}; next: jrdb-avr validate --store {store.path}")
