"""`jrdb-avr demo`: run every step once on synthetic data. Each step is a command that a user could type."""

from __future__ import annotations

import shlex
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

from jrdb_avr.schema.errors import InputError

_PROGRAM: Final = "from jrdb_avr.engine.cli import main; main()"

_SEQUENCE: Final = "sample-plaza-01_0"
"""Name of the first sequence that `sample` writes."""


@dataclass(frozen=True, slots=True)
class Size:
    """Size of the demo: the synthetic data and the questions.

    sequences: the number of sequences. frames: the number of frames per sequence. people: the number of people in
    view. questions: the number of questions that are evaluated.
    """

    sequences: int = 1
    frames: int = 450
    people: int = 18
    questions: int = 6


@click.command(epilog="Example: jrdb-avr demo --out demo-out")
@click.option(
    "--out",
    default="demo-out",
    show_default=True,
    type=click.Path(path_type=Path),
    help="New folder for the synthetic data, the store and the run.",
)
def command(out: Path) -> None:
    """Run every step on synthetic data: sample, load, generate, validate, observe, evaluate, score and report.

    The simulated model answers the questions. Each step is printed as the command that it runs. The demo takes about
    twenty seconds.
    """
    run_demo(out, Size(), click.echo)


def steps(folder: Path, size: Size) -> list[list[str]]:
    """Return the arguments of each command of the demo, in the order of the steps."""
    root, store, look = folder / "sample", ["--store", f"{folder / 'store'}"], folder / "look.png"
    world = f"--sequences {size.sequences} --frames {size.frames} --people {size.people}"
    return [
        ["sample", f"{root}", *world.split()],
        ["load", f"{root}", *store],
        ["generate", *store],
        ["validate", *store],
        ["observe", _SEQUENCE, "150", "110", *store, "--boxes", "--out", f"{look}"],
        ["evaluate", *store, "--method", "react", "--model", "simulated:perfect", "--limit", f"{size.questions}"],
        ["score", *store],
        ["report", *store],
    ]


def run_demo(folder: Path, size: Size, say: Callable[[str], None]) -> None:
    """Run each step in a process of its own. Raise InputError if the folder is not empty, or if a step fails."""
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
    say(f"next: jrdb-avr evaluate --store {folder / 'store'} --method react --model MODEL --base-url URL")
