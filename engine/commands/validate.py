"""`jrdb-avr validate`: check the question files."""

from __future__ import annotations

import sys

import click

from jrdb_avr.engine.commands._options import Store, form_option, pairs_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_rows, progress_bar


@click.command(epilog="Example: jrdb-avr validate --store store --replay")
@store_option()
@click.option("--replay", is_flag=True, help="Also repeat all proofs, and run each plan as a Cypher query.")
@pairs_option("--rule", "overrides", "Use this value of a rule, not its default. Repeat each --rule of 'generate'.")
@form_option
def command(store: Store, replay: bool, overrides: list[tuple[str, str]], form: RowFormat) -> None:
    """Check the questions of a store, and derive all answers and proofs again with a second program.

    The command checks files, ids, choices, answers, texts, evidence and time twins. The second program reads only the
    annotation tables, and shares no code with 'generate'. With --replay, Cypher statements on the graph repeat all
    proofs of the stored plans too. Then each plan runs as one Cypher query, which must find the stored people and the
    stored answer. Each difference is printed with its question and proof. The exit code is 1 if there is a fault.
    """
    from jrdb_avr.engine.report.truth import is_imported
    from jrdb_avr.engine.validate.checks import validate
    from jrdb_avr.schema.rules import Rules, override

    with progress_bar() as progress:
        rules = override(Rules(), dict(overrides))
        result = validate(store, rules, replay_proofs=replay, progress=progress)
    # A table lacks the first faults, because all faults follow, one per line.
    left_out = () if form else ("first fault",)
    print_rows([{name: row[name] for name in row if name not in left_out} for row in result.rows()], form=form)
    for name, faults in result.faults.items():
        for fault in faults[:20]:
            note(f"{name}: {fault}")
        if len(faults) > 20:
            note(f"{name}: {len(faults) - 20} more")
    if is_imported(store):
        note("imported questions have no plans: no answer was derived again, and no text or proof was checked")
    if not result.sound:
        sys.exit(1)
