"""Blind guessers of choices that learn from the text of questions, by models of scikit-learn.

They read all that the public text states: every word, the choices beside each other, the stated times and the waits
between them. For each choice they learn how likely it is the true one. The questions of a sequence are guessed by what
was learned on other sequences, in at most `FOLDS` folds, or on another store. scikit-learn is optional, and imported
only here.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np

from jrdb_avr.engine.generate.asked import doublings
from jrdb_avr.engine.generate.blind import Chances, Guesser, QuestionText
from jrdb_avr.schema.arrays import Ints
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.rules import FPS

FOLDS: Final = 5
"""Maximum number of folds among which the sequences are dealt out."""

_SCALE_S: Final = 30.0
"""Stated seconds are divided by this number, so that they weigh about as much as a word."""


def learned_guessers(lessons: Sequence[QuestionText] = ()) -> list[Guesser]:
    """Return the guessers that learn.

    Args:
        lessons: Questions of another store, about other sequences. The guesser "other_store" learns from them.

    Returns:
        A guesser with the scores "logistic", "boosting" and "other_store". The list is empty without scikit-learn.

    Raises:
        InputError: If there are questions of another store, but scikit-learn is missing.
    """
    if importlib.util.find_spec("sklearn") is not None:
        return [lambda group: _learned(group, [q for q in lessons if q.form == group[0].form])]
    if lessons:
        raise InputError("learning needs scikit-learn: pip install 'jrdb-avr[learned]'", field="blind_from")
    return []


def _learned(group: Sequence[QuestionText], lessons: Sequence[QuestionText]) -> Mapping[str, Chances]:
    from sklearn.model_selection import GroupKFold

    scores: dict[str, Chances] = {}
    if not group[0].choices:
        return scores
    sequences = [question.sequence for question in group]
    if (count := len(set(sequences))) > 1:
        folds = list(GroupKFold(min(FOLDS, count)).split(sequences, groups=sequences))
        scores |= {name: _scores(name, group, folds) for name in ("logistic", "boosting")}
    if lessons:
        questions = [*lessons, *group]
        learn, guess = np.split(np.arange(len(questions)), [len(lessons)])
        scores["other_store"] = _scores("logistic", questions, [(learn, guess)])[len(lessons) :]
    return scores


def _scores(name: str, questions: Sequence[QuestionText], folds: Sequence[tuple[Ints, Ints]]) -> list[float]:
    """Return 1 for each question if its likeliest choice is right, else 0. A fold has rows to learn and to guess."""
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.feature_extraction import DictVectorizer
    from sklearn.linear_model import LogisticRegression
    from threadpoolctl import threadpool_limits

    linear = name == "logistic"
    offered = [(question, choice) for question in questions for choice in question.choices]
    rows = np.repeat(np.arange(len(questions)), [len(question.choices) for question in questions])
    true = np.array([choice == question.chosen for question, choice in offered])
    features = DictVectorizer(sparse=linear).fit_transform([_features(*pair, crossed=linear) for pair in offered])
    likelihood = np.zeros(len(offered))
    model: Any = LogisticRegression(max_iter=5000)
    if not linear:
        model = HistGradientBoostingClassifier(
            learning_rate=0.06, max_iter=120, max_leaf_nodes=8, min_samples_leaf=10, random_state=0
        )
    # Because the threads of OpenMP wait busily for each other, which takes minutes on a machine that has other work.
    with threadpool_limits(1):
        for learn, guess in folds:
            learned, guessed = np.isin(rows, learn), np.isin(rows, guess)
            likelihood[guessed] = model.fit(features[learned], true[learned]).predict_proba(features[guessed])[:, 1]
    parts = (likelihood[rows == row].argmax() for row in range(len(questions)))
    return [float(true[rows == row][best]) for row, best in enumerate(parts)]


def _features(question: QuestionText, choice: str, crossed: bool) -> dict[str, float]:
    """Return what speaks for a choice: the choice, each of the others, and all that is stated.

    A linear model cannot combine features, so it gets the choice `crossed` with each feature, and with all the others.
    """
    beside = sorted(text for text in question.choices if text != choice)
    features = {choice: 1.0} | {f"beside {text}": 1.0 for text in beside} | dict(_of_text(question))
    if not crossed:
        return features
    return {choice: 1.0, f"{choice} of {beside}": 1.0} | {
        f"{choice}, {name}": value for name, value in features.items()
    }


def _of_text(question: QuestionText) -> Iterator[tuple[str, float]]:
    """Yield what the text states, without the choices."""
    yield from ((f"word {word}", 1.0) for word in sorted(set(re.findall("[a-z]+", question.text.lower()))))
    for index, time in enumerate(question.times):
        yield f"time {index}", time / FPS / _SCALE_S
    for index, (first, second) in enumerate(pairwise(question.times)):
        yield f"wait {index}", (second - first) / FPS / _SCALE_S
        yield f"wait {index} bin {doublings(second - first)}", 1.0
