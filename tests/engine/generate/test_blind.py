"""The blind check, recomputed by hand and by trying every constant."""

from dataclasses import replace

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.generate.blind import QuestionText, best_guess, blind_check, counting_guesser, question_texts
from jrdb_avr.engine.generate.guessers import LabelCounts
from jrdb_avr.schema.answer_modes import same_answer
from jrdb_avr.schema.answers import Choice, FrameAnswer, Number, Span, encode_answer
from jrdb_avr.schema.plan import Condition
from jrdb_avr.schema.tables import QUESTIONS
from jrdb_avr.schema.templates import TEMPLATES, Slots
from jrdb_avr.schema.wording.text import render

POSES = ("walking", "standing", "sitting", "cycling")


def choice(sequence, answer, described=("reading",), times=(0, 60), choices=POSES):
    number = Choice(choices.index(answer) + 1)
    return QuestionText("q", sequence, TEMPLATES["change"], choices, described, times, number)


def start(sequence, t0, frame):
    return QuestionText("q", sequence, TEMPLATES["start"], (), ("walking",), (t0,), FrameAnswer(frame))


def seconds(value, form="gap_absence"):
    return QuestionText("q", "a", TEMPLATES[form], (), (), (0,), Number(value))


def check(rows, *guessers):
    """The blind check with the counting guessers that know no counts of labels."""
    return blind_check(rows, [counting_guesser(), *guessers])


def test_choice_guessers_by_hand():
    rows = [choice("a", "walking"), choice("a", "walking"), choice("b", "walking"), choice("b", "sitting")]
    (row,) = check(rows)
    assert (row["template"], row["n"], row["aim"]) == ("change", 4, 0.35)
    assert row["uniform"] == 0.25 and row["constant"] == 0.75
    assert row["offset"] is None and row["data"] is None and row["people"] is None
    # For a's questions b says sitting or walking, as often: walking is right in half of them. For b's a says walking.
    assert row["label"] == (0.5 + 0.5 + 1 + 0) / 4
    assert row["reason"] == "constant 75 %, label 50 %, set 50 %, pair 50 %"


def test_the_best_answer_and_the_best_box_are_combined():
    rows = [choice("a", "walking"), choice("a", "walking"), choice("b", "walking"), choice("b", "sitting")]
    boxes = {"largest": [1, 0, 0, 0], "best_box": [1, 0, 0, 1]}
    (row,) = check(rows, lambda group: boxes)
    assert (row["largest"], row["best_box"]) == (0.25, 0.5)
    # The constant is right in the first three questions, the best box in the first and the last.
    assert row["combined"] == 0.25
    (row,) = check(rows, lambda group: {"people": [0.5, 1, 1, 1]}, lambda group: boxes)
    assert row["combined"] == (0.5 + 1) / 4


def test_guessers_are_scored_on_pairs_of_time_twins_too():
    """A guesser that ignores the time has no pair right; one that goes by the frame asked has the first."""
    rows = [
        choice("a", "walking", times=(0, 60)),
        choice("a", "standing", times=(0, 120)),
        choice("b", "sitting", times=(0, 60)),
        choice("b", "cycling", times=(0, 120)),
        choice("b", "walking"),
    ]
    rows = [replace(own, twin=key) for own, key in zip(rows, ("x", "x", "y", "y", None), strict=True)]
    counts = LabelCounts({("a", 60): {"walking": 1}, ("a", 120): {"standing": 1}, ("b", 60): {"walking": 3}})
    single, both = blind_check(rows, [counting_guesser(counts), lambda group: {"largest": [1] * len(group)}])
    assert (single["asks"], single["n"], single["constant"], single["largest"]) == ("choice", 5, 0.4, 1)
    assert (both["form"], both["asks"], both["n"]) == ("change, two twins", "choice", 2)
    assert (both["uniform"], both["constant"], both["data"], both["frame"]) == (1 / 16, 0, 0, 0.5)
    assert both["aim"] is both["reason"] is None and (both["largest"], both["combined"]) == (1, both["uniform"])


def test_frames_by_hand():
    rows = [start("a", 0, 100), start("a", 300, 420), start("b", 600, 735), start("b", 900, 1200)]
    (row,) = check(rows)
    # No two starts lie within two seconds of each other; of the offsets 100, 120, 135 and 300 two at a time do.
    assert row["constant"] == 0.25 and row["offset"] == 0.5
    assert row["uniform"] is None and row["label"] is None and row["aim"] == 0.25


def test_seconds_and_counts_are_judged_apart():
    rows = [seconds(value) for value in (5.0, 20.0, 21.0, 40.0)]
    durations, counts = check([*rows, *(seconds(value, "gap_count") for value in (4.0, 5.0, 6.0))])
    assert [row["template"] for row in (counts, durations)] == ["gap", "gap"]
    assert (durations["asks"], durations["n"], durations["constant"], durations["aim"]) == ("seconds", 4, 0.75, 0.58)
    assert (counts["asks"], counts["n"], counts["constant"], counts["aim"]) == ("count", 3, 1.0, None)
    assert counts["reason"] is None and durations["reason"] == "constant 75 %"


def test_forms_that_the_text_tells_apart_are_judged_apart():
    forms = [("gap_absence", 6.0)] * 3 + [("gap_starts", 60.0)] * 2
    absences, starts = check([seconds(value, form) for form, value in forms])
    assert [(row["form"], row["asks"], row["n"]) for row in (absences, starts)] == [
        ("gap_absence", "seconds", 3),
        ("gap_starts", "seconds", 2),
    ]
    # Together one constant would be right for three of five.
    assert absences["constant"] == starts["constant"] == 1.0


FRAMES = st.lists(st.integers(0, 300), min_size=1, max_size=12)


@given(FRAMES)
@settings(deadline=None)
def test_no_constant_frame_is_better(frames):
    rows = [start("a", 0, frame) for frame in frames]
    best = max(sum(abs(c - frame) <= 15 for frame in frames) for c in range(-20, 330))
    assert check(rows)[0]["constant"] == pytest.approx(best / len(frames))


@given(st.lists(st.integers(1, 400), min_size=1, max_size=12))
@settings(deadline=None)
def test_no_constant_number_is_better(tenths):
    values = [tenth / 10 for tenth in tenths]
    rows = [seconds(value) for value in values]
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
    assert question == QuestionText("0" * 16, "s", TEMPLATES["change"], POSES, ("reading",), (15, 90), Choice(3), text)
    assert question.chosen == "sitting"
    assert check([question])[0]["label"] == 0.25


def test_nothing_to_check():
    assert check([]) == []
