"""The learned guesser finds what a text gives away, and no more."""

import importlib.util
import random

import pytest
from click.testing import CliRunner
from environment import needs

from jrdb_avr.engine.generate.blind import QuestionText, blind_check
from jrdb_avr.engine.generate.learned import learned_guesser, learned_share
from jrdb_avr.schema.answers import Choice, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.errors import InputError

needs("sklearn")

POSES = ("walking", "standing", "sitting", "cycling", "lying down", "running")


def choice(sequence, answer, choices, text="Find the person", times=(0, 60)):
    number = Choice(choices.index(answer) + 1)
    return QuestionText(sequence, "change", "action", "multiple_choice", choices, (), times, number, "change", text)


def choices_of(generator):
    return tuple(generator.sample(POSES, 4))


@pytest.mark.slow
def test_choices_that_say_nothing_are_guessed_at_chance():
    generator = random.Random(0)
    sets = [choices_of(generator) for _ in range(800)]
    rows = [choice(f"s{i % 20}", generator.choice(offered), offered) for i, offered in enumerate(sets)]
    assert learned_share(rows) == pytest.approx(0.25, abs=0.05)
    assert learned_share(rows) == learned_share(rows)


def test_an_answer_that_is_offered_oftener_than_true_is_found_out():
    generator = random.Random(0)
    sets = [choices_of(generator) for _ in range(400)]
    rows = [choice(f"s{i % 20}", min(offered, key=POSES.index), offered) for i, offered in enumerate(sets)]
    assert learned_share(rows) > 0.9


def test_a_word_or_a_wait_that_goes_with_an_answer_is_found_out():
    generator = random.Random(0)
    offered = POSES[:4]
    answers = [generator.choice(offered) for _ in range(200)]
    words = [choice(f"s{i % 20}", one, offered, f"Find him near {one[:4]}") for i, one in enumerate(answers)]
    waits = [
        choice(f"s{i % 20}", one, offered, times=(0, 60 * 4 ** offered.index(one))) for i, one in enumerate(answers)
    ]
    assert learned_share(words) > 0.9 and learned_share(waits) > 0.9


def test_what_holds_in_one_sequence_alone_is_not_learned():
    offered = POSES[:4]
    rows = [choice(f"s{i % 4}", offered[i % 4], offered, f"Find word{'abcd'[i % 4]}") for i in range(200)]
    assert learned_share(rows) == 0
    assert learned_share([row for row in rows if row.sequence == "s0"]) is None


@pytest.mark.parametrize("mode", ["frame", "span", "frame_viewpoint", "number"])
def test_times_and_numbers_are_predicted_from_words(mode):
    answers = {
        "frame": lambda t, s: FrameAnswer(t + 15 * s),
        "span": lambda t, s: Span(t + 15 * s, t + 30 * s),
        "frame_viewpoint": lambda t, s: FrameViewpoint(t + 15 * s, 350.0 if s > 10 else 20.0),
        "number": lambda t, s: Number(float(s)),
    }
    rows = [
        QuestionText(f"s{i % 10}", "x", "x", mode, (), (), (15 * i,), answers[mode](15 * i, s), "x", f"wait {word}")
        for i in range(300)
        for word, s in (("long", 30), ("short", 4))
    ]
    assert learned_share(rows) > 0.9


def test_its_share_stands_in_the_check_with_a_reason():
    offered = POSES[:4]
    rows = [choice(f"s{i % 20}", offered[i % 4], offered, f"Find {'abcd'[i % 4]}") for i in range(80)]
    (row,) = blind_check(rows, learned_guesser())
    assert row["learned"] == 1.0 and row["text_only"] <= 0.35 and row["within_aim"] is False
    assert row["reason"] == "words, choices and waits go with the same answers in other sequences"
    assert blind_check(rows)[0]["learned"] is None


def test_without_scikit_learn_one_line_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'jrdb-avr\[learned\]'"):
        learned_guesser()
    from jrdb_avr.engine.commands.generate import generate

    result = CliRunner().invoke(generate, ["--store", str(tmp_path), "--blind", "learned"])
    assert isinstance(result.exception, InputError)
