"""Start or resume a run: the questions that it answers, and the check that a resumed run is still the same.

runs/<run_id>/run.json    the manifest: questions, method, model and settings; written first
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from jrdb_avr.queries.questions import read_questions
from jrdb_avr.queries.runs import RunManifest, questions_hash, read_run_manifest, write_run_manifest
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import AvrWarning, InputError, StoreError
from jrdb_avr.schema.method import Question

_PATIENCE: Final = ("base_url", "timeout_s", "retries")
"""Settings of an endpoint that do not shape replies: a server may have moved, or need more time."""

_MAY_BE_EMPTY: Final = ("server version",)
"""Settings that are empty where the server did not report them: too busy to answer once, it is no other server."""


def check_manifest(store: Store, manifest: RunManifest) -> None:
    """Write a new run's manifest, or compare it with the one that the run has.

    Raises StoreError for a difference in anything that shapes predictions, and names it.
    """
    if not has_manifest(store, manifest.run_id):
        write_run_manifest(store, manifest)
        return
    before, now = (_shaping(own) for own in (read_run_manifest(store, manifest.run_id), manifest))
    for what in sorted(before.keys() | now.keys()):
        pair = before.get(what), now.get(what)
        if pair[0] != pair[1] and not (what in _MAY_BE_EMPTY and "" in pair):
            raise StoreError(
                f"run {manifest.run_id!r} had another {what}: resume it as it was, or give another --run-id"
            )


def add_world_counts(store: Store, run_id: str, counts: Mapping[str, int]) -> None:
    """Add how often this session read and wrote the world model to the counts in the run's manifest."""
    manifest = read_run_manifest(store, run_id)
    total = {kind: manifest.world.get(kind, 0) + number for kind, number in counts.items()}
    write_run_manifest(store, msgspec.structs.replace(manifest, world=total))


def has_manifest(store: Store, run_id: str) -> bool:
    """Whether a run has begun."""
    return (store.run_path(run_id) / "run.json").exists()


def _shaping(manifest: RunManifest) -> dict[str, Any]:
    """What shapes the predictions of a run, by the words of the message about a difference."""
    settings = dict(manifest.settings)
    endpoint: Mapping[str, Any] = settings.pop("endpoint", {})
    return {
        "method": manifest.method,
        "model": manifest.model,
        "settings": settings.pop("method", {}),
        "request settings": {name: value for name, value in endpoint.items() if name not in _PATIENCE},
        **{name.replace("_", " "): value for name, value in settings.items()},
    }


def run_questions(
    store: Store, run_id: str, ids: Iterable[str] | None, limit: int | None, resume: bool, image_root: str | None
) -> list[Question]:
    """The questions of a run: those chosen that have panoramas, or those of the run that is resumed.

    Raises StoreError where the run exists and is not to be resumed, or has other questions than the chosen ones.
    """
    questions = read_questions(store)
    exists, chosen = has_manifest(store, run_id), ids is not None or limit is not None
    if exists and not resume:
        raise StoreError(f"run {run_id!r} exists: add --resume to finish it, or give another --run-id")
    if chosen or not exists:
        picked = _with_panoramas(choose(questions, ids, limit), image_root)
        if not exists:
            return picked
    manifest = read_run_manifest(store, run_id)
    if manifest.questions_sha256 != questions_hash(store):
        raise StoreError(f"run {run_id!r} has other questions than the store has now: give another --run-id")
    if chosen and manifest.question_ids != tuple(question.question_id for question in picked):
        raise StoreError(f"run {run_id!r} has other questions: leave --questions and --limit out to resume it")
    return choose(questions, manifest.question_ids, None)


def choose(questions: Sequence[Question], ids: Iterable[str] | None, limit: int | None) -> list[Question]:
    """The questions with these ids (None: all), at most `limit`. Raises InputError for an unknown id."""
    chosen = {question.question_id: question for question in questions}
    if ids is not None:
        wanted = dict.fromkeys(ids)
        if unknown := [name for name in wanted if name not in chosen]:
            raise InputError(
                f"{len(unknown)} of {len(wanted)} question ids are not in the store, the first is {unknown[0][:40]!r}",
                field="question_id",
            )
        chosen = {name: chosen[name] for name in wanted}
    return list(chosen.values())[:limit]


def _with_panoramas(questions: Sequence[Question], image_root: str | None) -> list[Question]:
    """The questions whose sequence has panoramas; a warning counts the others. Raises StoreError where none is left."""
    sequences = sorted({question.sequence for question in questions})
    without = [name for name in sequences if not _has_images(image_root, name)]
    found = [question for question in questions if question.sequence not in without]
    if without:
        warnings.warn(
            f"{len(questions) - len(found)} of {len(questions)} questions are left out: {len(without)} sequences have "
            f"no panoramas ({', '.join(without[:3])}{', ...' if len(without) > 3 else ''})",
            AvrWarning,
            stacklevel=4,
        )
    if not found:
        raise StoreError("no question is left to ask: choose questions of sequences with panoramas")
    return found


def _has_images(image_root: str | None, sequence: str) -> bool:
    return image_root is not None and any(Path(image_root, sequence).glob("*.jpg"))
