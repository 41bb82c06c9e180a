"""The manifest of a run, `runs/<run_id>/run.json`: its questions, method, model and settings."""

from __future__ import annotations

from typing import Any

import msgspec

from jrdb_avr.queries.files import file_hash
from jrdb_avr.queries.store import Store, write_json
from jrdb_avr.schema.errors import StoreError, did_you_mean


class RunManifest(msgspec.Struct, frozen=True):
    """Content of `run.json`.

    - `questions_sha256`: hash of the file of questions; `question_ids`: the questions of the run.
    - `synthetic`: true for the simulated model and for sample worlds; every table marks the scores of such a run.
    - `settings`: other settings of the run (budget, sampling, box convention), as plain JSON.
    - `created`: time in ISO 8601.
    - `selection`: the `QuestionSelection` as plain JSON, empty if the run has all questions.
    - `world`: number of statements that read (`reads`) and wrote (`writes`) the world model. A resumed run adds to the
      numbers. Sessions that were killed are not counted.
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
    """Return the sha256 of the file of questions, in hex. Raises StoreError if there are no questions."""
    path = store.question_path("questions")
    try:
        return file_hash(path)
    except FileNotFoundError:
        raise StoreError(f"{store.path} has no questions yet: run 'jrdb-avr generate --store {store.path}'") from None
    except OSError as error:
        raise StoreError(f"cannot read {path}: {error.strerror}") from None


def write_run_manifest(store: Store, manifest: RunManifest) -> None:
    """Write `run.json` atomically."""
    write_json(store.run_path(manifest.run_id) / "run.json", manifest)


def read_run_manifest(store: Store, run_id: str) -> RunManifest:
    """Read `run.json`. Raises StoreError if the run is missing, or its manifest is broken or names another run."""
    path = store.run_path(run_id) / "run.json"
    try:
        manifest = msgspec.json.decode(path.read_bytes(), type=RunManifest)
    except FileNotFoundError:
        raise StoreError(f"{store.path} has no run {run_id!r}{did_you_mean(run_id, run_ids(store))}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, OSError) as error:
        raise StoreError(f"cannot read {path}: {error}; evaluate again under another run id") from None
    if manifest.run_id != run_id:
        # In a copied or renamed folder, scores would be reported as those of the other run.
        raise StoreError(f"{path} is of run {manifest.run_id!r}: give the folder that name, or take it out of runs/")
    return manifest


def run_ids(store: Store) -> list[str]:
    """Return the ids of the store's runs, sorted."""
    return sorted(path.parent.name for path in (store.path / "runs").glob("*/run.json"))
