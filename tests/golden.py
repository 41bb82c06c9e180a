"""Compare what the program computes with recorded hashes: `python tests/golden.py check|record [PART ...]`.

A change that is meant to change nothing leaves every hash as it is; a change that is meant to is followed by
`record`, and its commit lists what changed. The hashes are in `golden.json`, one section per part:

questions-7, questions-11   files, annotations, intervals and questions of two synthetic worlds
runs-7, runs-11             prompts, a scored run and report figures of ten questions of each method in them
real                        questions from real annotations, in `$JRDB_REAL` or `../shared/jrdb-real`; skipped if absent

The prompts are the bodies of all HTTP requests that ten questions of each method send to the simulated model, images
included, without the checks of the server before them. Bytes of Parquet and JPEG depend on the installed libraries, so
their versions are recorded too.
"""

from __future__ import annotations

import contextlib
import hashlib
import http.server
import json
import os
import subprocess
import sys
import tempfile
import threading
import urllib.error
import urllib.request
from importlib.metadata import version
from pathlib import Path

RECORD = Path(__file__).with_name("golden.json")
REAL = Path(os.environ.get("JRDB_REAL", Path(__file__).parents[2] / "shared" / "jrdb-real"))
MODEL_SERVER = "jrdb_avr.agent.simulated"
METHODS = (  # with the options that choose a policy
    "monolithic",
    "chain-of-thought",
    "search-recognize",
    "react",
    "agent",
    "agent-passive",
    "agent-no-world",
    "agent-passive-no-world",
    "agent --policy model",
    "agent-no-world --policy model",
)
LIBRARIES = ("duckdb", "kuzu", "numpy", "opencv-python-headless", "pyarrow")
NOISE = ("wrong_attribute=0.1", "wrong_box=0.1", "malformed=0.05", "seed=3")


