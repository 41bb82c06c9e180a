"""The whole system once, on a synthetic world: each step is a command that a user could type."""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from jrdb_avr.schema.errors import InputError

_PROGRAM: Final = "from jrdb_avr.engine.cli import main; main()"

_SEQUENCE: Final = "sample-plaza-01_0"
"""The first sequence of every sample."""


@dataclass(frozen=True, slots=True)
class Size:
    """How large a world is made, and how many of its questions are asked."""

    sequences: int = 3
    frames: int = 600
    people: int = 18
    asked: int = 200


def steps(folder: Path, size: Size) -> list[list[str]]:
    """The commands' arguments, in order."""
    root, store = str(folder / "sample"), str(folder / "store")
    world = ["--sequences", str(size.sequences), "--frames", str(size.frames), "--people", str(size.people)]
    look = ["observe", _SEQUENCE, "150", "180", "--store", store, "--out", str(folder / "look.png")]
    ask = ["--method", "react", "--model", "marker", "--limit", str(size.asked)]
    return [
        ["sample", root, *world],
        ["load", root, "--store", store],
        ["generate", "--store", store],
        ["validate", "--store", store],
        look,
        ["evaluate", "--store", store, *ask],
        ["score", "--store", store],
        ["report", "--store", store],
    ]


def run_demo(folder: Path, size: Size, say: Callable[[str], None]) -> None:
    """Run every step, each in a process of its own. Raises InputError where the folder is in use or a step fails."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists and is not empty: remove it, or name another with --out", file=str(folder))
    begin = time.monotonic()
    for arguments in steps(folder, size):
        say(f"\n$ jrdb-avr {shlex.join(arguments)}")
        done = subprocess.run([sys.executable, "-c", _PROGRAM, *arguments], check=False)
        if done.returncode:
            raise InputError(f"the step 'jrdb-avr {arguments[0]}' failed (exit code {done.returncode})")
    seconds = time.monotonic() - begin
    say(f"\nDone in {seconds:.0f} s. Scores on the sample world are synthetic: no result about JRDB.")
    say(f"Look at {folder / 'look.png'}, and ask: jrdb-avr stats --store {folder / 'store'}")
