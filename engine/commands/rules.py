"""`jrdb-avr rules`: list the rules of the benchmark. The option `--rule` of other commands changes a rule."""

from __future__ import annotations

import click

from jrdb_avr.engine.cli import NamingGroup
from jrdb_avr.engine.commands._options import form_option
from jrdb_avr.engine.console import RowFormat, print_rows


@click.group(cls=NamingGroup, epilog="Example: jrdb-avr rules list")
def command() -> None:
    """Show the rules of the benchmark: thresholds for facts, for proofs and for the selection of questions."""


@command.command(name="list", epilog="Example: jrdb-avr rules list --csv")
@form_option
def rules_list(form: RowFormat) -> None:
    """List the rules with their values and meanings.

    To change a rule with a name that begins with "load.", use 'load --rule NAME=VALUE'. To change any other rule, use
    'generate --rule NAME=VALUE'.
    """
    from jrdb_avr.schema.rules import rule_rows

    print_rows(rule_rows(), form=form)
