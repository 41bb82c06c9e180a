"""The terms of a run: what its manifest says it is, and that a resumed run is still the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from jrdb_avr.queries.runs import RunManifest, read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import StoreError

_PATIENCE: Final = ("base_url", "timeout_s", "retries")
"""Settings of an endpoint that do not shape replies: a server may have moved, or need more time."""

_UNTOLD: Final = ("server version",)
"""What is an empty text where the server did not tell it: one too busy to answer once is not another server."""


def keep_terms(store: Store, manifest: RunManifest) -> None:
    """Write a new run's manifest; of a run that has one, the two must agree in all that shapes a prediction.

    Raises StoreError, naming what differs.
    """
    if not (store.run_path(manifest.run_id) / "run.json").exists():
        write_run_manifest(store, manifest)
        return
    before, now = (_shaping(terms) for terms in (read_run_manifest(store, manifest.run_id), manifest))
    for what in sorted(before.keys() | now.keys()):
        if before.get(what) != now.get(what) and not (what in _UNTOLD and "" in (before.get(what), now.get(what))):
            raise StoreError(
                f"run {manifest.run_id!r} had another {what}: resume it as it was, or give another --run-id"
            )


def _shaping(manifest: RunManifest) -> dict[str, Any]:
    """What of a run shapes its predictions, by the words in which a difference is told."""
    settings = dict(manifest.settings)
    told: dict[str, Any] = {"method": manifest.method, "model": manifest.model, "settings": settings.pop("method", {})}
    endpoint: Mapping[str, Any] = settings.pop("endpoint", {})
    told["way of asking"] = {name: value for name, value in endpoint.items() if name not in _PATIENCE}
    return told | {name.replace("_", " "): value for name, value in settings.items()}
