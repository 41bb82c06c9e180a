"""The demo, run once for all who look at what it leaves: a world with pictures, questions and a run."""

import contextlib
import json
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from processes import run

from jrdb_avr.engine.commands import demo

SIZE = demo.Size()


def make_demo(folder):
    """Run the demo as users do, in the folder's `demo-out`; what it and its steps print is kept beside it."""
    lines, outputs = [], []

    def run_step(command, check):
        code, *texts = run(*command[3:])
        outputs.append((command[3:], texts))
        return subprocess.CompletedProcess(command, code)

    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "subprocess", SimpleNamespace(run=run_step))
        demo.run_demo(Path("demo-out"), SIZE, lines.append)
    (folder / "printed.json").write_text(json.dumps([lines, outputs]), "utf-8")


@pytest.fixture(scope="session")
def small_demo(once):
    """`folder`: what the demo has made, not to be written to; `printed`: its own lines, without those of its steps;
    `outputs`: {arguments of a step: (stdout, stderr)}."""
    folder = once("demo", make_demo)
    lines, outputs = json.loads((folder / "printed.json").read_text("utf-8"))
    steps = {tuple(arguments): tuple(texts) for arguments, texts in outputs}
    return SimpleNamespace(folder=folder / "demo-out", printed="\n".join(lines) + "\n", outputs=steps)
