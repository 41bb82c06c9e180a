"""Suggestions of the next commands to type, for each store in a folder."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from jrdb_avr.engine.commands._options import STORE_VARIABLE
from jrdb_avr.queries.manifest import is_public


def next_steps(folder: Path) -> list[str]:
    """Describe the state of each store in a folder, and suggest the next commands for the store.

    Args:
        folder: The folder to search for stores. If the environment variable JRDB_AVR_STORE names a store, only that
            store is described.

    Returns:
        Lines for the terminal.
    """
    named = os.environ.get(STORE_VARIABLE)
    paths = [Path(named)] if named else [folder, *sorted(path.parent for path in folder.glob("*/store.json"))]
    stores = [path for path in paths if (path / "store.json").exists()]
    if not stores:
        where = f"{named}, which {STORE_VARIABLE} names, is no store yet." if named else "There is no store here yet."
        load = f"jrdb-avr load ROOT --store {shlex.quote(named or 'store')}"
        steps = (("jrdb-avr demo", "every step on synthetic data, in twenty seconds"), (load, "your copy of JRDB"))
        return [where, *(f"  {command:<{len(load)}}  {what}" for command, what in steps)]
    return [line for path in stores for line in _of_store(path, folder, named)]


def scoring_steps(store: Path, *runs: str) -> str:
    """Return the command that scores runs, or the commands that export runs of a public store for scoring."""
    if is_public(store):
        return " && ".join(f"jrdb-avr export {run} --jsonl {run}.jsonl --store {store}" for run in runs)
    return f"jrdb-avr score --store {store} {' '.join(runs)}"


def _of_store(store: Path, folder: Path, named: str | None) -> list[str]:
    """Return a line with the state of a store, followed by one line for each command that the user can run next."""
    runs = [path.parent for path in sorted(store.glob("runs/*/run.json"))]
    open_runs = [run.name for run in runs if not (run / "predictions.parquet").exists()]
    option = "" if named else f" --store {shlex.quote(str(store.relative_to(folder)))}"
    model = "--method agent --model MODEL --base-url URL"
    if not (store / "questions" / "questions.parquet").exists():
        state, steps = "has annotations and no questions yet", [f"generate{option}", f"cypher --list{option}"]
    elif not runs:
        state = "has questions and no runs yet"
        steps = [f"validate{option}", f"inspect --sample 20{option}", f"evaluate{option} {model}"]
    elif open_runs:
        state = f"has {len(runs)} runs, of which {len(open_runs)} are unfinished"
        steps = [f"runs show {open_runs[0]}{option}", f"evaluate{option} --resume ... (with its first options)"]
    else:
        state = f"has {len(runs)} run{'s' if len(runs) > 1 else ''}"
        steps = [f"score{option}", f"report{option}", f"evaluate{option} {model}"]
    title = named or store.relative_to(folder.parent)
    return [f"{title} {state}.", *(f"  jrdb-avr {step}" for step in steps)]
