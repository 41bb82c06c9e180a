"""Score a guesser that learns from the text of questions, by models of scikit-learn.

It reads all that the public text states: every word, the choices beside each other, the stated times and the waits
between them. The questions of a sequence are guessed by what was learned on other sequences, in at most ten folds. For
choices a linear model ranks those that are offered; for times and numbers it takes those of the most similar text.
scikit-learn is optional, and imported only here.
"""

from __future__ import annotations

import importlib.util
import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.generate.bins import wait_bin
from jrdb_avr.engine.generate.blind import Guesser, QuestionText
from jrdb_avr.schema.answer_modes import MODES, same_answer
from jrdb_avr.schema.answers import Answer
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import FPS

FOLDS: Final = 10
"""Sequences are dealt out among so many folds at most."""

_LEAST_S: Final = 1 / FPS
"""No learned length is shorter than a frame."""

_SCALE_S: Final = 30.0
"""Stated seconds are divided by this, so that they weigh about as much as a word."""


def learned_guesser() -> Guesser:
    """The guesser, for `blind_check`. Raises InputError where scikit-learn is missing."""
    if importlib.util.find_spec("sklearn") is None:
        raise InputError("the learned guesser needs scikit-learn: pip install 'jrdb-avr[learned]'", field="blind")
    return learned_share


def learned_share(group: Sequence[QuestionText]) -> float | None:
    """The share of right answers in a group of questions alike in kind; None where all are of one sequence."""
    sequences = [question.sequence for question in group]
    if len(set(sequences)) < 2:
        return None
    return _ranked(group, sequences) if group[0].choices else _predicted(group, sequences)


def _ranked(group: Sequence[QuestionText], sequences: Sequence[str]) -> float:
    """For each question the choice that is most likely the true one, by the text and the other choices."""
    from sklearn.linear_model import LogisticRegression

    offered = [(question, choice) for question in group for choice in question.choices]
    true = [choice == question.chosen for question, choice in offered]
    features = _matrix([_of_choice(*pair) for pair in offered])
    worth = np.zeros(len(offered))
    for learn, guess in _folds([question.sequence for question, _ in offered]):
        model = LogisticRegression(max_iter=5000).fit(features[learn], np.array(true)[learn])
        worth[guess] = model.decision_function(features[guess])
    right, first = 0, 0
    for question in group:
        last = first + len(question.choices)
        right += true[first + int(worth[first:last].argmax())]
        first = last
    return right / len(group)


def _predicted(group: Sequence[QuestionText], sequences: Sequence[str]) -> float:
    """The share of right answers where each question is answered like the one whose text is most similar.

    A mean of answers would often be an answer that no question has.
    """
    from sklearn.neighbors import KNeighborsRegressor

    features, values = _matrix([dict(_of_text(question)) for question in group]), np.array(list(map(_values, group)))
    right = 0
    for learn, guess in _folds(sequences):
        found = KNeighborsRegressor(1).fit(features[learn], values[learn]).predict(features[guess])
        for row, numbers in zip(guess.tolist(), found.reshape(len(guess), -1).tolist(), strict=True):
            right += same_answer(_answer(group[row], numbers), group[row].answer)
    return right / len(group)


# -- features -------------------------------------------------------------------------------------------------------


def _of_text(question: QuestionText) -> Iterator[tuple[str, float]]:
    """What the text states, the choices left out."""
    yield from ((f"word {word}", 1.0) for word in sorted(set(re.findall("[a-z]+", question.text.lower()))))
    for number, time in enumerate(question.times):
        yield f"time {number}", time / FPS / _SCALE_S
    for number, (one, other) in enumerate(pairwise(question.times)):
        yield f"wait {number}", (other - one) / FPS / _SCALE_S
        yield f"wait {number} bin {wait_bin(other - one)}", 1.0


def _of_choice(question: QuestionText, choice: str) -> dict[str, float]:
    """What speaks for a choice: itself, each of the others, all of them together, and it with all that is stated."""
    others = sorted(text for text in question.choices if text != choice)
    beside = [choice, *(f"{choice} beside {other}" for other in others), f"{choice} of {others}"]
    return dict.fromkeys(beside, 1.0) | {f"{choice}, {name}": value for name, value in _of_text(question)}


def _matrix(features: Sequence[dict[str, float]]) -> Any:
    from sklearn.feature_extraction import DictVectorizer

    return DictVectorizer().fit_transform(features)


def _folds(sequences: Sequence[str]) -> Any:
    """(rows to learn from, rows to guess) of each fold; no sequence is in both."""
    from sklearn.model_selection import GroupKFold

    return GroupKFold(min(FOLDS, len(set(sequences)))).split(sequences, groups=sequences)


# -- times and numbers ------------------------------------------------------------------------------------------------


def _values(question: QuestionText) -> list[float]:
    """An answer as the numbers that are learned."""
    before, values = question.times[0], []
    for name, kind in MODES[question.mode].fields:
        value = getattr(question.answer, name)
        if kind == "frame":
            values.append(_log(value - before))
            before = value
        elif kind == "angle":
            values += [math.cos(math.radians(value)), math.sin(math.radians(value))]
        else:
            assert kind == "decimal", "choices are ranked"
            values.append(math.log(max(value, _LEAST_S)))
    return values


def _log(frames: int) -> float:
    return math.log(max(frames / FPS, _LEAST_S))


def _answer(question: QuestionText, values: Sequence[float]) -> Answer:
    """The answer that such numbers mean for a question."""
    rest, before = iter(values), question.times[0]
    fields: list[float] = []
    for _, kind in MODES[question.mode].fields:
        value = next(rest)
        if kind == "frame":
            before += round(FPS * math.exp(value))
            fields.append(before)
        else:
            fields.append(math.degrees(math.atan2(next(rest), value)) % 360 if kind == "angle" else math.exp(value))
    return MODES[question.mode].build(*fields)
