"""`jrdb-avr load`: load label files into a store, and report what was loaded and what was refused."""

from __future__ import annotations

import resource
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from jrdb_avr.engine.commands._options import FILE, executor_option, form_option, given, pairs_option, store_option
from jrdb_avr.engine.console import RowFormat, note, print_data, print_rows, progress_bar
from jrdb_avr.engine.text_table import clean
from jrdb_avr.schema.errors import StoreError
from jrdb_avr.schema.rules import LoadRules, Rules, override

if TYPE_CHECKING:
    from jrdb_avr.queries.store import Store
    from jrdb_avr.queries.workers import Executor

MAX_ROWS: Final = 50
"""Maximum number of printed rows of a table. Tables with a fixed number of rows are printed in full."""


@click.command()
@click.argument("root", required=False, type=click.Path(path_type=Path))
@store_option(required=False)
@click.option("--fingerprint", type=FILE, help="Only describe the files of ROOT, without annotations, in a JSON file.")
@click.option("--rebuild", is_flag=True, help="Derive intervals and graph again from the annotations in the store.")
@click.option("--verify", is_flag=True, help="Check that the files of the store are unchanged since 'load' wrote them.")
@pairs_option(
    "--layer-dir",
    "layer_dirs",
    "Folder of a layer's files, absolute or relative to ROOT. An empty FOLDER leaves the layer out. May be repeated. "
    "Layers: 2d, 3d, social, reasoning, pose, panoptic, timestamps, calibration.",
    metavar="LAYER=FOLDER",
)
@click.option("--strict", is_flag=True, help="Exit with code 1 if anything was refused or skipped.")
@pairs_option("--rule", "overrides", "Change a rule of loading (see 'rules list'). May be repeated.")
@executor_option
@form_option
def command(
    root: Path | None, store: Store | None, strict: bool, workers: Executor, form: RowFormat, **options: Any
) -> None:
    """Load a copy of JRDB from the folder ROOT into a store. Leave ROOT out with --rebuild or --verify.

    JRDB has these layers: stitched 2D boxes (with actions and groups), 3D boxes, social labels, reasoning labels,
    poses, panoptic segments, timestamps, calibration and panoramas. Any layer may be missing. Broken files and broken
    records are refused and listed, and the rest is loaded. A layer is refused if its frame numbers differ from the
    frame numbers of the 2D boxes.

    --verify checks three parts of the store by the hashes that 'load' stored: the annotations, the intervals and the
    graph. It prints the first fault of each part. If a run has written into the graph after 'load', the graph is
    checked by the row counts of its tables instead. The exit code is 1 if there is a fault.

    --fingerprint writes a description of the files, and loads nothing. It has folders, file sizes, keys, types, lengths
    of lists, label names with counts, and numbers of frames, but no coordinate, track or picture. You may publish it
    to ask why a copy cannot be loaded.

    Examples:
      jrdb-avr load ~/jrdb/train_dataset_with_activity --store store
      jrdb-avr load ~/jrdb/train_dataset_with_activity --fingerprint jrdb.json
    """
    from jrdb_avr.loaders import load as loading
    from jrdb_avr.loaders.fingerprint import renamed_folders
    from jrdb_avr.loaders.releases import compare_releases
    from jrdb_avr.loaders.report import totals
    from jrdb_avr.queries.graph.database import UNLIMIT

    if (root is not None) + options["rebuild"] + options["verify"] != 1 or (options["fingerprint"] and root is None):
        raise click.UsageError("give one of ROOT, --rebuild and --verify; --fingerprint needs ROOT")
    if root is not None and options["fingerprint"] is not None:
        _describe(root, options["fingerprint"])
        return
    store = given(store)
    if options["verify"]:
        _verify(store, form)
        return
    # No limit is -1 or a huge number. Workers that exceed a limit would die with pages of text.
    if 0 <= resource.getrlimit(resource.RLIMIT_AS)[0] < 1 << 44:
        raise StoreError(f"cannot build a graph: {UNLIMIT}")
    if root is None:
        loading.resume(store)
        rules = _rules(options["overrides"], store.manifest().load_rules)
        with progress_bar() as progress:
            entries = loading.rebuild(store, rules, workers, progress)
        if form:
            print_data([{"sequence": name, "layers": entry.layers} for name, entry in entries.items()], form)
        else:
            click.echo(f"{len(entries)} sequences rebuilt in {clean(store.path)}")
        return
    folders: dict[str, list[str]] = {}
    for layer, folder in options["layer_dirs"]:
        folders.setdefault(layer, []).extend([folder] if folder else [])
    for line in renamed_folders(root, {root / name for names in folders.values() for name in names}):
        note(line)
    with progress_bar() as progress:
        result = loading.load(
            root, store, _rules(options["overrides"], LoadRules()), workers, layer_dirs=folders, progress=progress
        )
    if form:
        print_data(result.rows(), form)
    else:
        for part in result.parts():
            if isinstance(part, str):
                click.echo(clean(part))
                continue
            title, rows = part
            printed = rows if title in ("Loaded", "Checks") else rows[:MAX_ROWS]
            print_rows(printed, title=title)
            if len(printed) < len(rows):
                click.echo(f"... {len(rows) - MAX_ROWS:,} more: --csv or --json prints all")
        if compared := compare_releases(result.reports):
            print_rows(compared, title="Beside the releases of JRDB")
        click.echo(clean(totals(result.reports)))
    if strict and result.refused:
        note("something was refused or skipped, and --strict is set")
        sys.exit(1)


def _describe(root: Path, file: Path) -> None:
    import msgspec

    from jrdb_avr.loaders.fingerprint import fingerprint
    from jrdb_avr.queries.files import write_bytes

    write_bytes(file, msgspec.json.format(msgspec.json.encode(fingerprint(root), order="sorted"), indent=1) + b"\n")
    note(f"wrote {file}: keys, types, counts and frame numbers of {root}, without annotations")


def _verify(store: Store, form: RowFormat) -> None:
    from jrdb_avr.loaders.verify import VERIFY_STEPS, checks_of
    from jrdb_avr.queries.display import step_counter

    with progress_bar() as progress:
        checks = checks_of(store, step_counter(progress, "verifying", VERIFY_STEPS))
    print_rows([{"what": c.what, "checked": c.checked, "fault": c.fault} for c in checks], form=form)
    faults = [check for check in checks if check.fault]
    if faults:
        remedy = "ROOT" if any(check.reload for check in faults) else "--rebuild"
        path = clean(store.path)
        note(f"{path} changed after the load: run 'jrdb-avr load {remedy} --store {path}'")
        sys.exit(1)


def _rules(overrides: list[tuple[str, str]], start: LoadRules) -> LoadRules:
    """Return a copy of `start` with the values of `overrides`. Names in `overrides` may lack the prefix `load.`."""
    changes = {f"load.{name.removeprefix('load.')}": value for name, value in overrides}
    return override(Rules(load=start), changes).load
