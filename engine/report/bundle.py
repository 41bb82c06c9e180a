"""Bundles. A bundle is a folder with the predictions of a run. Another machine that has the answers can score a bundle.

    DIR/run.json            the run's manifest: questions, method, model and settings
    DIR/predictions.jsonl   the predictions, as `prediction_lines` writes them
    DIR/SHA256SUMS          the hashes of both files, in the format of `sha256sum -c`

Bundles are untrusted. Only these three files are read, as JSON and text, and their sizes are limited. A file that does
not match its hash is refused. The hashes show that a bundle has not changed since it was written. They do not show
who made it.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import pyarrow as pa

from jrdb_avr.engine.report.prediction_lines import LARGEST_FILE, parse_lines, write_lines
from jrdb_avr.engine.report.run_scores import SCORED, Submission, predictions_path
from jrdb_avr.loaders.inputs import read_input
from jrdb_avr.queries.files import new_folder, write_bytes
from jrdb_avr.queries.opaque import stored_ids
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest
from jrdb_avr.queries.store import Store, is_plain_name, read_table
from jrdb_avr.schema.errors import InputError, StoreError

_MANIFEST: Final = "run.json"
_PREDICTIONS: Final = "predictions.jsonl"
_SUMS: Final = "SHA256SUMS"

_LARGEST: Final = {_MANIFEST: 1 << 24, _PREDICTIONS: LARGEST_FILE}
_LONGEST_NAME: Final = 200
_LARGEST_SETTINGS: Final = 1 << 16
_DEEPEST_SETTINGS: Final = 32


@dataclass(frozen=True)
class Bundle:
    """A checked bundle: its folder, the manifest of its run, and the table `predictions` of its run."""

    folder: Path
    run: RunManifest
    predictions: pa.Table

    @property
    def question_set(self) -> str:
        """Id of the set of questions that the run answered, as 16 hex digits.

        Two runs have the same id if they answered the same questions of the same questions file.
        """
        return _sha256("\n".join([self.run.questions_sha256, *sorted(self.run.question_ids)]).encode())[:16]


def write_bundle(store: Store | str | Path, run_id: str, folder: str | Path) -> Bundle:
    """Write a finished run as a bundle. The bundle does not contain the address of the model's server.

    Args:
        store: The store of the run, or its folder.
        run_id: The id of the run.
        folder: The folder of the bundle. It must be missing or empty.

    Returns:
        The bundle, read back from the folder.

    Raises:
        StoreError: If the run is missing or unfinished.
        InputError: If the folder is not empty.
    """
    store, folder = Store.of(store), Path(folder)
    manifest = _without_address(read_run_manifest(store, run_id))
    predictions = read_table(predictions_path(store, run_id))
    written = {
        _MANIFEST: msgspec.json.format(msgspec.json.encode(manifest, order="sorted"), indent=1),
        _PREDICTIONS: b"".join(write_lines(predictions)),
    }
    written[_SUMS] = "".join(f"{_sha256(data)}  {name}\n" for name, data in written.items()).encode()
    with new_folder(folder) as made:
        for name, data in written.items():
            write_bytes(made / name, data)
    return read_bundle(folder)


def read_bundle(folder: str | Path, store: Store | None = None) -> Bundle:
    """Read and check a bundle.

    Args:
        folder: The folder of the bundle.
        store: The store that has the answers. If the run is of a public copy of it, its ids become the store's ids.

    Returns:
        The bundle.

    Raises:
        InputError: If a file is missing, altered, too large, or in another format.
        StoreError: If the store has no questions, or if its key is damaged.
    """
    folder = Path(folder)
    for path in (folder / name for name in (*_LARGEST, _SUMS)):
        # A link could name any file of the reader, and a pipe could never end.
        if path.is_symlink() or path.is_fifo():
            raise InputError(f"{path} is a link or a pipe: copy the bundle with its files (cp -rL)", file=str(path))
    data = {name: read_input(folder / name, largest) for name, largest in _LARGEST.items()}
    sums = read_input(folder / _SUMS, 1 << 12).splitlines()
    for name, content in data.items():
        if f"{_sha256(content)}  {name}".encode() not in sums:
            raise InputError(
                f"{folder / name} does not match its hash in {_SUMS}: ask for the bundle again",
                file=str(folder / name),
            )
    run = _manifest(data[_MANIFEST], folder / _MANIFEST)
    ids: dict[str, str] = {}
    if store is not None and run.questions_sha256 == questions_hash(store, opaque := stored_ids(store)):
        ids, named = opaque, tuple(opaque.get(name, name) for name in run.question_ids)
        run = msgspec.structs.replace(run, questions_sha256=questions_hash(store), question_ids=named)
    return Bundle(folder, run, parse_lines(data[_PREDICTIONS], run.run_id, folder / _PREDICTIONS, ids))


def bundle_submission(store: Store, bundle: Bundle) -> Submission:
    """Return the run of a bundle for `score_run`, if the run belongs to the questions of the store.

    Args:
        store: The store that has the answers.
        bundle: The bundle.

    Returns:
        The run's manifest and predictions.

    Raises:
        StoreError: If the run belongs to another questions file than the file of the store.
    """
    if bundle.run.questions_sha256 != questions_hash(store):
        raise StoreError(f"{bundle.folder} belongs to another questions file: score it in its own store")
    return Submission(bundle.run, bundle.predictions.select(SCORED.names).cast(SCORED))


def _manifest(data: bytes, path: Path) -> RunManifest:
    try:
        run = msgspec.json.decode(data, type=RunManifest)
        if not is_plain_name(run.run_id) or len(run.created) > _LONGEST_NAME:
            raise ValueError("the name of its run is invalid")
        if not run.question_ids:
            raise ValueError("it names no question")
        check_size(run, _DEEPEST_SETTINGS)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} cannot be used: {' '.join(str(error).split())}", file=str(path)) from None
    return run


def check_size(run: RunManifest, levels: int) -> None:
    """Check that the names and settings of a run are small enough for tables and pages.

    Args:
        run: The manifest of the run.
        levels: Maximum nesting depth of the settings.

    Raises:
        ValueError: If the method, the model or the settings are too large, or hold what UTF-8 cannot hold.
        TypeError: If the settings hold what JSON cannot hold.
    """
    _check_depth(run.settings, levels)
    if max(len(run.method), len(run.model)) > _LONGEST_NAME:
        raise ValueError(f"the name of its method or model has more than {_LONGEST_NAME} characters")
    if len(msgspec.json.encode((run.method, run.model, run.settings), order="sorted")) > _LARGEST_SETTINGS:
        raise ValueError(f"its settings have more than {_LARGEST_SETTINGS >> 10} KB")


def _check_depth(value: object, limit: int) -> None:
    """Raise ValueError if settings are nested deeper than `limit`, because pages render them recursively."""
    if not isinstance(value, dict | list | tuple):
        return
    if not limit:
        raise ValueError("its settings are nested too deeply")
    for item in value.values() if isinstance(value, dict) else value:
        _check_depth(item, limit - 1)


def _without_address(manifest: RunManifest) -> RunManifest:
    endpoint = manifest.settings.get("endpoint")
    if not isinstance(endpoint, dict):
        return manifest
    rest = {name: value for name, value in endpoint.items() if name != "base_url"}
    return msgspec.structs.replace(manifest, settings=manifest.settings | {"endpoint": rest})


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
