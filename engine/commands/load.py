"""`jrdb-avr load`: label files into a store, with a report of what was found and what was refused."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jrdb_avr.engine.output import (
    clean,
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
from jrdb_avr.schema.rules import LoadRules, Rules, override

if TYPE_CHECKING:
    from jrdb_avr.loaders.problems import Problem
    from jrdb_avr.loaders.report import SequenceReport


@click.command(
    short_help="Read annotations into a store and build its graph.",
    epilog="Example: jrdb-avr load ~/jrdb/train_dataset_with_activity --store store --workers 2",
)
@click.argument("root", required=False, type=click.Path(path_type=Path))
@store_option
@click.option("--rebuild", is_flag=True, help="Derive intervals and graph again from the store's annotation tables.")
@click.option("--strict", is_flag=True, help="Exit with 1 if anything was refused or skipped.")
@rule_option("Override a load rule; may be given often.")
@workers_option
@json_option
def command(
    root: Path | None,
    store: Path,
    rebuild: bool,
    strict: bool,
    rule_texts: tuple[str, ...],
    workers: int,
    as_json: bool,
) -> None:
    """Load the JRDB root ROOT: stitched 2D boxes with actions and groups, 3D boxes, panoramas.

    Any of the layers may be missing. Broken files and records are refused one by one and listed; the rest loads.
    """
    if rebuild == (root is not None):
        raise click.UsageError("give either ROOT or --rebuild")
    from jrdb_avr.loaders import load as loading
    from jrdb_avr.loaders.layers import find_root
    from jrdb_avr.loaders.report import as_row, totals
    from jrdb_avr.queries.store import Store

    place = Store(store)
    if root is None:
        loading.resume(place)
        manifest = place.manifest()
        rules = _rules(rule_texts, manifest.load_rules)
        with progress("rebuilding", len(manifest.sequences)) as advance:
            entries = loading.rebuild(place, rules, workers, advance)
        if as_json:
            print_json([{"sequence": name, "layers": entry.layers} for name, entry in entries.items()])
        else:
            click.echo(f"{len(entries)} sequences rebuilt in {clean(store)}")
        return
    rules = _rules(rule_texts, LoadRules())
    found = find_root(root)
    with progress("loading", len(found.sequences)) as advance:
        reports = loading.load(found, place, rules, workers, advance)
    if as_json:
        print_json([as_row(report) for report in reports])
    else:
        _print(reports)
        click.echo(clean(totals(reports)))
    if strict and any(report.refused for report in reports):
        note("something was refused or skipped, and --strict was given")
        sys.exit(1)


def _rules(texts: tuple[str, ...], start: LoadRules) -> LoadRules:
    """Load rules with overrides, named with or without `load.` before them."""
    changes = {f"load.{name.removeprefix('load.')}": value for name, value in pairs("--rule", texts).items()}
    return override(Rules(load=start), changes).load


def _print(reports: list[SequenceReport]) -> None:
    """The report for people: a table of sequences, then what was refused, then unknown labels."""
    print_rows([_summary(report) for report in reports], title="Loaded")
    problems = [
        {"sequence": report.sequence, **_problem_row(problem)} for report in reports for problem in report.problems
    ]
    if problems:
        print_rows(problems, title="Refused or skipped, with the first example of each")
    unknown: Counter[tuple[str, str]] = Counter()
    for report in reports:
        for label in report.unknown_labels:
            unknown[label.field, label.label] += label.count
    if unknown:
        rows = [{"field": field, "label": label, "count": n} for (field, label), n in sorted(unknown.items())]
        print_rows(rows, title="Labels outside the vocabulary, kept but never asked about")


def _summary(report: SequenceReport) -> dict[str, Any]:
    heading = report.heading
    return {
        "sequence": report.sequence,
        "layers (step)": ", ".join(_layer(report, layer) for layer in report.layers) or "none",
        "frames": report.frames,
        "people": report.people,
        "boxes": report.boxes,
        "3D boxes": report.boxes_3d,
        "unknown labels": sum(label.count for label in report.unknown_labels),
        "refused": report.refused,
        "heading": ""
        if heading is None or heading.median_deg is None
        else f"{heading.median_deg:.0f}° of {heading.moves}",
    }


def _layer(report: SequenceReport, layer: str) -> str:
    return f"{layer} ({report.steps[layer]})" if layer in report.steps else layer


def _problem_row(problem: Problem) -> dict[str, Any]:
    """A problem as a row of the table."""
    return {
        "count": problem.count,
        "what": problem.kind,
        "reason": problem.reason,
        "file": problem.file,
        "frame": problem.frame,
        "field": problem.field,
        "value": problem.detail,
    }
