"""The documentation does what it shows: the tour runs as written, README's commands are among it, names exist."""

import contextlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import processes
import pytest
from environment import DOCS, ROOT
from fake_server import BACKBONES

from jrdb_avr.agent.simulated.profiles import PERFECT
from jrdb_avr.agent.simulated.server import simulated_server
from jrdb_avr.agent.simulated.sight import Sight
from jrdb_avr.engine.local_server import LocalServer, Request
from jrdb_avr.engine.run.methods import METHODS
from jrdb_avr.queries.store import Store

README = (ROOT / "README.md").read_text(encoding="utf-8")
TOUR = (DOCS / "tour.md").read_text(encoding="utf-8")
REPRODUCE = (DOCS / "reproduce.md").read_text(encoding="utf-8")
GRAPH = (DOCS / "graph.md").read_text(encoding="utf-8")
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.glob("*.md")])


def blocks(text, kind):
    """The code blocks of a kind."""
    return re.findall(rf"```{kind}\n(.*?)\n```", text, flags=re.S)


def steps(text):
    """(command, output lines) of every console block."""
    found = []
    for block in blocks(text, "console"):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            else:
                found[-1][1].append(line)
    return found


CHANGING = r"http://127\.0\.0\.1:\d+/\S*|Done in \d+ s|seconds_per_question .*"
"""What a command prints differently each time."""


def kept(lines):
    """Return the lines that must be equal, without spaces, table rules and what changes each time."""
    plain = [re.sub(r"[\s─-╿]+", " ", re.sub(CHANGING, "", line)).strip() for line in lines]
    return [line for line in plain if line]


def compare(page, before, shown, output):
    """Compare lines of a page with what a command printed. With $REWRITE_DOCS, write these into the page instead."""
    if kept(shown) != kept(output):
        assert "REWRITE_DOCS" in os.environ, f"{page.name} is stale: run tests/figures.sh\n{before}\n" + "\n".join(
            output
        )
        text = page.read_text("utf-8")
        page.write_text(text.replace("\n".join([before, *shown]), "\n".join([before, *output]), 1), "utf-8")


