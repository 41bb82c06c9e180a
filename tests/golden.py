"""Compare what the program computes with recorded hashes: `python tests/golden.py check|record [PART ...]`.

A change that must not alter results leaves every hash as it is. A change that alters results on purpose is followed by
`record`, and its commit message lists the changed hashes. The hashes are in `golden.json`, one section per part:

real-all, real-paper, real-train   questions, answers and evidence from real annotations, one part per profile;
                                   skipped without the folder `$JRDB_REAL` (default `../shared/jrdb-real`)
sample                             the same from the frozen sample root, profiles all and train
prompts                            requests and predictions of each method, which gets recorded replies
scores                             scores and report figures of two recorded runs

Every hash is of rows with named columns (`QUESTIONS`, `ANSWERS`, `EVIDENCE`, `REFUSED`, `PREDICTIONS`, `SCORES`), not
of files, so the layout of a store may change. Three functions know a layout or an interface and are the only ones to
adapt: `read_evidence`, `evaluate` and `import_predictions`.

The recorded input is in `fixtures/`: `golden_root.tar.xz` is a sample root without pictures, `golden_replies.jsonl.xz`
holds the replies, `golden_monolithic-*.jsonl` the predictions of the tour. Pictures are made here: each shows its frame
number and its columns in grey, so that a request's pictures can be reduced to (frame, left column, width, height).

`python tests/golden.py replies` records the replies again, if prompts change on purpose. The replies come from the
simulated model, which gets the frame and angle that the pictures show. If question ids change,
`golden_monolithic-*.jsonl` are made from a store of the root by the evaluation at the start of `docs/tour.md` and
`export --jsonl`.
"""

from __future__ import annotations

import base64
import contextlib
import functools
import hashlib
import http.server
import itertools
import json
import lzma
import os
import random
import shutil
import subprocess
import sys
import tarfile
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import cv2
import duckdb
import numpy as np

HERE = Path(__file__).parent
RECORD = HERE / "golden.json"
ROOT = HERE / "fixtures" / "golden_root.tar.xz"
REPLIES = HERE / "fixtures" / "golden_replies.jsonl.xz"
REAL = Path(os.environ.get("JRDB_REAL", HERE.parents[1] / "shared" / "jrdb-real"))

QUESTIONS = "question_id, sequence, family, template, question, choices, answer_mode"
ANSWERS = (
    "question_id, answer, target_track, plan, proofs, rules, hops, time_gap_s, separation_deg, "
    "people_in_scene, bindings, needed, twin_id"
)
EVIDENCE = "sequence, track, frame, x, y, w, h"
REFUSED = "sequence, family, template, rule, candidates"
BOX = ", ".join(f"evidence_{part}" for part in ("frame", "x", "y", "w", "h"))
PREDICTIONS = f"question_id, status, answer, {BOX}, verdict, n_observations, n_model_calls"
SCORES = "run_id, question_id, answer_score, evidence_score, combined_score, invalid"

METHODS = (  # each entry: a method, and the options of the method
    "monolithic",
    "chain-of-thought",
    "search-recognize",
    "react",
    "agent",
    "agent-passive",
    "agent-no-world",
    "agent-passive-no-world",
    "agent --advice off",
)
NOISE = ("wrong=0.1", "wrong_box=0.1", "malformed=0.1", "seed=3")
"""Errors of the simulated model in half of the recorded runs, so that replies have to be repaired."""


def jrdb_avr(*arguments: object, may_fail: bool = False) -> str:
    """Run a command in a process of its own and return its standard output; end the check if the command fails."""
    command = [sys.executable, "-c", "from jrdb_avr.engine.cli import main; main()", *map(str, arguments)]
    done = subprocess.run(command, text=True, capture_output=True)
    if done.returncode and not may_fail:
        sys.exit(f"jrdb-avr {' '.join(map(str, arguments))}\n{done.stderr}{done.stdout}")
    return done.stdout


