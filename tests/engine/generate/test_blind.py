"""Blind guessers, recomputed by hand and by trying every constant."""

import random

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.generate.blind import QuestionText, best_guess, blind_check, question_texts
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.answers import Choice, FrameAnswer, Number, Span, encode_answer
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import TEMPLATES, Slots
from jrdb_avr.schema.wording.text import render

POSES = ("walking", "standing", "sitting", "cycling")


def choice(sequence, answer, words=("reading",), times=(0, 60), choices=POSES):
    return QuestionText(
        sequence, "change", "action", "multiple_choice", choices, words, times, Choice(choices.index(answer) + 1)
    )


def start(sequence, t0, frame, words=("walking",)):
    return QuestionText(sequence, "start", "start", "frame", (), words, (t0,), FrameAnswer(frame))


def test_choice_guessers_by_hand():
    rows = [choice("a", "walking"), choice("a", "walking"), choice("b", "walking"), choice("b", "sitting")]
    (row,) = blind_check(rows)
    assert (row["template"], row["n"], row["aim"]) == ("change", 4, 0.35)
    assert row["uniform"] == 0.25 and row["most_frequent"] == 0.75
    assert row["constant"] is None and row["offset"] is None
    # For a's questions b says sitting or walking, as often: the first by name, sitting, is wrong twice.
    # For b's questions a says walking: right once.
    assert row["text_only"] == 0.25
    assert row["within_aim"] is False


def test_choices_that_are_never_true_give_the_true_one_away():
    rows = [
        choice(sequence, answer, (answer,), choices=(answer, "cycling", "skating", "lying down"))
        for sequence in "ab"
        for answer in ("walking", "standing", "sitting")
    ]
    (row,) = blind_check(rows)
    assert row["by_choice"] == 1.0 and row["most_frequent"] == pytest.approx(1 / 3)
    assert "some choices are true oftener" in row["reason"]
    # Of one sequence alone nothing is known from others.
    assert blind_check(rows[:3])[0]["by_choice"] is None


def test_the_text_only_guesser_goes_by_words_then_waits():
    rows = [
        choice("a", "sitting", ("typing",)),
        choice("b", "sitting", ("typing",)),
        choice("a", "walking", ("reading",), (0, 60)),
        choice("b", "walking", ("reading",), (0, 60)),
        choice("a", "standing", ("reading",), (0, 200)),
        choice("b", "standing", ("reading",), (0, 200)),
    ]
    (row,) = blind_check(rows)
    assert row["text_only"] == 1.0 and row["most_frequent"] == pytest.approx(1 / 3)


def test_the_text_only_guesser_answers_only_what_is_offered_and_never_from_its_own_sequence():
    other = ("running", "standing", "sitting", "cycling")
    rows = [choice("a", "running", choices=other), choice("b", "walking"), choice("b", "walking")]
    (row,) = blind_check(rows)
    # a: b only ever says walking, which is not offered: a guess in four. b: a only says running: likewise.
    assert row["text_only"] == pytest.approx(0.25)


def test_frames_by_hand():
    rows = [start("a", 0, 100), start("a", 300, 420), start("b", 600, 735), start("b", 900, 1200)]
    (row,) = blind_check(rows)
    # No two starts lie within two seconds of each other; of the offsets 100, 120, 135 and 300 two at a time do.
    assert row["constant"] == 0.25 and row["offset"] == 0.5
    assert row["uniform"] is None and row["most_frequent"] is None and row["aim"] == 0.25


def test_each_stated_time_is_tried():
    rows = [
        QuestionText("a", "start", "start", "frame", (), (), (0, second), FrameAnswer(second + 50))
        for second in (100, 500, 900)
    ]
    assert blind_check(rows)[0]["offset"] == 1.0


def test_seconds_and_counts_are_judged_apart():
    rows = [
        QuestionText("a", "gap", "seconds_between", "number", (), (), (0,), Number(v)) for v in (5.0, 20.0, 21.0, 40.0)
    ]
    rows += [QuestionText("a", "gap", "count", "number", (), (), (0, 300), Number(v)) for v in (4.0, 5.0, 6.0)]
    counts, seconds = blind_check(rows)
    assert [row["template"] for row in (counts, seconds)] == ["gap", "gap"]
    assert (seconds["asks"], seconds["n"], seconds["constant"], seconds["aim"]) == ("seconds", 4, 0.75, 0.58)
    assert (counts["asks"], counts["n"], counts["constant"], counts["aim"]) == ("count", 3, 1.0, None)
    assert counts["within_aim"] is None and counts["reason"] is None
    assert seconds["reason"].startswith("only 4 questions, one is 25 %; 2 of 4 answers lie in [20, 40) s")


