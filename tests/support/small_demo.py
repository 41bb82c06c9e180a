"""The demo in small, run once for all who look at what it leaves: a world with pictures, questions and a run."""

from types import SimpleNamespace

import pytest
import warm

from jrdb_avr.engine.commands import demo

SIZE = demo.Size(sequences=1, frames=300, people=14, questions=6)


def forked(command, check):
    """A step in a process of its own that has everything imported."""
    return warm.run(warm.command_line, *command[3:])


def make_demo(folder):
    lines = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "subprocess", SimpleNamespace(run=forked))
        demo.run_demo(folder / "demo", SIZE, lines.append)
    (folder / "printed").write_text("\n".join(lines), "utf-8")


@pytest.fixture(scope="session")
def small_demo(once):
    """The demo's folder, not to be written to, and the lines that it printed."""
    folder = once("demo", make_demo)
    return folder / "demo", (folder / "printed").read_text("utf-8").splitlines()
