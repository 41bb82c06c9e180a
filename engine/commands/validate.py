"""`jrdb-avr validate`: are the question files sound?"""

from __future__ import annotations

import sys
from pathlib import Path

import click

from jrdb_avr.engine.console import (
    json_option,
    note,
    pairs,
    print_json,
    print_rows,
    progress,
    rule_option,
    store_option,
    workers_option,
)


@click.command(
    short_help="Check the question files against the annotations.",
    epilog="Example: jrdb-avr validate --store store --replay",
)
@store_option
@click.option(
    "--replay", "replayed", is_flag=True, help="Also run every proof again, and every plan as Cypher on the graph."
)
@workers_option
@rule_option("As it was given to generate.")
@json_option
def command(store: Path, replayed: bool, workers: int, rule_texts: tuple[str, ...], as_json: bool) -> None:
    """Check the questions of STORE: files, ids, choices, answers, texts, evidence, proofs; derive each answer again.

    The second derivation reads the annotation tables and nothing that generation made. With --replay all proofs of
    all questions are run again from the stored plans (by --workers processes), and each plan, compiled to Cypher, has
    to find the stored people and answer in the graph; whatever comes out otherwise than stored is named with its
    question and proof. Exit code 1 on any fault.
    """
    from jrdb_avr.engine.validate.checks import check_replay, validate
    from jrdb_avr.queries.store import Store
    from jrdb_avr.schema.rules import Rules, override

    place = Store(store)
    rules = override(Rules(), pairs("--rule", rule_texts))
    count = place.questions("questions").num_rows
    with progress("checking questions", count) as advance:
        report = validate(place, rules, advance)
    # Files that cannot be read are the only fault then.
    if replayed and report.checked["ids"]:
        with progress("running proofs again", 2 * count) as advance:
            check_replay(report, place, rules, workers, advance)
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
