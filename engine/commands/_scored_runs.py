"""What `score` and `report` share: the runs asked for, scored."""

from __future__ import annotations

from jrdb_avr.engine.console import note
from jrdb_avr.engine.report.scored_runs import Facts, Judged, judge, read_facts
from jrdb_avr.engine.report.scoring import Truth, read_truth, score_run
from jrdb_avr.queries.runs import run_ids
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError, StoreError


def judged_runs(store: Store, names: tuple[str, ...], iou: float) -> tuple[Truth, Facts, list[tuple[Judged, object]]]:
    """Each named run, or all runs of the store, with its scores table, by method, model and id.

    A named run that cannot be scored raises StoreError; of all runs, such a one is left out with a note.
    """
    truth, facts = read_truth(store), read_facts(store)
    known = run_ids(store)
    if not known:
        raise StoreError(f"{store.path} has no runs yet: run 'jrdb-avr evaluate --store {store.path} ...'")
    done = []
    for name in names or known:
        try:
            # Scoring takes milliseconds, so scores of an earlier threshold or question file are never trusted.
            manifest, predictions, scores = score_run(store, truth, name, iou)
        except (StoreError, InputError) as error:
            if names:
                raise
            note(f"left out: {error}")
            continue
        done.append((judge(facts, manifest, predictions, scores), scores))
    if not done:
        raise StoreError(f"no run of {store.path} can be scored: evaluate on the store's present questions")
    done.sort(key=lambda pair: (pair[0].manifest.method, pair[0].manifest.model, pair[0].manifest.run_id))
    return truth, facts, done
