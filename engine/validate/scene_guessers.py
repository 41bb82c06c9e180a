"""Blind guessers that know all boxes and actions of the store, but not which person a question is about."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from jrdb_avr.engine.generate.blind import Chances, Guesser, QuestionText, blind_check, counting_guesser, question_texts
from jrdb_avr.engine.generate.guessers import LabelCounts
from jrdb_avr.engine.generate.learned import learned_guessers
from jrdb_avr.engine.report.scoring import DEFAULT_IOU, box_ious, find_target_boxes
from jrdb_avr.engine.report.truth import read_truth
from jrdb_avr.queries.sql import query_tables
from jrdb_avr.queries.statements import read_statement
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.answers import TIE
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.labels import ACTION_PHRASES, PRESENCE_ANSWERS, answer_of_choice

_BITS: Final = {action: 1 << index for index, action in enumerate(ACTION_PHRASES)}


def check_store(store: Store, texts: Sequence[QuestionText], teacher: Store | None = None) -> list[dict[str, Any]]:
    """Score all blind guessers on the questions of a store.

    Args:
        store: The store.
        texts: The texts of its questions.
        teacher: Another store. A guesser learns from its questions about sequences that `store` lacks.

    Returns:
        The rows of `blind_check`.

    Raises:
        StoreError: If a store lacks questions, or if `store` lacks intervals.
        InputError: If no sequence of `teacher` is new, or if scikit-learn is missing to learn from it.
    """
    sequences = {text.sequence for text in texts}
    lessons = [] if teacher is None else question_texts(*teacher.question_tables("questions", "answers"))
    new = [text for text in lessons if text.sequence not in sequences]
    if lessons and not new:
        raise InputError("the other store has no sequence that this one lacks", field="blind_from")
    return blind_check(texts, [*scene_guessers(store), *learned_guessers(new), box_guesser(store)])


def scene_guessers(store: Store) -> list[Guesser]:
    """Return the guessers of choices that know the store's people.

    Args:
        store: A store with intervals.

    Returns:
        The counting guessers, and a guesser that was not used in the selection: "people" takes the likeliest answer,
        given the description and the waits, by all people of other sequences. If none of them has an offered answer,
        the description is left out.
    """
    people = _People(query_tables(store.path, read_statement("stats/people.sql")))
    return [counting_guesser(LabelCounts(people.counts)), people.guess]


class _People:
    """All boxes of people, sorted by person and frame. Each column is an array with one entry per box."""

    def __init__(self, boxes: pa.Table) -> None:
        self._key, self._seen, self._left = (boxes[name].to_numpy() for name in ("key", "seen", "frames_left"))
        self._names, self._sequence = np.unique(boxes["sequence"].to_numpy(), return_inverse=True)
        self.counts: dict[tuple[str, int], Counter[str]] = defaultdict(Counter)
        for row in boxes.to_pylist():
            self.counts[row["sequence"], row["frame"]].update(row["actions"])
        actions = boxes["actions"].to_pylist()
        self._doing = np.array([sum(_BITS.get(action, 0) for action in of_box) for of_box in actions], np.int64)

    def guess(self, group: Sequence[QuestionText]) -> Mapping[str, Chances]:
        """Return the scores of the guesser for choices that are actions, or that say when a person is present."""
        if group[0].form.spec.read not in ("action", "presence") or not group[0].choices:
            return {}
        scores = []
        for question in group:
            answers = {text: answer_of_choice(text) for text in question.choices}
            people = self._people(question, question.described)
            if not any(people[answer] for answer in answers.values()):
                people = self._people(question, ())
            most = max(people[answer] for answer in answers.values())
            best = [text for text, answer in answers.items() if people[answer] == most]
            scores.append((question.chosen in best) / len(best))
        return {"people": scores}

    def _people(self, question: QuestionText, described: Sequence[str]) -> Mapping[str, int]:
        """Return the number of people of other sequences with each answer, among those who fit a description."""
        bits = sum(_BITS[action] for action in described)
        waits = [time - question.times[0] for time in question.times[1:]] or [0]
        elsewhere = self._sequence != np.searchsorted(self._names, question.sequence)
        keys = self._key[self._seen & (self._doing & bits == bits) & (self._left > waits[-1]) & elsewhere]
        rows = [np.searchsorted(self._key, keys + wait).clip(max=len(self._key) - 1) for wait in waits]
        present = [self._key[row] == keys + wait for row, wait in zip(rows, waits, strict=True)]
        if question.form.spec.read == "presence":
            answers = np.bincount(3 - 2 * present[0] - present[1], minlength=4)
            return dict(zip(PRESENCE_ANSWERS, answers.tolist(), strict=True))
        doing = self._doing[rows[-1][present[-1]]]
        return {action: int(np.count_nonzero(doing & bit)) for action, bit in _BITS.items()}


def box_guesser(store: Store) -> Guesser:
    """Return the guessers of evidence boxes.

    Args:
        store: A store with questions and intervals.

    Returns:
        The guesser "largest" takes the largest person in clear view in the middle of the sequence. The guesser
        "best_box" takes one box for all questions of a form, at the time of the description: the box that is right most
        often.
    """
    truth = read_truth(store)
    rows_by_id = {question_id: row for row, question_id in enumerate(truth.ids.to_pylist())}
    largest = {
        row["sequence"]: row for row in query_tables(store.path, read_statement("stats/largest.sql")).to_pylist()
    }

    def guess(group: Sequence[QuestionText]) -> Mapping[str, Chances]:
        rows = np.array([rows_by_id[question.question_id] for question in group])
        described = np.array([question.times[0] for question in group])
        present, boxes = find_target_boxes(truth, rows, described)
        right = [present & (box_ious(np.broadcast_to(box, boxes.shape), boxes) >= DEFAULT_IOU - TIE) for box in boxes]
        middle = [largest[question.sequence] for question in group]
        visible, targets = find_target_boxes(truth, rows, np.array([row["frame"] for row in middle]))
        guessed = np.array([[row[side] for side in "xywh"] for row in middle])
        near = visible & (box_ious(guessed, targets) >= DEFAULT_IOU - TIE)
        return {"largest": near.tolist(), "best_box": max(right, key=np.count_nonzero).tolist()}

    return guess
