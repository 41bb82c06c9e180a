"""Learned guessers find what a text gives away, and no more."""

import importlib.util
import random
from dataclasses import replace

import pytest
from environment import needs

from jrdb_avr.engine.generate.blind import QuestionText, blind_check
from jrdb_avr.engine.generate.learned import _learned, learned_guessers
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.errors import InputError
from jrdb_avr.schema.templates import TEMPLATES

needs("sklearn")

POSES = ("walking", "standing", "sitting", "cycling", "lying down", "running")


def choice(sequence, answer, choices, text="Find the person", times=(0, 60)):
    number = Choice(choices.index(answer) + 1)
    return QuestionText("q", sequence, TEMPLATES["change"], choices, (), times, number, text)


def shares(rows):
    """The shares of right answers of the logistic model and of boosting."""
    return [sum(scores) / len(rows) for scores in _learned(rows, ()).values()]


def choices_of(generator):
    return tuple(generator.sample(POSES, 4))


def test_an_answer_that_is_offered_oftener_than_true_is_found_out():
    generator = random.Random(0)
    sets = [choices_of(generator) for _ in range(400)]
    rows = [choice(f"s{i % 20}", min(offered, key=POSES.index), offered) for i, offered in enumerate(sets)]
    assert min(shares(rows)) > 0.9


def test_a_word_or_a_wait_that_goes_with_an_answer_is_found_out():
    generator = random.Random(0)
    offered = POSES[:4]
    answers = [generator.choice(offered) for _ in range(200)]
    words = [choice(f"s{i % 20}", one, offered, f"Find him near {one[:4]}") for i, one in enumerate(answers)]
    waits = [
        choice(f"s{i % 20}", one, offered, times=(0, 60 * 4 ** offered.index(one))) for i, one in enumerate(answers)
    ]
    # A tree needs many examples of a word that goes with one of four answers.
    assert min(shares(words)) > 0.75 and min(shares(waits)) > 0.75 and shares(words)[0] > 0.9


def test_another_store_teaches_what_holds_there_too():
    """In both stores the choice that is said first is right; of one sequence alone nothing can be learned."""
    generator = random.Random(0)
    elsewhere = [choice(f"o{i}", offered[0], offered) for i, offered in enumerate(map(choices_of, [generator] * 300))]
    offered = POSES[:4]
    rows = [choice("s", one, offered) for one in offered * 5]
    (guesser,) = learned_guessers(
        [choice(own.sequence, min(own.choices, key=POSES.index), own.choices) for own in elsewhere]
    )
    (row,) = blind_check(rows, [guesser])
    assert row["logistic"] is None and row["other_store"] == 0.25
    (row,) = blind_check([own for own in rows if own.chosen == offered[0]], [guesser])
    assert row["other_store"] == 1.0 and row["reason"].startswith("constant 100 %, other_store 100 %")
    # Questions of another form teach nothing.
    assert (
        blind_check([replace(own, form=TEMPLATES["later_action"]) for own in rows], [guesser])[0]["other_store"] is None
    )


def test_without_scikit_learn_one_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert learned_guessers() == []
    with pytest.raises(InputError, match=r"pip install 'jrdb-avr\[learned\]'"):
        learned_guessers([choice("s", "walking", POSES[:4])])
