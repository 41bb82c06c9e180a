"""The manifest of a run, `runs/<run_id>/run.json`: its questions, method, model and settings."""

from __future__ import annotations

from typing import Any

import msgspec

from jrdb_avr.queries.files import file_hash
from jrdb_avr.queries.store import Store, write_json
from jrdb_avr.schema.errors import StoreError, did_you_mean


class RunManifest(msgspec.Struct, frozen=True):
    """`run.json`. `questions_sha256` is the hash of the questions file, `question_ids` the run's questions in it.

    `synthetic` marks runs of the simulated model or on the sample world: their scores are labelled so wherever they are
    printed. `settings` holds what else shaped the run (budget, sampling, box convention), as plain JSON. `created` is
    an ISO 8601 time. `selection` is how the questions were chosen, a `QuestionSelection` as plain JSON, empty for all.
    `world` counts the statements that read and wrote the world model, `reads` and `writes`, of a run that has ended; a
    resumed one adds to them, and a session that was killed is not counted.
    """

    run_id: str
    method: str
    model: str
    questions_sha256: str
    question_ids: tuple[str, ...]
    synthetic: bool
    settings: dict[str, Any]
    created: str
    selection: dict[str, Any] = {}
    world: dict[str, int] = {}


def questions_hash(store: Store) -> str:
    """sha256 of the store's questions file, in hex. Raises StoreError where there is none."""
    path = store.question_path("questions")
    try:
        return file_hash(path)
    except FileNotFoundError:
        raise StoreError(f"{store.path} has no questions yet: run 'jrdb-avr generate --store {store.path}'") from None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from None


def write_run_manifest(store: Store, manifest: RunManifest) -> None:
    """Write `run.json`, atomically."""
    write_json(store.run_path(manifest.run_id) / "run.json", manifest)


def read_run_manifest(store: Store, run_id: str) -> RunManifest:
    """Read `run.json`. Raises StoreError where the run is missing or its manifest cannot be read or names another."""
    path = store.run_path(run_id) / "run.json"
    try:
        manifest = msgspec.json.decode(path.read_bytes(), type=RunManifest)
    except FileNotFoundError:
        raise StoreError(f"{store.path} has no run {run_id!r}{did_you_mean(run_id, run_ids(store))}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, OSError) as error:
        raise StoreError(f"cannot read {path}: {error}; evaluate again under another run id") from None
    if manifest.run_id != run_id:
        # A copied or renamed folder: its scores would be written to, and reported as, the other run's.
        raise StoreError(f"{path} is of run {manifest.run_id!r}: give the folder that name, or take it out of runs/")
    return manifest


def run_ids(store: Store) -> list[str]:
    """Names of the store's runs, sorted."""
    return sorted(path.parent.name for path in (store.path / "runs").glob("*/run.json"))
