"""The README's commands do what it says: the tour runs as written, and its output is the one shown."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import cv2
import entry
from places import ROOT

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


def typed(command, folder):
    """(exit code, what is shown) of a command in a shell; `jrdb-avr` is that of the Python that runs the tests."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        cwd=folder,
        env=os.environ | {"PATH": path},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=300,
    )
    return done.returncode, done.stdout


def here(command):
    """The same without a process: the shell's words are the arguments, and of a pipe the last part is a process."""
    words = shlex.split(command)
    at = words.index("|") if "|" in words else len(words)
    # Nothing else that a shell acts upon.
    assert words[0] == "jrdb-avr" and not re.search(r"[$`;<>&*?]", re.sub(r"'[^']*'|\"[^\"$`]*\"", "", command)), (
        command
    )
    code, out, err = entry.run(*words[1:at])
    if words[at + 1 :]:
        out = subprocess.run(words[at + 1 :], input=out, capture_output=True, text=True, check=True).stdout
    return code, out + err


def test_the_tour_runs_as_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran = []
    for command, shown in steps():
        # A process costs a second: one of each kind, the first with a pipe and the first without, is as users type it.
        real = len(ran) < 2
        code, told = typed(command, tmp_path) if real else here(command)
        assert code == 0 and "jrdb-avr: " not in told, f"{command}\n{told}"
        assert shown and kept(command, shown) == kept(command, told.splitlines()), command
        ran.append(command.split()[1])
    snippet = re.findall(r"```python\n(.*?)\n```", README, flags=re.S)[0]
    done = subprocess.run([sys.executable, "-c", snippet], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert all(int(number) > 0 for number in done.stdout.split())
    assert set(ran) >= {"sample", "load", "cypher", "sql", "observe", "generate", "validate", "evaluate", "report"}
    for name in ("look", "stats"):
        made, shown = (cv2.imread(str(path / f"{name}.png")).astype(int) for path in (tmp_path / "tour", ROOT / "docs"))
        # Pictures are what the commands draw; decoders of JPEG may differ by a grain.
        assert made.shape == shown.shape and abs(made - shown).mean() < 1, name


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