def sha256(parts: Iterable[str]) -> str:
    """Return the first 16 hexadecimal digits of the hash of lines of text."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() + b"\n")
    return digest.hexdigest()[:16]


def hash_rows(query: str) -> str:
    """Return the hash of the rows of a SQL query over Parquet files."""
    return sha256(json.dumps(row, default=list) for row in duckdb.connect().execute(query).fetchall())


# -- questions --------------------------------------------------------------------------------------------------------


def read_evidence(store: Path) -> str:
    """Return the SQL of every evidence box of every question: `question_id` and the columns `EVIDENCE`."""
    questions = store / "questions"
    return (
        f"SELECT question_id, {EVIDENCE} FROM '{questions}/questions.parquet' "
        f"JOIN '{questions}/answers.parquet' USING (question_id) "
        f"JOIN '{questions}/evidence.parquet' USING (sequence) WHERE track = target_track"
    )


def hash_questions(store: Path) -> dict[str, str]:
    """Return the hashes of a store's questions, answers, refused candidates and evidence."""
    files, evidence = store / "questions", read_evidence(store)
    return {
        "questions": hash_rows(f"SELECT {QUESTIONS} FROM '{files}/questions.parquet' ORDER BY question_id"),
        "answers": hash_rows(f"SELECT {ANSWERS} FROM '{files}/answers.parquet' ORDER BY question_id"),
        "refused": hash_rows(f"SELECT {REFUSED} FROM '{files}/rejected.parquet' ORDER BY ALL"),
        "evidence": hash_rows(f"SELECT DISTINCT {EVIDENCE} FROM ({evidence}) ORDER BY ALL"),
        "evidence of each question": hash_rows(
            f"SELECT question_id, count(*), min(frame), max(frame) FROM ({evidence}) GROUP BY ALL ORDER BY ALL"
        ),
    }


def hash_real(profile: str, folder: Path) -> dict[str, str]:
    """Return the hashes of the questions from real annotations."""
    jrdb_avr("load", REAL, "--store", folder / "store")
    jrdb_avr("generate", "--store", folder / "store", "--profile", profile)
    return hash_questions(folder / "store")


def make_store(folder: Path, profile: str = "all") -> Path:
    """Load the frozen root with grey panoramas, generate its questions, and return the store."""
    with tarfile.open(ROOT) as archive:
        archive.extractall(folder / "root", filter="data")
    for sequence, frames in json.loads((folder / "root" / "panoramas.json").read_text()).items():
        images = folder / "root" / "images" / "image_stitched" / sequence
        images.mkdir(parents=True)
        for frame in frames:
            cv2.imwrite(f"{images}/{frame:06d}.jpg", panorama(frame))
    jrdb_avr("load", folder / "root", "--store", folder / "store")
    jrdb_avr("generate", "--store", folder / "store", "--profile", profile)
    return folder / "store"


def hash_sample(folder: Path) -> dict[str, object]:
    """Return the hashes of the questions from the frozen root."""
    store = make_store(folder)
    found = {"all": hash_questions(store)}
    shutil.rmtree(store / "questions")
    jrdb_avr("generate", "--store", store, "--profile", "train")
    return found | {"train": hash_questions(store)}


# -- pictures ---------------------------------------------------------------------------------------------------------