def typed(command):
    """Run a command in a shell; returns (exit code, output). `jrdb-avr` is that of the Python that runs the tests."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command],
        env=os.environ | {"PATH": path},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=300,
    )
    return done.returncode, done.stdout


def here(command, printed):
    """The same within this process; only the part after a pipe is a process. `printed`: what commands have printed."""
    words = shlex.split(command)
    at = words.index("|") if "|" in words else len(words)
    # Nothing else that a shell acts upon.
    assert words[0] == "jrdb-avr" and not re.search(r"[$`;<>&*?]", re.sub(r"'[^']*'|\"[^\"$`]*\"", "", command)), (
        command
    )
    code, out, err = (0, *printed[tuple(words[1:at])]) if tuple(words[1:at]) in printed else processes.run(*words[1:at])
    if words[at + 1 :]:
        out = subprocess.run(words[at + 1 :], input=out, capture_output=True, text=True, check=True).stdout
    return code, out + err


@contextlib.contextmanager
def served(command):
    """The simulated model that a shell command starts in the background, on a free port: the named port, and this."""
    words = shlex.split(command.removesuffix(" &"))
    at = words.index("--port") + 1
    named, words[at] = words[at], "0"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, *words[1:]], **pipes) as process:
        try:
            yield named, re.search(r":(\d+)/v1", process.stdout.readline())[1]
        finally:
            process.kill()


def test_the_tour_runs_as_written(tmp_path, monkeypatch, small_demo):
    monkeypatch.chdir(tmp_path)
    # The demo has run for all tests; nothing of it is written to.
    shutil.copytree(small_demo.folder, "demo-out")
    printed = {("demo",): (small_demo.printed, ""), **small_demo.outputs}
    # Instead of waiting for Ctrl-C.
    opened = Request("GET", "", {}, b"")
    monkeypatch.setattr(LocalServer, "serve_forever", lambda self: self.respond(opened))
    (started,), (runs,) = (blocks(TOUR, kind) for kind in ("sh", "toml"))
    with served(started) as (named, port):
        Path("runs.toml").write_text(runs.replace(f":{named}/", f":{port}/"))
        for command, shown in steps(TOUR):
            # A process costs a second: one command is run as users type it.
            code, output = typed(command) if " who_is_where " in command else here(command, printed)
            assert code == 0 and "jrdb-avr: " not in output, f"{command}\n{output}"
            assert shown, command
            compare(DOCS / "tour.md", f"$ {command}", shown, output.rstrip().splitlines())
    ran = {command.partition(" | ")[0] for command, _ in steps(TOUR)}
    assert {shlex.join(["jrdb-avr", *own]) for own in printed} <= ran
    for snippet in blocks(TOUR, "python") + blocks(README, "python"):
        with contextlib.redirect_stdout(io.StringIO()) as out:
            exec(snippet, {})
        assert all(int(number) > 0 for number in out.getvalue().split())
    for query, rows in zip(blocks(GRAPH, "cypher"), blocks(GRAPH, "text"), strict=True):
        sequence = ("--param", "sequence=sample-plaza-01_0") if "$" in query else ()
        code, out, _ = processes.run("cypher", query, "--store", "demo-out/store", *sequence)
        assert code == 0, query
        compare(DOCS / "graph.md", f"{query}\n```\n\n```text", rows.splitlines(), out.rstrip().splitlines())
    # The pictures are what the commands draw; JPEG decoders may differ slightly.
    made, shown = (cv2.imread(str(path / "look.png")).astype(int) for path in (tmp_path / "demo-out", DOCS))
    assert made.shape == shown.shape and abs(made - shown).mean() < 1


def test_the_commands_from_jrdb_to_the_papers_tables_run(tmp_path, monkeypatch):
    """On a sample, one question per run, and with one simulated server in place of each server of vLLM."""
    monkeypatch.chdir(tmp_path)
    commands = [command for command, _ in steps(REPRODUCE)]
    assert tuple(shlex.split(command)[2] for command in commands if command.startswith("vllm serve")) == BACKBONES
    assert here("jrdb-avr sample world --sequences 2 --frames 300 --people 12 --no-images", {})[0] == 0
    output, store, url, runs = "", Store("jrdb"), "", {}
    with contextlib.ExitStack() as stack:
        for command in commands:
            if command.startswith("vllm"):
                url = url or stack.enter_context(simulated_server(Sight(store), PERFECT))
                continue
            command = command.replace("~/jrdb/test_dataset", "world").replace("http://localhost:8000/v1", url)
            if "--matrix" in command:
                command += " --simulated --limit 1"
            if " report " in command:
                runs = {
                    path.parent.name: json.loads(path.read_bytes()) for path in Path("jrdb/runs").glob("*/run.json")
                }
                last = sorted(name for name, run in runs.items() if run["model"] == BACKBONES[-1])
                command = f"{command} --as 'Qwen3.5 9B' {shlex.join(last)}"
            code, output = here(command, {})
            assert code == 0, f"{command}\n{output}"
    pairs = [
        (method, model) for model in BACKBONES for method in METHODS[: len(METHODS) if model == BACKBONES[-1] else 4]
    ]
    assert len(pairs) == 28 and sorted((run["method"], run["model"]) for run in runs.values()) == sorted(pairs)
    for number in (3, 4, 5, 6):
        (title,) = re.findall(rf"^.*Table {number} of the paper.*$", output, re.MULTILINE)
        assert "synthetic" in title


def test_the_commands_of_the_readme_are_those_of_the_tour():
    begin = steps(TOUR.split("## What the demo did")[0])
    # "In six commands".
    used = [command for command, _ in steps(README)]
    assert used == [command.partition(" | ")[0] for command, _ in begin] and len(used) == 6


def test_two_commands_set_it_up():
    assert blocks(README.split("## Use")[0], "sh") == [
        "python3 -m venv .venv && . .venv/bin/activate && pip install . && jrdb-avr demo",
        "pip install '.[test]' && pytest",
    ]
    # The command of the README is the one that runs for every change.
    assert blocks(README, "sh")[1] in (ROOT / ".ci" / "run").read_text().splitlines()


def test_the_version_is_the_same_in_every_file():
    texts = {
        name: (ROOT / name).read_text("utf-8")
        for name in ("pyproject.toml", "__init__.py", "CITATION.cff", "CHANGELOG.md")
    }
    versions = {
        name: re.search(r'^(?:__version__ = "|version = "|version: |## )(\d+\.\d+\.\d+)"?$', text, flags=re.M)[1]
        for name, text in texts.items()
    }
    assert len(set(versions.values())) == 1, versions
    assert tomllib.loads(texts["pyproject.toml"])["project"]["authors"][0]["name"] in texts["CITATION.cff"]


def test_the_image_is_set_up_as_the_readme_says():
    # `tests/package.sh` runs these lines in the gate.
    assert re.findall(r"^RUN (.*)", (ROOT / "Dockerfile").read_text("utf-8"), flags=re.M) == [
        "pip install --no-cache-dir /src"
    ]
    assert " pip install . && jrdb-avr demo" in blocks(README, "sh")[0]
    assert "tests/package.sh" in (ROOT / ".ci" / "run").read_text().splitlines()


def test_the_readme_is_short():
    assert len(README.splitlines()) <= 180


def test_the_picture_of_the_definitions_is_what_the_script_draws():
    drawn = subprocess.run([sys.executable, DOCS / "draw_definitions.py"], capture_output=True, text=True, check=True)
    assert drawn.stdout == (DOCS / "definitions.svg").read_text(encoding="utf-8")


def test_every_test_that_holds_a_promise_exists():
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", (ROOT / "SECURITY.md").read_text(encoding="utf-8"))
    assert len(named) > 50
    for path, name in named:
        assert re.search(rf"^def {name}\(", (ROOT / path).read_text(encoding="utf-8"), re.M), f"{path}::{name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_names_only_what_exists(page):
    from jrdb_avr.engine.cli import COMMANDS

    text = page.read_text("utf-8")
    assert set(re.findall(r"jrdb-avr ([a-z]+(?:-[a-z]+)*)", text)) <= set(COMMANDS)
    for name in re.findall(r"`((?:schema|loaders|queries|engine|agent|docs|tests)/[\w/.]*)`", text):
        assert (ROOT / name).exists(), name
    for name, anchor in re.findall(r"\]\((?!https?:)([\w/.]*)#?([\w-]*)\)", text):
        target = page.parent / name if name else page
        assert target.exists(), name
        headings = re.findall(r"^#+ (.*)$", target.read_text("utf-8"), re.M) if anchor else []
        slugs = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
        assert not anchor or anchor in slugs, f"{name}#{anchor}"
    assert not re.search(r"/(?:work|tmp|home|root)/|\b\d{1,3}(?:\.\d{1,3}){3}\b", text.replace("127.0.0.1", ""))
