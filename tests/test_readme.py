"""The README's commands do what it says: the tour runs as written, and its output is the one shown."""

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def steps():
    """(command, lines shown) of every console block."""
    found = []
    for block in re.findall(r"```console\n(.*?)\n```", README, flags=re.S):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            else:
                found[-1][1].append(line)
    return found


def kept(command, lines):
    """The lines that must be the same, without spaces and rules.

    What a run prints depends on clocks and on the JPEG decoder's version, so of runs only the lines without a number
    count; all else is the same everywhere.
    """
    plain = [re.sub(r"[\s─-╿]+", " ", line).strip() for line in lines]
    of_a_run = re.search(r" (evaluate|score|report|trace|scores_by_family|world_runs) ", command)
    return [line for line in plain if line and not (of_a_run and re.search(r"\d", line))]


@pytest.fixture(scope="module")
def environment():
    """One in which `jrdb-avr` is the command of the Python that runs the tests."""
    return os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def test_the_tour_runs_as_written(tmp_path, environment):
    ran = []
    for command, shown in steps():
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=tmp_path,
            env=environment,
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=300,
        )
        assert done.returncode == 0 and "jrdb-avr: " not in done.stdout, f"{command}\n{done.stdout}"
        assert shown and kept(command, shown) == kept(command, done.stdout.splitlines()), command
        ran.append(command.split()[1])
    snippet = re.findall(r"```python\n(.*?)\n```", README, flags=re.S)[0]
    done = subprocess.run(
        [sys.executable, "-c", snippet], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert all(int(number) > 0 for number in done.stdout.split())
    assert set(ran) >= {"sample", "load", "cypher", "sql", "observe", "generate", "validate", "evaluate", "report"}
    drawn, shown = (cv2.imread(str(path)).astype(int) for path in (tmp_path / "tour/look.png", ROOT / "docs/look.png"))
    # The picture at the top is what the command draws; decoders of JPEG may differ by a grain.
    assert drawn.shape == shown.shape and abs(drawn - shown).mean() < 1


def test_two_commands_set_it_up():
    shell = re.findall(r"```sh\n(.*?)\n```", README.split("## Five-minute tour")[0], flags=re.S)
    assert shell == [
        "python3 -m venv .venv && . .venv/bin/activate && pip install . && jrdb-avr demo",
        "pip install '.[test]' && pytest",
    ]
    # What the README says is what is run for every change.
    assert shell[1] in (ROOT / ".ci" / "run").read_text().splitlines()


def test_every_command_shown_exists():
    from jrdb_avr.engine.cli import COMMANDS

    assert set(re.findall(r"jrdb-avr ([a-z]+)", README)) <= set(COMMANDS)


def test_every_file_named_exists():
    named = set(re.findall(r"`((?:schema|loaders|queries|engine|agent|docs)/[\w/.]*)`", README))
    named |= set(re.findall(r"\]\(([\w/.]+)\)", README))
    assert named and all((ROOT / name).exists() for name in named), named


def test_it_names_no_machine():
    assert not re.search(r"/(?:work|tmp|home|root)/|\b\d{1,3}(?:\.\d{1,3}){3}\b", README)
