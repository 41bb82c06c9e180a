"""`jrdb-avr validate`: are the question files sound?"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from jrdb_avr.engine.output import json_option, note, pairs, print_json, print_rows, progress, rule_option, store_option


@click.command(
    short_help="Check the question files against the annotations.",
    epilog="Example: jrdb-avr validate --store store",
)
@store_option
@rule_option("As it was given to generate.")
@json_option
def command(store: Path, rule_texts: tuple[str, ...], as_json: bool) -> None:
    """Check the questions of STORE: files, ids, choices, answers, texts, evidence, proofs; derive each answer again.

    The second derivation reads the annotation tables and nothing that generation made. Exit code 1 on any fault.
    """
    from jrdb_avr.engine.validate import validate
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import Rules, override

    place = Store(store)
    rules = override(Rules(), pairs("--rule", rule_texts))
    with progress("checking questions", place.questions("questions").num_rows) as advance:
        report = validate(place, rules, advance)
    if as_json:
        print_json(report.rows())
    else:
        # Faults follow below, one to a line.
        print_rows([{name: row[name] for name in row if name != "first fault"} for row in report.rows()])
    for name, faults in report.faults.items():
        for fault in faults[:20]:
            note(f"{name}: {fault}")
        if len(faults) > 20:
            note(f"{name}: {len(faults) - 20} more")
    if not report.sound:
        sys.exit(1)
