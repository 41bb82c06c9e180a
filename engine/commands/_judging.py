"""What `score` and `report` share: the runs asked for, scored."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from jrdb_avr.engine.output import note
from jrdb_avr.engine.scoring import read_truth, score_run
from jrdb_avr.queries.runs import RunManifest, run_ids
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, StoreError


def scored_runs(store: Store, names: tuple[str, ...], iou: float) -> Iterator[tuple[RunManifest, Any, Any]]:
    """Manifest, predictions and scores of each named run, or of all runs of the store.

    A named run that cannot be scored raises StoreError; of all runs, such a one is left out with a note.
    """
    truth = read_truth(store)
    known = run_ids(store)
    if not known:
        raise StoreError(f"{store.path} has no runs yet: run 'jrdb-avr evaluate --store {store.path} ...'")
    done = 0
    for name in names or known:
        try:
            result = score_run(store, truth, name, iou)
        except (StoreError, InputError) as error:
            if names:
                raise
            note(f"left out: {error}")
            continue
        done += 1
        yield result
    if not done:
        raise StoreError(f"no run of {store.path} can be scored: evaluate on the store's present questions")
