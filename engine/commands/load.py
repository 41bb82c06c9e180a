"""`jrdb-avr load`: label files into a store, with a report of what was found and what was refused."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from jrdb_avr.engine.console import (
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
    from jrdb_avr.loaders.report import Cameras, FrameRange, SequenceReport, ShiftCheck

WIDTH: Final = 120
"""Columns of the report where it goes to a file."""
MAX_ROWS: Final = 50
"""Rows of a printed table of what a file may hold without end."""


@click.command(
    short_help="Read annotations into a store and build its graph.",
    epilog="Example: jrdb-avr load ~/jrdb/train_dataset_with_activity --store store --workers 2",
)
@click.argument("root", required=False, type=click.Path(path_type=Path))
@store_option
@click.option("--rebuild", is_flag=True, help="Derive intervals and graph again from the store's annotation tables.")
@click.option("--verify", is_flag=True, help="Compare every file with what was loaded, and the graph with the tables.")
@click.option(
    "--layer-dir",
    "layer_texts",
    multiple=True,
    metavar="LAYER=FOLDER",
    help="Look for a layer's files in FOLDER, in ROOT or absolute; may be given often. LAYER= leaves the layer out. "
    "Layers: 2d, 3d, social, reasoning, pose, panoptic, timestamps, calibration.",
)
@click.option("--strict", is_flag=True, help="Exit with 1 if anything was refused or skipped.")
@rule_option("Override a load rule; may be given often.")
@workers_option
@json_option
def command(
    root: Path | None,
    store: Path,
    rebuild: bool,
    verify: bool,
    layer_texts: tuple[str, ...],
    strict: bool,
    rule_texts: tuple[str, ...],
    workers: int,
    as_json: bool,
) -> None:
    """Load the JRDB root ROOT: stitched 2D boxes with actions and groups, 3D boxes, social and reasoning labels, poses,
    panoptic things, timestamps, calibration, panoramas.

    Any of the layers may be missing. A layer whose frame numbers are not those of the 2D boxes is refused. Broken
    files and records are refused one by one and listed; the rest loads.
    """
    if (root is not None) + rebuild + verify != 1:
        raise click.UsageError("give one of ROOT, --rebuild and --verify")
    if verify:
        _verify(store, as_json)
        return
    from jrdb_avr.loaders import load as loading
    from jrdb_avr.loaders.report import as_row, totals
    from jrdb_avr.loaders.root import find_root
    from jrdb_avr.queries.store import Store

    place = Store(store)
    if root is None:
        loading.resume(place)
        manifest = place.manifest()
        rules = _rules(rule_texts, manifest.load_rules)
        with progress("rebuilding", len(manifest.sequences)) as advance:
            entries = loading.rebuild(place, rules, workers, advance, note)
        if as_json:
            print_json([{"sequence": name, "layers": entry.layers} for name, entry in entries.items()])
        else:
            click.echo(f"{len(entries)} sequences rebuilt in {clean(store)}")
        return
    rules = _rules(rule_texts, LoadRules())
    found = find_root(root, _layer_dirs(layer_texts))
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


def _verify(store: Path, as_json: bool) -> None:
    from jrdb_avr.loaders.verify import STEPS, checks_of
    from jrdb_avr.queries.store import Store

    with progress("verifying", STEPS) as advance:
        checks = checks_of(Store(store), advance)
    rows = [{"what": check.what, "checked": check.checked, "fault": check.fault} for check in checks]
    print_json(rows) if as_json else print_rows(rows)
    faults = [check for check in checks if check.fault]
    if faults:
        way = "ROOT" if any(check.reload for check in faults) else "--rebuild"
        note(f"{clean(store)} is not what was loaded: run 'jrdb-avr load {way} --store {clean(store)}'")
        sys.exit(1)


def _layer_dirs(texts: tuple[str, ...]) -> dict[str, list[str]]:
    """Folders per layer named, in the order given; none for a layer to be left out."""
    folders: dict[str, list[str]] = {}
    for text in texts:
        layer, equals, folder = text.partition("=")
        if not equals:
            raise click.UsageError(f"--layer-dir {text}: write LAYER=FOLDER")
        folders.setdefault(layer, []).extend([folder] if folder else [])
    return folders


def _rules(texts: tuple[str, ...], start: LoadRules) -> LoadRules:
    """Load rules with overrides, named with or without `load.` before them."""
    changes = {f"load.{name.removeprefix('load.')}": value for name, value in pairs("--rule", texts).items()}
    return override(Rules(load=start), changes).load


def _print(reports: list[SequenceReport]) -> None:
    """The report for people: a table of sequences, then checks, what was refused, unknown labels and warnings."""
    loaded = [report for report in reports if report.sequence]
    print_rows([_summary(report) for report in loaded], title="Loaded", width=WIDTH)
    for layers, names in _shared((_layers(report), report.sequence) for report in loaded):
        click.echo(clean(f"Layers of {_sequences(names)}: {layers}"))
    checks = [_checks(report) for report in loaded if report.layers]
    told = [name for name in (checks[0] if checks else ()) if any(row[name] for row in checks)]
    print_rows([{name: row[name] for name in told} for row in checks], title="Checks", width=WIDTH)
    for cameras in dict.fromkeys(_cameras(report.cameras) for report in loaded if report.cameras):
        click.echo(cameras)
    _print_some(_problem_rows(reports), "Refused or skipped, with the first example of each")
    unknown: Counter[tuple[str, str]] = Counter()
    for report in reports:
        for label in report.unknown_labels:
            unknown[label.field, label.label] += label.count
    rows = [{"field": field, "label": label, "count": n} for (field, label), n in sorted(unknown.items())]
    _print_some(rows, "Labels outside the vocabulary, kept but never asked about")
    for warning, names in _shared((warning, report.sequence) for report in reports for warning in report.warnings):
        where = _sequences(names)
        click.echo(clean(f"Note: {where}: {warning}" if where else f"Note: {warning}"))


def _print_some(rows: list[dict[str, Any]], title: str) -> None:
    """A table of what may be endless; nothing where there is no row."""
    if rows:
        print_rows(rows[:MAX_ROWS], title=title, width=WIDTH)
    if len(rows) > MAX_ROWS:
        click.echo(f"... and {len(rows) - MAX_ROWS:,} more: --json lists all")


def _shared(told: Iterable[tuple[str, str]]) -> list[tuple[str, list[str]]]:
    """Each text once, with the sequences that it was told of."""
    found: dict[str, list[str]] = {}
    for text, sequence in told:
        found.setdefault(text, []).append(sequence)
    return list(found.items())


def _sequences(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} sequences"


def _summary(report: SequenceReport) -> dict[str, Any]:
    return {
        "sequence": report.sequence,
        "frames": report.frames,
        "people": report.people,
        "boxes": report.boxes,
        "3D": report.boxes_3d,
        "refused": report.refused,
    }


def _layers(report: SequenceReport) -> str:
    """The layers by the step at which they are annotated."""
    steps: dict[str, list[str]] = {}
    for layer in report.layers:
        step = report.steps.get(layer)
        how = "" if step is None else " at every frame" if step == 1 else f" at every {step}th frame"
        steps.setdefault(how, []).append(layer)
    return "; ".join(f"{', '.join(layers)}{how}" for how, layers in steps.items()) or "none"


def _checks(report: SequenceReport) -> dict[str, Any]:
    heading, stamps = report.heading, report.stamps
    return {
        "sequence": report.sequence,
        "label frames": _range(report.label_frames),
        "image frames": _range(report.image_frames),
        "same frames as 2D": ", ".join(f"{check.layer}: {_shift(check)}" for check in report.shifts),
        "heading": ""
        if heading is None or heading.median_deg is None
        else f"{heading.median_deg:.0f}° of {heading.moves}",
        "fps": "" if stamps is None or stamps.fps is None else f"{stamps.fps:.2f}",
        "contradictions": len(report.disagreements),
        "absent partners": report.absent_partners,
    }


def _cameras(cameras: Cameras) -> str:
    return (
        f"Cameras: median fy {cameras.fy:.1f} (rows of the panorama are computed with {cameras.focal_rows}), "
        f"median cy {cameras.cy:.1f} ({cameras.horizon_row})"
    )


def _range(frames: FrameRange | None) -> str:
    return "" if frames is None else f"{frames.first}-{frames.last}"


def _shift(check: ShiftCheck) -> str:
    return {"agrees": "yes", "shifted": "NO", "not tested": "cannot tell"}[check.result]


def _problem_rows(reports: list[SequenceReport]) -> list[dict[str, Any]]:
    """What was refused in one way, in all sequences together: how often, and where first."""
    found: dict[tuple[str, ...], list[tuple[str, Problem]]] = {}
    for report in reports:
        for problem in report.problems:
            key = (problem.layer, problem.kind, problem.reason, problem.field)
            found.setdefault(key, []).append((report.sequence, problem))
    return [
        {
            "count": sum(problem.count for _, problem in told),
            "sequences": len({sequence for sequence, _ in told}),
            "what": f"{layer} {kind}".strip(),
            "reason": reason,
            "first": _place(*told[0]),
        }
        for (layer, kind, reason, _), told in found.items()
    ]


def _place(sequence: str, problem: Problem) -> str:
    """File, frame, field and value of a problem; the sequence where its file does not name it."""
    file = problem.file if sequence in problem.file else f"{sequence}/{problem.file}"
    return " ".join(part for part in (file, problem.frame, problem.field, problem.detail) if part)
