"""Guessers that count, on tables made by hand."""

from fractions import Fraction

import pytest

from jrdb_avr.engine.generate.blind import QuestionText, offers_of
from jrdb_avr.engine.generate.guessers import LabelCounts, Offer, above_bound, guesser_shares
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.templates import TEMPLATES


def test_ranks_count_people_and_break_ties_by_all_data_then_by_label():
    counts = LabelCounts(
        {
            ("s", 0): {"walking": 2, "sitting": 1},
            ("s", 15): {"sitting": 1},
            ("r", 0): {"standing": 5, "sitting": 1},
        }
    )
    # All data: standing 5, sitting 3, walking 2. Sequence s: walking 2 and sitting 2, standing 0.
    assert counts.ranks("s", 0, "walking", ("sitting", "standing", "typing")) == (2, 1, 0)
    assert counts.ranks("s", 15, "standing", ("sitting", "typing", "bending")) == (0, 1, 1)
    assert counts.present == {"s": {"walking", "sitting"}, "r": {"standing", "sitting"}}
    assert counts.doing("s", 15) == {"sitting"}
    assert counts.doing("s", 30) == frozenset()


def test_guessers_learn_from_other_sequences_only():
    # In s, a is always true; elsewhere b is. Each guesser that looks elsewhere takes the wrong one.
    offers = [Offer("s", "a", ("b", "c", "d"), (0, 1, 2))] * 3 + [Offer("r", "b", ("a", "c", "d"), (1, 0, 0))] * 3
    shares = guesser_shares(offers)
    assert shares["data"] == Fraction(1, 2)
    assert shares["sequence"] == Fraction(1, 2)
    assert shares["frame"] == Fraction(1, 2)
    assert shares["label"] == shares["set"] == shares["pair"] == 0
    # The choices never true elsewhere are three: a, c and d for a question of s.
    assert shares["least label"] == Fraction(1, 3)


def test_a_choice_true_by_itself_is_found_and_ties_are_shared():
    offers = [Offer(sequence, "a", ("b", "c", "d")) for sequence in "rst"]
    shares = guesser_shares(offers)
    assert shares["label"] == shares["pair"] == 1
    assert "data" not in shares
    assert guesser_shares([Offer("r", "a", ("b", "c", "d"))])["label"] == Fraction(1, 4)


def test_sets_and_pairs_tell_more_than_labels():
    # Label a is true in half of its offers, yet always beside x and never beside y.
    offers = [Offer(s, "a", ("x", "c", "d")) for s in "rst"] + [Offer(s, "e", ("a", "y", "f")) for s in "rst"]
    shares = guesser_shares(offers)
    assert shares["set"] == shares["pair"] == 1


def test_the_bound_judges_templates_of_sixty_questions():
    offers = [Offer(str(n % 3), "a", ("b", "c", "d")) for n in range(60)]
    assert above_bound(offers[:59]) is None
    assert above_bound(offers) == "set 100.0 %"
    assert guesser_shares([]) == {}


@pytest.mark.parametrize(("often", "fault"), [(31, None), (32, "the answer 'a' is true in 32.0 %")])
def test_a_fixed_answer_is_true_in_at_most_31_percent(often, fault):
    rest = zip((23, 23, 100 - 46 - often), "bcd", strict=True)
    truths = ["a"] * often + [label for number, label in rest for _ in range(number)]
    offers = [Offer(str(n), truth, tuple({*"abcd"} - {truth})) for n, truth in enumerate(truths)]
    assert above_bound(offers) == fault


def test_a_published_question_is_the_offer_of_its_selection():
    counts = LabelCounts({("s", 60): {"walking": 1, "bending": 2}})
    texts = ("walking", "riding a scooter", "bending down", "eating something")
    question = QuestionText("q", "s", TEMPLATES["change"], texts, (), (0, 60), Choice(3))
    (offer,) = offers_of([question], counts)
    assert offer == Offer("s", "bending", ("eating sth", "scootering", "walking"), (0, 0, 0))
    fixed = ("both times", "only at the first time", "only at the second time", "neither time")
    question = QuestionText("q", "s", TEMPLATES["presence"], fixed, (), (0, 60, 120), Choice(1))
    assert offers_of([question], counts)[0].ranks == ()