def test_forms_that_the_text_tells_apart_are_judged_apart():
    rows = [
        QuestionText("a", "gap", "seconds_between", "number", (), (), (0,), Number(value), form)
        for form, value in [("gap_absence", 6.0)] * 3 + [("gap_starts", 60.0)] * 2
    ]
    absences, starts = blind_check(rows)
    assert [(row["form"], row["asks"], row["n"]) for row in (absences, starts)] == [
        ("gap_absence", "seconds", 3),
        ("gap_starts", "seconds", 2),
    ]
    # Together one constant would be right for three of five.
    assert absences["constant"] == starts["constant"] == 1.0


def test_what_is_above_its_aim_says_why():
    rows = [start("a", 0, 60 + i % 20) for i in range(40)] + [start("b", 0, 200 + 100 * i) for i in range(40)]
    (row,) = blind_check(rows)
    assert row["within_aim"] is False and row["constant"] == 0.5 and row["text_only"] == 0
    assert row["reason"] == "40 of 80 answers lie in [3, 6) s, and too few others are left to level them"
    apart = [choice(f"s{i}", POSES[i % 4], (POSES[i % 4],)) for i in range(40)]
    (row,) = blind_check(apart)
    assert row["text_only"] == 1.0
    assert row["reason"] == "questions with the same words and waits have the same answers in other sequences"
    assert blind_check([choice(f"s{i}", POSES[i % 4], ()) for i in range(40)])[0]["reason"] is None


FRAMES = st.lists(st.integers(0, 300), min_size=1, max_size=12)


@given(FRAMES)
@settings(deadline=None)
def test_no_constant_frame_is_better(frames):
    rows = [start("a", 0, frame) for frame in frames]
    best = max(sum(abs(c - frame) <= 15 for frame in frames) for c in range(-20, 330))
    assert blind_check(rows)[0]["constant"] == pytest.approx(best / len(frames))


@given(st.lists(st.integers(1, 400), min_size=1, max_size=12))
@settings(deadline=None)
def test_no_constant_number_is_better(tenths):
    values = [tenth / 10 for tenth in tenths]
    rows = [QuestionText("a", "gap", "seconds_between", "number", (), (), (0,), Number(v)) for v in values]
    tried = [value * factor for value in values for factor in (0.5, 1, 2)]
    best = max(sum(0.5 <= c / v <= 2.0 for v in values) for c in tried)
    assert sum(same_answer(best_guess([row.answer for row in rows]), Number(v)) for v in values) == best


@given(st.lists(st.builds(Span, st.integers(-20, 40), st.integers(-20, 40)), min_size=1, max_size=12))
@settings(deadline=None)
def test_no_span_of_the_answers_is_better(spans):
    matches = {guess: sum(same_answer(guess, span) for span in spans) for guess in spans}
    guess = best_guess(spans)
    assert matches[guess] == max(matches.values())
    assert guess == min((span for span in spans if matches[span] == matches[guess]), key=repr)


def test_spans_try_their_own_answers():
    rows = [
        QuestionText("a", "span", "span", "span", (), (), (0,), Span(*pair))
        for pair in ((0, 99), (10, 109), (20, 119), (500, 550))
    ]
    assert blind_check(rows)[0]["constant"] == 0.75


def test_a_balanced_template_is_within_its_aim():
    generator = random.Random(0)
    rows = [choice(f"s{i % 20}", generator.choice(POSES)) for i in range(2000)]
    (row,) = blind_check(rows)
    assert row["within_aim"] and row["text_only"] < 0.3


def test_posed_reads_the_public_text():
    conditions = (Condition(action="reading", at="t0"),)
    plan = TEMPLATES["change"].build(Slots(conditions, {"t0": 15, "t1": 90}))
    questions = pa.Table.from_pylist(
        [
            {
                "question_id": "0" * 16,
                "sequence": "s",
                "family": "unique_anchor",
                "template": "change",
                "question": render("change", plan, "0" * 64),
                "choices": list(POSES),
                "answer_mode": "multiple_choice",
            }
        ],
        schema=QUESTIONS["questions"],
    )
    answers = pa.table({"question_id": ["0" * 16], "answer": [encode_answer(Choice(3))]})
    (question,) = question_texts(questions, answers)
    text = questions["question"][0].as_py()
    assert question == QuestionText(
        "s", "change", "action", "multiple_choice", POSES, ("reading",), (15, 90), Choice(3), "change", text
    )
    assert question.chosen == "sitting"
    assert question.waits == (1,)
    assert blind_check([question])[0]["text_only"] == 0.25


def test_nothing_to_check():
    assert blind_check([]) == []
