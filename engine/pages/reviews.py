"""Reviews of questions: decisions from the page of `inspect`, stored by reviewer and compared between reviewers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec
import pyarrow as pa

from jrdb_avr.loaders.inputs import read_input, to_utf8
from jrdb_avr.queries.runs import questions_hash
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import CANARY, QUESTIONS

_MAX_BYTES: Final = 64 << 20
"""Maximum size of a file of decisions, in bytes."""


class Decision(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A decision about a question. A rejection may have a reason."""

    question_id: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{16}$")]
    decision: Literal["accept", "reject"]
    reason: Annotated[str, msgspec.Meta(max_length=2000)] = ""


class Decisions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Content of the file that the page saves: decisions, and the hash of the questions file that was reviewed."""

    questions_sha256: str
    decisions: list[Decision]


def read_decisions(path: Path, store: Store) -> Decisions:
    """Read a file of decisions.

    Args:
        path: File that the page saved.
        store: Store with the reviewed questions.

    Returns:
        The decisions.

    Raises:
        InputError: If the file cannot be read, or is about other questions.
    """
    data = to_utf8(read_input(path, _MAX_BYTES), path)
    try:
        content = msgspec.json.decode(data, type=Decisions)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(
            f"{path} is not a file of decisions ({error}): save it on the page again", file=str(path)
        ) from None
    if content.questions_sha256 != questions_hash(store):
        raise InputError(f"{path} is about another questions file than this store's: inspect again", file=str(path))
    ids = set(store.questions("questions")["question_id"].to_pylist())
    for name, times in Counter(decision.question_id for decision in content.decisions).items():
        if name not in ids:
            raise InputError(f"{path}: the store has no question {name}", file=str(path))
        if times > 1:
            raise InputError(f"{path} decides question {name} {times} times: keep one decision", file=str(path))
    return content


def import_decisions(store: Store, reviewer: str, decisions: Sequence[Decision]) -> pa.Table:
    """Store the decisions of a reviewer. A new decision on a question replaces the reviewer's earlier decision.

    Args:
        store: Store with the questions.
        reviewer: Name of the reviewer.
        decisions: New decisions.

    Returns:
        All reviews of the store.

    Raises:
        LockedError: If another command writes the store.
    """
    with store.writing("inspect --import"):
        stored = {(row["question_id"], row["reviewer"]): row for row in read_reviews(store)}
        for decision in decisions:
            row = {"question_id": decision.question_id, "reviewer": reviewer}
            stored[decision.question_id, reviewer] = row | {"decision": decision.decision, "reason": decision.reason}
        table = pa.Table.from_pylist([stored[key] for key in sorted(stored)], QUESTIONS["reviews"])
        store.write_questions("reviews", table, {"canary": CANARY})
    return table


def read_reviews(store: Store) -> list[dict[str, str]]:
    """Return all reviews of a store. The list is empty if no decisions were imported."""
    if not store.question_path("reviews").exists():
        return []
    rows: list[dict[str, str]] = store.questions("reviews").to_pylist()
    return rows


def rejected(store: Store) -> frozenset[str]:
    """Return the ids of the questions that at least one reviewer rejected."""
    return frozenset(row["question_id"] for row in read_reviews(store) if row["decision"] == "reject")
