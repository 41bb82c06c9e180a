"""What `docs/integrations.md` shows is run as it stands, with the commands of the installed package."""

import os
import re
import signal
import socket
import subprocess
import sys
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from environment import DOCS, needs

needs("inspect_ai", "openai", "mcp", "gymnasium")

PAGE = (DOCS / "integrations.md").read_text("utf-8")
CONSOLE = re.findall(r"```console\n(.*?)\n```", PAGE, re.S)
PYTHON = re.findall(r"```python\n(.*?)\n```", PAGE, re.S)


@pytest.fixture
def shell(small_demo, tmp_path):
    """Run a program in a folder that holds the demo, with the commands of the Python that runs the tests."""
    if not any(own.name == "jrdb_avr" for own in entry_points(group="inspect_ai")):
        assert not os.environ.get("REQUIRE_EXTRAS"), "the package is not installed"
        pytest.skip("the package is not installed, so there are no commands")
    (tmp_path / "demo-out").symlink_to(small_demo.folder)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

    def run(*command):
        done = subprocess.run(
            command, cwd=tmp_path, env=os.environ | {"PATH": path}, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    run.path, run.folder = path, tmp_path
    return run


def commands(block):
    return [line[2:] for line in block.splitlines() if line.startswith("$ ")]


@pytest.mark.slow
def test_inspect_runs_as_shown(shell):
    (block,) = [own for own in CONSOLE if "inspect eval" in own]
    serve, *rest = commands(block)
    wait = "for i in $(seq 1000); do grep -q ready served && break; sleep 0.1; done"
    script = ["set -e", f"{serve.removesuffix(' &')} > served < /dev/null &", "trap 'kill $!' EXIT", wait, *rest]
    with socket.socket() as held:
        # No other program gets the port, and a server that reuses addresses does.
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(("127.0.0.1", 0))
        out = shell("bash", "-c", "\n".join(script).replace("8734", str(held.getsockname()[1])))
    # Narrow terminals cut the last.
    for name in ("answer", "evidence", "combined", "halluc"):
        assert name in out
    assert len(list((shell.folder / "logs").glob("*.eval"))) == 1


def test_mcp_over_http_starts_as_shown(shell, small_demo):
    (block,) = [own for own in CONSOLE if "--http" in own]
    (command,) = commands(block)
    # The demo is not to be written to.
    (shell.folder / "own").mkdir()
    for name in ("questions", "store.json"):
        (shell.folder / "own" / name).symlink_to(small_demo.folder / "store" / name)
    command = command.replace("8735", "0").replace("demo-out/store", "own")
    environment = os.environ | {"PATH": shell.path}
    with subprocess.Popen(
        ["bash", "-c", f"exec {command}"], cwd=shell.folder, env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        shown, printed = block.splitlines()[1], process.stdout.readline().rstrip()
        form = r"http://127\.0\.0\.1:\d+/mcp [\w-]{43}"
        assert re.fullmatch(form, shown) and re.fullmatch(form, printed)
        process.send_signal(signal.SIGTERM)
        assert process.wait(300) == 0


@pytest.mark.parametrize("number", range(len(PYTHON)))
def test_programs_run_as_shown(shell, number):
    for block in CONSOLE:
        if "public" in block and "mkdir" in block:
            shell("bash", "-c", "\n".join(["set -e", *commands(block)]))
    printed = shell(sys.executable, "-c", PYTHON[number])
    assert re.search(["QuestionScore", "image/jpeg", "Question: "][number], printed), printed
