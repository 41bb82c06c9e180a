"""The demo, run once for all who look at what it leaves: a world with pictures, questions and a run."""

import contextlib
import json
from pathlib import Path
from types import SimpleNamespace

import pytest
import warm

from jrdb_avr.engine.commands import demo

SIZE = demo.Size()


def make_demo(folder):
    """Run the demo as users do, in the folder's `demo-out`; what it and its steps print is kept beside it."""
    lines, outputs = [], []

    def forked(command, check):
        """A step in a process of its own that has everything imported."""
        done = warm.run(warm.command_line, *command[3:])
        outputs.append((command[3:], (done.stdout.decode(), done.stderr.decode())))
        return done

    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "subprocess", SimpleNamespace(run=forked))
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
