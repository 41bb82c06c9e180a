"""The manifest of a run. The file `runs/<run_id>/run.json` names the run's questions, method, model and settings."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from typing import Any, Final

import msgspec

from jrdb_avr.queries.store import Store, write_json
from jrdb_avr.schema.errors import StoreError, did_you_mean
from jrdb_avr.schema.tables import GENERATION_KEY

_LEVELS: Final = 30
"""Maximum nesting depth of `run.json` that is read. New runs have less."""
_TOKEN: Final = re.compile(rb'"(?:[^"\\]|\\.)*"|[^]["{}]+|.', re.DOTALL)


class RunManifest(msgspec.Struct, frozen=True):
    """Content of `run.json`.

    Attributes:
        run_id: Id of the run, which is also the name of its folder.
        method: Name of the method.
        model: Id of the model at its server.
        questions_sha256: Hash of the store's questions when the run began (`questions_hash`).
        question_ids: Ids of the questions of the run.
        synthetic: Whether the run used the simulated model or a sample world. All score tables mark such runs.
        settings: Other settings of the run, such as the budget, the sampling and the box convention, as plain JSON.
        created: Time at which the run began, in ISO 8601.
        selection: The `QuestionSelection` as plain JSON, empty if the run has all questions.
        world: Number of statements that read the world model (`reads`), and number of statements that wrote it
            (`writes`). A resumed run adds its statements. If the process of a run is killed, the statements of that
            process are not counted.
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


def questions_hash(store: Store, opaque: Iterable[str] | None = None) -> str:
    """Return one sha256 over the generation id and all question ids of a store.

    Args:
        store: Store with questions.
        opaque: The opaque ids of all questions. If given, the hash is the hash of a public copy of the store.

    Returns:
        The hash in hexadecimal digits.

    Raises:
        StoreError: If the store has no questions, or the file of questions is broken.
    """
    table = store.questions("questions", ["question_id"])
    generation = (table.schema.metadata or {}).get(GENERATION_KEY.encode(), b"").decode()
    ids = sorted(table["question_id"].to_pylist() if opaque is None else opaque)
    return hashlib.sha256("\n".join([generation, *ids]).encode()).hexdigest()


def write_run_manifest(store: Store, manifest: RunManifest) -> None:
    """Write the manifest of a run to `run.json` atomically. Raises StoreError if the file cannot be written."""
    write_json(store.run_path(manifest.run_id) / "run.json", manifest)


def read_run_manifest(store: Store, run_id: str) -> RunManifest:
    """Read the manifest of a run.

    Args:
        store: Store with the run.
        run_id: Id of the run.

    Returns:
        The content of `run.json`.

    Raises:
        StoreError: If the run does not exist, or its `run.json` is broken or belongs to another run.
    """
    path = store.run_path(run_id) / "run.json"
    try:
        manifest = msgspec.json.decode(_cut_deep(path.read_bytes()), type=RunManifest)
    except FileNotFoundError:
        raise StoreError(f"{store.path} has no run {run_id!r}{did_you_mean(run_id, run_ids(store))}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, OSError) as error:
        raise StoreError(f"cannot read {path}: {error}; evaluate again under another run id") from None
    if manifest.run_id != run_id:
        # The folder was copied or renamed. Reports would list its scores under the id of the original run.
        raise StoreError(f"{path} is of run {manifest.run_id!r}: give the folder that name, or take it out of runs/")
    return manifest


def _cut_deep(data: bytes) -> bytes:
    """Return JSON with null in place of values that are nested too deeply for readers, which are recursive."""
    depth, kept = 0, []
    for token in _TOKEN.findall(data):
        depth += token in (b"[", b"{")
        if depth <= _LEVELS:
            kept.append(token)
        elif depth == _LEVELS + 1 and token in (b"[", b"{"):
            kept.append(b"null")
        depth -= token in (b"]", b"}")
    return b"".join(kept)


def run_ids(store: Store) -> list[str]:
    """Return the ids of the store's runs in alphabetical order."""
    return sorted(path.parent.name for path in (store.path / "runs").glob("*/run.json"))
