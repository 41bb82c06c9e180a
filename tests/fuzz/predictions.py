"""Prediction files and bundles from anybody: taken, scored, or refused in one line that names the file.

A file is lines of JSON; a bundle also has the manifest of its run, and hashes that fit.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from functools import cache
from pathlib import Path
from random import Random

import limits
import msgspec
from mutate import mutate
from sample_store import sample_store

from jrdb_avr.engine.report.bundle import bundle_submission, read_bundle, write_bundle
from jrdb_avr.engine.report.prediction_lines import parse_lines, write_lines
from jrdb_avr.engine.report.run_scores import score_runs
from jrdb_avr.engine.report.truth import read_truth
from jrdb_avr.engine.run.imported import import_predictions
from jrdb_avr.schema.errors import AvrError, InputError

PER_CASE = 20


@cache
def _clean(folder):
    store, _ = sample_store(folder)
    bundle = Path(folder) / "bundle"
    if not bundle.exists():
        write_bundle(store, "r", bundle)
    return (
        store,
        read_truth(store),
        (bundle / "predictions.jsonl").read_bytes().splitlines(),
        (bundle / "run.json").read_bytes(),
    )


ODD_LINES = (
    b'{"question_id": "loose"}',
    b'{"question_id": "loose", "answer": {"choice": 1e400}}',
    b'{"question_id": "scores", "answer": {"choice": 2.5}, "evidence": {"frame": -1, "box": [0, 0, 0, 0]}}',
    b'{"question_id": "scores", "evidence": {"frame": 7, "box": [1e308, -1e308, 1e308, 1e308]}}',
    b'{"question_id": "scores", "answer": {"value": -0.0}, "evidence": {"frame": 7, "box": [3700, 0, 200, 480]}}',
    b'{"question_id": "", "answer": {}}',
    b"",
    b"[]",
    b"null",
)


def prepare(folder):
    """Make the store and the bundle."""
    _clean(str(folder))


def run_case(seed, number, folder, save):
    """Some files of predictions and bundles; how many lines they had."""
    rng = Random(f"{seed} predictions {number}")
    store, truth, lines, manifest = _clean(str(folder))
    count = 0
    for n in range(PER_CASE):
        rows = [
            rng.choice(ODD_LINES) if rng.random() < 0.1 else line for line in rng.sample(lines, rng.randrange(1, 8))
        ]
        rows = [mutate(rng, row)[0] if row and rng.random() < 0.5 else row for row in rows]
        data, run = b"\n".join(rows), manifest
        if rng.random() < 0.3:
            run = mutate(rng, manifest)[0]
        count += len(rows)
        limits.begin()
        try:
            if n % 2:
                _import(store, folder, data)
            else:
                _score(store, truth, folder, data, run)
        except AvrError as error:
            assert str(error) and "\n" not in str(error), error
        except Exception:
            save("predictions.jsonl", data)
            save("run.json", run)
            raise
    return count


def _import(store, folder, data):
    path = Path(folder) / "own.jsonl"
    path.write_bytes(data)
    table = parse_lines(data, "own", path)
    assert parse_lines(b"".join(write_lines(table)), "own", path).equals(table)
    try:
        import_predictions(store, path)
    except InputError:
        assert not store.run_path("own").exists(), "a refused file leaves a run"
        raise
    finally:
        shutil.rmtree(store.run_path("own"), ignore_errors=True)


def _score(store, truth, folder, data, run):
    place = Path(folder) / "own"
    place.mkdir(exist_ok=True)
    sums = "".join(
        f"{hashlib.sha256(text).hexdigest()}  {name}\n"
        for name, text in (("run.json", run), ("predictions.jsonl", data))
    )
    for name, text in (("run.json", run), ("predictions.jsonl", data), ("SHA256SUMS", sums.encode())):
        (place / name).write_bytes(text)
    ((_, scored),) = score_runs(truth, [place], lambda own: bundle_submission(store, read_bundle(own)), 0.5, True)
    scores = scored.table
    for row in scores.select(["answer_score", "evidence_score", "combined_score"]).to_pylist():
        assert set(row.values()) <= {0, 1}, row
        assert row["combined_score"] == min(row["answer_score"], row["evidence_score"]), row
    json.loads(msgspec.json.encode(scores.to_pylist()))
