"""Answers: the stored payloads, and when two are the same."""

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.schema.answer_modes import MODES, decode_answer, mode_of, same_answer
from jrdb_avr.schema.answers import (
    Choice,
    FrameAnswer,
    FrameViewpoint,
    Number,
    Span,
    encode_answer,
    frames_iou,
)
from jrdb_avr.schema.errors import DecodeError

frames = st.integers(0, 10_000_000)
finite = st.floats(allow_nan=False, allow_infinity=False)
answers = st.one_of(
    st.builds(Choice, st.integers(1, 1000)),
    st.builds(FrameAnswer, frames),
    st.builds(Span, frames, frames),
    st.builds(FrameViewpoint, frames, finite),
    st.builds(Number, finite),
)


@given(answers)
def test_stored_answers_come_back(answer):
    mode = mode_of(answer).name
    assert decode_answer(mode, encode_answer(answer)) == answer


def test_stored_json_is_the_public_payload():
    assert encode_answer(Choice(2)) == '{"choice":2}'
    assert encode_answer(FrameAnswer(150)) == '{"frame":150}'
    assert encode_answer(Span(10, 95)) == '{"start_frame":10,"end_frame":95}'
    assert encode_answer(FrameViewpoint(150, 210.0)) == '{"frame":150,"angle_deg":210.0}'
    assert encode_answer(Number(12.5)) == '{"value":12.5}'


@pytest.mark.parametrize(
    ("mode", "text"),
    [
        ("multiple_choice", '{"choice": 0}'),
        ("multiple_choice", '{"choice": true}'),
        ("multiple_choice", '{"choice": 2, "why": ""}'),
        ("frame", '{"frame": -1}'),
        ("frame", '{"frame": 1e9}'),
        ("span", '{"start_frame": 1}'),
        ("frame_viewpoint", '{"frame": 1, "angle_deg": NaN}'),
        ("frame_viewpoint", '{"frame": 1, "angle_deg": 1e999}'),
        ("number", '{"value": null}'),
        ("number", "\ud800"),
        ("number", "[" * 100_000),
        ("nonsense", '{"value": 1}'),
    ],
)
def test_what_does_not_fit_is_refused(mode, text):
    with pytest.raises(DecodeError):
        decode_answer(mode, text)


@given(st.text(), st.sampled_from(sorted(MODES)))
def test_any_text_decodes_or_is_refused(text, mode):
    with contextlib.suppress(DecodeError):
        assert isinstance(decode_answer(mode, text), MODES[mode].type)


small = st.integers(0, 40)


@given(small, small, small, small)
def test_span_overlap_is_the_jaccard_of_frames(a, b, c, d):
    one, two = set(range(a, b + 1)), set(range(c, d + 1))
    expected = len(one & two) / len(one | two) if one and two else 0.0
    assert frames_iou(Span(a, b), Span(c, d)) == pytest.approx(expected)
    assert frames_iou(Span(a, b), Span(c, d)) == frames_iou(Span(c, d), Span(a, b))


@given(answers)
def test_an_answer_equals_itself_where_it_means_something(answer):
    meaningless = (isinstance(answer, Number) and answer.value <= 0) or (
        isinstance(answer, Span) and answer.end_frame < answer.start_frame
    )
    assert same_answer(answer, answer) is not meaningless


@given(answers, answers)
def test_answers_of_different_kinds_are_never_the_same(a, b):
    assert not same_answer(None, a)
    assert type(a) is type(b) or not same_answer(a, b)
    assert same_answer(a, b) == same_answer(b, a)


def test_a_number_that_is_none_fits_no_truth():
    assert not same_answer(FrameViewpoint(10, math.inf), FrameViewpoint(10, 0.0))
    assert not same_answer(Number(math.nan), Number(1.0))