WIDTH, HEIGHT, CELL, BITS = 3760, 480, 8, 16
COLUMNS = np.repeat(np.array([random.Random(0).choices((0, 1), k=WIDTH // CELL)]), CELL)
"""The upper half of every panorama: cells of eight columns, light (1) or dark (0), a pattern without repetition."""


def panorama(frame: int) -> np.ndarray:
    """Return a grey panorama: its upper half shows the columns, its lower half the frame number in horizontal bands."""
    bands = np.repeat([frame >> bit & 1 for bit in range(BITS)], HEIGHT // 2 // BITS)
    light = np.vstack([np.tile(COLUMNS, (HEIGHT // 2, 1)), np.tile(bands[:, None], (1, WIDTH))])
    return (64 + 128 * light).astype(np.uint8)


@functools.cache
def shifted_columns() -> np.ndarray:
    """Return the pattern of every crop, one row per left column, as -1 and 1."""
    return np.lib.stride_tricks.sliding_window_view(np.tile(2.0 * COLUMNS - 1, 2), HEIGHT)[:WIDTH].astype(np.float32)


@functools.lru_cache(4096)
def read_picture(jpeg: bytes) -> tuple[int, int, int, int] | None:
    """Return frame, left column, width and height of a crop or panorama; None for a picture that is not made here."""
    light = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE) > 128
    height, width = light.shape
    if height != HEIGHT:
        return None
    upper = light[: HEIGHT // 2].mean(axis=0) > 0.5
    matches = shifted_columns() @ np.where(upper[:HEIGHT], np.float32(1), np.float32(-1))
    left = int(matches.argmax())
    if matches[left] < 0.9 * HEIGHT:
        return None
    bands = light[HEIGHT // 2 :].reshape(BITS, -1).mean(axis=1) > 0.5
    return sum(int(bit) << place for place, bit in enumerate(bands)), left, width, height


def without_pictures(body: bytes) -> str:
    """Return a request as JSON with each picture reduced to what `read_picture` returns."""
    request = json.loads(body)
    for part, jpeg in pictures_of(request):
        part["image_url"]["url"] = read_picture(jpeg) or "drawn"
    return json.dumps(dict(sorted(request.items())))


def pictures_of(request: dict[str, object]) -> Iterator[tuple[dict[str, object], bytes]]:
    """Yield the parts of a request that are pictures, and the bytes of each picture."""
    for message in request["messages"]:
        for part in message["content"] if isinstance(message["content"], list) else ():
            if part["type"] == "image_url":
                yield part, base64.b64decode(part["image_url"]["url"].partition(",")[2])


# -- prompts ----------------------------------------------------------------------------------------------------------

Answer = Callable[[bytes], dict[str, object] | None]
"""Returns the `message` of a completion for the body of a request, or None for a request that is not known."""

UNKNOWN = {"role": "assistant", "content": "{}"}


@contextlib.contextmanager
def model_server(answer: Answer) -> Iterator[tuple[str, list[str]]]:
    """Serve an OpenAI-compatible model; yield its address and the list of requests without pictures."""
    requests = []

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        wbufsize = -1

        def log_message(self, *_):
            pass

        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            requests.append(without_pictures(body))
            choice = {"index": 0, "finish_reason": "stop", "message": answer(body) or UNKNOWN}
            usage = {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110}
            reply = {"id": "x", "object": "chat.completion", "created": 0, "model": "recorded", "choices": [choice]}
            content = json.dumps(reply | {"usage": usage}).encode()
            self.send_response(200)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/v1", requests
        server.shutdown()


def evaluate(store: Path, method: str, url: str, run_id: str, questions: Iterable[str]) -> None:
    """Run a method of `METHODS` with the model at an address."""
    jrdb_avr(
        *("evaluate", "--store", store, "--method", *method.split(), "--model", "recorded", "--base-url", url),
        *("--run-id", run_id, "--questions", ",".join(questions), "--no-scores"),
        may_fail=True,
    )


def choose_questions(store: Path) -> list[str]:
    """Return the ids of twelve questions, of as many templates as possible."""
    ranked = "SELECT question_id, row_number() OVER (PARTITION BY template ORDER BY question_id) AS turn FROM "
    query = f"SELECT question_id FROM ({ranked} '{store}/questions/questions.parquet') ORDER BY turn, question_id"
    return [question_id for (question_id,) in duckdb.connect().execute(f"{query} LIMIT 12").fetchall()]


def play(store: Path, answer_of: Callable[[str], Answer]) -> Iterator[tuple[str, str, list[str]]]:
    """Run every method on half of the questions without and half with noise; yield each run's name, id and requests.

    The requests that check the server before a run are left out.
    """
    ids = choose_questions(store)
    with model_server(lambda body: None) as (url, checks):
        jrdb_avr("preflight", "--model", "recorded", "--base-url", url, may_fail=True)
    for number, (method, noise) in enumerate(itertools.product(METHODS, ("perfect", "noisy"))):
        name = f"{method} {noise}"
        with model_server(answer_of(name)) as (url, requests):
            evaluate(store, method, url, f"run-{number}", ids[noise == "noisy" :: 2])
        yield name, f"run-{number}", sorted(set(requests) - set(checks))


def hash_prompts(folder: Path) -> dict[str, object]:
    """Return the hashes of what each method sends and predicts; name the runs whose requests have no recorded reply."""
    store = make_store(folder)
    with lzma.open(REPLIES, "rt") as lines:
        replies = dict(map(json.loads, lines))

    def recorded(name: str) -> Answer:
        return lambda body: replies.get(sha256([name, without_pictures(body)]))

    prompts, predictions = {}, {}
    for name, run_id, requests in play(store, recorded):
        prompts[name] = sha256(requests)
        table = f"'{store}/runs/{run_id}/predictions.parquet'"
        predictions[name] = hash_rows(f"SELECT {PREDICTIONS} FROM {table} ORDER BY question_id")
        if unknown := [request for request in requests if sha256([name, request]) not in replies]:
            print(f"{name}: {len(unknown)} of {len(requests)} requests have no recorded reply, such as {unknown[0]}")
    return {"prompts": prompts, "predictions": predictions}


def with_references(body: bytes, sequence: str) -> dict[str, object]:
    """Return a request in which each picture says what it shows, as in a run that is declared simulated."""
    request = json.loads(body)
    for part, jpeg in pictures_of(request):
        if (shown := read_picture(jpeg)) is not None:
            frame, left, width, _ = shown
            angle = None if width == WIDTH else (left + width / 2) * 360 / WIDTH % 360
            part["jrdb_avr"] = {"sequence": sequence, "frame": frame, "angle": angle}
    return request


def record_replies() -> None:
    """Write `REPLIES`: what the simulated model replies to the requests of all methods."""
    from jrdb_avr.agent.simulated.profiles import PERFECT, parse_errors
    from jrdb_avr.agent.simulated.server import Server
    from jrdb_avr.agent.simulated.sight import Sight
    from jrdb_avr.queries.store import Store

    replies: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as folder:
        store = make_store(Path(folder))
        sight = Sight(Store(store))
        (sequence,) = Store(store).manifest().sequences

        def simulated(name: str) -> Answer:
            server = Server(sight, parse_errors(NOISE) if name.endswith("noisy") else PERFECT)
            server.server_close()

            def answer(body: bytes) -> dict[str, object]:
                request = with_references(body, sequence)
                message = server.reply(json.dumps(request).encode())["choices"][0]["message"]
                replies[sha256([name, without_pictures(body)])] = message
                return message

            return answer

        kept = {
            sha256([name, request]): replies[sha256([name, request])]
            for name, _, requests in play(store, simulated)
            for request in requests
        }
    with lzma.open(REPLIES, "wt") as lines:
        lines.writelines(json.dumps(item) + "\n" for item in sorted(kept.items()))
    print(f"{len(kept)} replies, {REPLIES.stat().st_size >> 10} KB")


# -- scores -----------------------------------------------------------------------------------------------------------


def import_predictions(store: Path, file: Path, run_id: str) -> None:
    """Take predictions into a store as a run, and score them."""
    jrdb_avr("score", run_id, "--store", store, "--jsonl", file)


def hash_scores(folder: Path) -> dict[str, str]:
    """Return the hashes of the scores and of the report's numbers of the tour's two runs."""
    store = make_store(folder)
    for run_id in ("monolithic-perfect", "monolithic-noisy"):
        import_predictions(store, HERE / "fixtures" / f"golden_{run_id}.jsonl", run_id)
    scores = f"SELECT {SCORES} FROM read_parquet('{store}/runs/*/scores.parquet') ORDER BY run_id, question_id"
    rows = json.loads(jrdb_avr("report", "--store", store, "--table", "all", "--json"))
    return {"scores": hash_rows(scores), "figures": sha256(sorted(json.dumps(list(numbers_of(row))) for row in rows))}


def numbers_of(value: object) -> Iterator[int | float]:
    """Yield the numbers of a row of a report in the order of its columns, without times on the clock and settings."""
    if isinstance(value, dict):
        parts = [part for key, part in value.items() if "second" not in key and key != "settings"]
    else:
        parts = value if isinstance(value, list) else []
    if isinstance(value, (int, float)):
        yield value
    for part in parts:
        yield from numbers_of(part)


# -- command line -----------------------------------------------------------------------------------------------------

PARTS = {
    **{f"real-{profile}": functools.partial(hash_real, profile) for profile in ("all", "paper", "train")},
    "sample": hash_sample,
    "prompts": hash_prompts,
    "scores": hash_scores,
}


def flatten(value: object, name: str = "") -> dict[str, object]:
    """Return nested mappings as one mapping with dotted names."""
    if not isinstance(value, dict):
        return {name: value}
    return {k: v for key, part in value.items() for k, v in flatten(part, f"{name}.{key}" if name else key).items()}


def compute(part: str) -> dict[str, object]:
    """Return the hashes of a part by dotted names."""
    with tempfile.TemporaryDirectory() as folder:
        return flatten(PARTS[part](Path(folder)))


def changed_hashes(part: str) -> list[str]:
    """Return the names of the hashes of a part that are not as recorded."""
    before, now = flatten(json.loads(RECORD.read_text())[part]), compute(part)
    return [name for name in sorted(before | now) if before.get(name) != now.get(name)]


def main(command: str = "", *names: str) -> int:
    """Check or record the parts, and return the exit code."""
    if command == "replies" and not names:
        record_replies()
        return 0
    if command not in ("check", "record") or not set(names) <= set(PARTS):
        print(f"usage: golden.py check|record [{' | '.join(PARTS)}]\n       golden.py replies", file=sys.stderr)
        return 2
    differing = 0
    for part in names or PARTS:
        if part.startswith("real") and not REAL.is_dir():
            print(f"{part}: skipped, {REAL} does not exist")
        elif command == "record":
            recorded = json.loads(RECORD.read_text()) if RECORD.exists() else {}
            RECORD.write_text(json.dumps(recorded | {part: compute(part)}, indent=2) + "\n")
        else:
            changed = changed_hashes(part)
            differing += len(changed)
            print(f"{part}:", "changed: " + ", ".join(changed) if changed else "all hashes as recorded", flush=True)
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