def jrdb_avr(*arguments: object) -> str:
    """Run the command in a process of its own and return what it prints."""
    command = [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()", *map(str, arguments)]
    done = subprocess.run(command, text=True, capture_output=True)
    if done.returncode:
        sys.exit(f"jrdb-avr {' '.join(map(str, arguments))}\n{done.stderr}")
    return done.stdout


def sha256(*parts: bytes) -> str:
    """Hash of the parts, first 16 hexadecimal digits."""
    found = hashlib.sha256()
    for part in parts:
        found.update(len(part).to_bytes(8, "big") + part)
    return found.hexdigest()[:16]


def tables(folder: Path) -> dict[str, str]:
    """Hash of each Parquet file in a folder."""
    found = sorted(folder.rglob("*.parquet"))
    return {path.relative_to(folder).as_posix(): sha256(path.read_bytes()) for path in found}


def rows(store: Path, query: str) -> str:
    """Hash of the rows that a SQL query over a store returns."""
    return sha256(jrdb_avr("sql", query, "--store", store, "--json").encode())


@contextlib.contextmanager
def recorded_model(noise: tuple[str, ...]):
    """Serve the simulated model behind a proxy; yield the proxy's address and the list of request-body hashes."""
    knobs = [part for knob in noise for part in ("--knob", knob)]
    with subprocess.Popen(
        [sys.executable, "-m", MODEL_SERVER, *knobs], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        target = process.stdout.readline().split()[-1].removesuffix("/v1")
        bodies = []

        class Proxy(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def log_message(self, *_):
                pass

            def do_GET(self):
                self.forward(None)

            def do_POST(self):
                body = self.rfile.read(int(self.headers["Content-Length"]))
                bodies.append(sha256(body))
                self.forward(body)

            def forward(self, body):
                request = urllib.request.Request(target + self.path, body, {"Content-Type": "application/json"})
                try:
                    with urllib.request.urlopen(request) as answer:
                        status, content = answer.status, answer.read()
                except urllib.error.HTTPError as error:
                    status, content = error.code, error.read()
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

        with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Proxy) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            yield f"http://127.0.0.1:{server.server_address[1]}/v1", bodies
            server.shutdown()
        process.kill()


def figures(store: Path) -> str:
    """Hash of the numbers, not the labels nor the order of rows, of every report table but for times on the clock."""

    def numbers(value):
        if isinstance(value, dict):
            return [
                n for key, part in value.items() if "second" not in key and key != "settings" for n in numbers(part)
            ]
        if isinstance(value, list):
            return [n for part in value for n in numbers(part)]
        return [value] if value is None or isinstance(value, (int, float)) else []

    printed = json.loads(jrdb_avr("report", "--store", store, "--table", "all", "--json"))
    return sha256("\n".join(sorted(json.dumps(numbers(row)) for row in printed)).encode())


def benchmark(seed: int, folder: Path) -> Path:
    """Make a synthetic world and its questions; returns the store."""
    root, store = folder / "root", folder / "store"
    jrdb_avr("sample", root, "--sequences", 2, "--frames", 450, "--people", 14, "--seed", seed)
    jrdb_avr("load", root, "--store", store)
    jrdb_avr("generate", "--store", store)
    return store


def questions(seed: int, folder: Path) -> dict[str, object]:
    """Hashes of a synthetic world from its label files to its questions."""
    store = benchmark(seed, folder)
    jrdb_avr("validate", "--replay", "--store", store)
    return {
        "root": sha256(*(path.read_bytes() for path in sorted((folder / "root").rglob("*")) if path.is_file())),
        "annotations": sha256(*(path.read_bytes() for path in sorted((store / "annotations").rglob("*.parquet")))),
        "intervals": sha256(*(path.read_bytes() for path in sorted((store / "intervals").rglob("*.parquet")))),
        "questions": tables(store / "questions"),
    }


def runs(seed: int, folder: Path) -> dict[str, object]:
    """Hashes of what ten questions of each method send, answer, score and report."""
    store = benchmark(seed, folder)
    # The templates in turn, so that ten questions are of many kinds.
    picked = "SELECT question_id, row_number() OVER (PARTITION BY template ORDER BY question_id) AS turn FROM questions"
    query = f"SELECT question_id FROM ({picked}) ORDER BY turn, question_id LIMIT 10"
    ids = ",".join(row["question_id"] for row in json.loads(jrdb_avr("sql", query, "--store", store, "--json")))
    prompts = {}
    for method in METHODS:
        name, *policy = method.split()
        # Some methods are noisy in the second world: replies that have to be repaired have prompts of their own.
        noise = NOISE if seed != 7 and name in ("react", "agent", "search-recognize") else ()
        with recorded_model(noise) as (url, bodies):
            model = ("--model", "marker", "--base-url", url)
            jrdb_avr("preflight", *model)
            checks = set(bodies)
            jrdb_avr(
                *("evaluate", "--store", store, "--method", name, *policy, *model),
                *("--run-id", "-".join((name, *policy[1:])), "--questions", ids, "--no-scores"),
            )
            prompts[method] = sha256(*(body.encode() for body in sorted(bodies) if body not in checks))
    jrdb_avr("score", "--store", store)
    order = "ORDER BY run_id, question_id"
    return {
        "prompts": prompts,
        "predictions": rows(store, f"SELECT * EXCLUDE (seconds) FROM predictions {order}"),
        "steps": rows(store, f"SELECT * EXCLUDE (seconds) FROM steps {order}, step"),
        "scores": rows(store, f"SELECT * FROM scores {order}"),
        "report": figures(store),
    }


def real(folder: Path) -> dict[str, object]:
    """Hashes of the questions from real annotations."""
    jrdb_avr("load", REAL, "--store", folder / "store")
    jrdb_avr("generate", "--store", folder / "store")
    return {"questions": tables(folder / "store" / "questions")}


PARTS = {
    "questions-7": lambda at: questions(7, at),
    "runs-7": lambda at: runs(7, at),
    "questions-11": lambda at: questions(11, at),
    "runs-11": lambda at: runs(11, at),
    "real": real,
}


def flat(value: object, name: str = "") -> dict[str, object]:
    """Nested mappings as one of dotted names."""
    if not isinstance(value, dict):
        return {name: value}
    return {k: v for key, part in value.items() for k, v in flat(part, f"{name}.{key}" if name else key).items()}


def main(command: str, *names: str) -> int:
    """Compute the parts, and compare or record them; returns the exit code."""
    if command not in ("check", "record") or not set(names) <= set(PARTS):
        print(f"usage: golden.py check|record [{' | '.join(PARTS)}]", file=sys.stderr)
        return 2
    recorded = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    libraries = {name: version(name) for name in LIBRARIES}
    if command == "check" and recorded["libraries"] != libraries:
        print(f"recorded with other libraries: {recorded['libraries']}, here {libraries}")
    differing = 0
    for part in names or PARTS:
        if part == "real" and not REAL.is_dir():
            print("real: skipped, no annotations there")
            continue
        with tempfile.TemporaryDirectory() as folder:
            found = PARTS[part](Path(folder))
        if command == "record":
            recorded[part] = found
            continue
        before, now = flat(recorded[part]), flat(found)
        changed = [name for name in sorted(before | now) if before.get(name) != now.get(name)]
        differing += len(changed)
        print(f"{part}: {len(now)} hashes, " + (f"changed: {', '.join(changed)}" if changed else "all as recorded"))
    if command == "record":
        RECORD.write_text(json.dumps({"libraries": libraries} | recorded, indent=2) + "\n")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main(*(sys.argv[1:] or [""])))
