"""Reviews of questions: import decisions from the page, store them by reviewer, and compare reviewers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import pyarrow as pa

from jrdb_avr.engine.report.prediction_lines import read_regular
from jrdb_avr.queries.runs import questions_hash
from jrdb_avr.queries.sql import query_tables
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.tables import CANARY, QUESTIONS

_MOST_BYTES = 64 << 20


class Decision(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A decision about a question; a rejection has a reason."""

    question_id: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{16}$")]
    decision: Literal["accept", "reject"]
    reason: Annotated[str, msgspec.Meta(max_length=2000)] = ""


class Decisions(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file that the page downloads: decisions, and the hash of the questions file that they are about."""

    questions_sha256: str
    decisions: list[Decision]


def read_decisions(path: Path, store: Store) -> Decisions:
    """Read a file of decisions. Raises InputError naming the file where it cannot be used with this store."""
    data = read_regular(path, _MOST_BYTES)
    try:
        found = msgspec.json.decode(data, type=Decisions)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(
            f"{path} is no file of decisions ({error}): download it from the page", file=str(path)
        ) from None
    if found.questions_sha256 != questions_hash(store):
        raise InputError(f"{path} is about another questions file than this store's: inspect again", file=str(path))
    known = set(store.questions("questions")["question_id"].to_pylist())
    for name, times in Counter(decision.question_id for decision in found.decisions).items():
        if name not in known:
            raise InputError(f"{path}: no question {name} in the store", file=str(path))
        if times > 1:
            raise InputError(f"{path} decides question {name} {times} times: keep one of them", file=str(path))
    return found


def import_decisions(store: Store, reviewer: str, decisions: Sequence[Decision]) -> pa.Table:
    """Store a reviewer's decisions; a new decision on a question replaces the old one. Returns all reviews."""
    with store.writing("inspect --import"):
        stored = {(row["question_id"], row["reviewer"]): row for row in read_reviews(store)}
        for decision in decisions:
            row = {"question_id": decision.question_id, "reviewer": reviewer}
            stored[decision.question_id, reviewer] = row | {"decision": decision.decision, "reason": decision.reason}
        table = pa.Table.from_pylist([stored[key] for key in sorted(stored)], QUESTIONS["reviews"])
        store.write_questions("reviews", table, {"canary": CANARY})
    return table


def read_reviews(store: Store) -> list[dict[str, str]]:
    """All reviews; none where nothing has been imported."""
    if not store.question_path("reviews").exists():
        return []
    rows: list[dict[str, str]] = store.questions("reviews").to_pylist()
    return rows


def rejected(store: Store) -> frozenset[str]:
    """Questions that somebody rejected."""
    return frozenset(row["question_id"] for row in read_reviews(store) if row["decision"] == "reject")


def agreements(store: Store) -> list[dict[str, Any]]:
    """Every two reviewers who decided the same questions: n, on how many they agree, and Cohen's kappa, which is None
    where both always decide the same."""
    rows: list[dict[str, Any]] = query_tables(store.path, read_statement("stats/agreements.sql")).to_pylist()
    return rows
