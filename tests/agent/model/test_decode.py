"""The strict contract of replies, and that boxes survive the way there and back."""

import dataclasses
import json
import re
import time

import pytest
from fake_server import BACKBONES
from hypothesis import assume, given
from hypothesis import strategies as st

from jrdb_avr.agent.model import decode
from jrdb_avr.agent.model.conventions import CONTRACT, convention_of
from jrdb_avr.agent.model.decode import read_answer, read_evidence, reply_object, write_box
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.agent.model.reply import Reply, answer_text, thinking_text
from jrdb_avr.agent.model.schemas import answer_schema, frame_schema
from jrdb_avr.schema.answers import Choice, FrameAnswer, FrameViewpoint, Number, Span
from jrdb_avr.schema.errors import DecodeError, InputError
from jrdb_avr.schema.panorama import Box

OBJECT = '{"action": "observe", "frame_id": "000150", "angle_deg": 210}'


def reply(text, finish_reason="stop", reasoning=""):
    return Reply(content=text, reasoning=reasoning, finish_reason=finish_reason)


@pytest.mark.parametrize(
    "text",
    [
        OBJECT,
        f"  {OBJECT}\n",
        f"```json\n{OBJECT}\n```",
        f"```\n{OBJECT}\n```",
        f"<think>look left, {{}} </think>{OBJECT}",
        f"so, left it is</think>\n\n{OBJECT}",
        f"<|channel>thought\nhm<channel|>{OBJECT}",
        f"<think>\n</think>\n```json\n{OBJECT}\n```",
        f"```json\r\n{OBJECT}\r\n```\r\n",
        f"```JSON \n{OBJECT}\n```",
        f"<think>left</think> <think>or right</think>{OBJECT}",
        f"<think>a<think>b</think>c</think>{OBJECT}",
        f"left </think> or right</think>{OBJECT}",
        f"{OBJECT}\n<think>that was it</think>",
        f"\n<|begin_of_box|>{OBJECT}<|end_of_box|>",
        f"◁think▷look◁/think▷{OBJECT}",
        f"<|channel|>analysis<|message|>look<|end|><|channel|>final <|constrain|>json<|message|>{OBJECT}<|return|>",
        f"<reasoning>look</reasoning>\n{OBJECT}",
        f"[THINK]look[/THINK]```json\n{OBJECT}\n```",
        f"<|channel|>analysis<|message|>hm<|end|><|start|>assistant<|channel|>final<|message|>{OBJECT}",
        f"<|channel|>analysis<|message|>hm<|end|><|start|>assistant<|channel|>final<|message|>{OBJECT}<|return|>",
        f"<think>hm</think><answer>{OBJECT}</answer>",
        f"{OBJECT}<|im_end|>",
        f"{OBJECT}</s>",
    ],
)
def test_one_object_is_read(text):
    assert reply_object(reply(text)) == json.loads(OBJECT)


@pytest.mark.parametrize("reason", ["end", "COMPLETE", "<|eot_id|>", "tool_calls", "other"])
def test_an_unknown_finish_reason_leaves_a_readable_reply_valid(reason):
    assert reply_object(reply(OBJECT, reason)) == json.loads(OBJECT)
    assert reply(OBJECT, reason).finished
    with pytest.raises(DecodeError, match="is not one JSON object"):
        reply_object(reply(OBJECT[:-1], reason))
    with pytest.raises(DecodeError, match=r"is empty \(finish_reason "):
        reply_object(reply("", reason))


def test_delimiters_of_the_options():
    text = f"<unused94>hm<unused95>@@{OBJECT}"
    with pytest.raises(DecodeError):
        reply_object(reply(text))
    declared = EndpointOptions(delimiters=("<unused94>...<unused95>", "@@")).delimited(CONTRACT)
    assert reply_object(reply(text), declared) == json.loads(OBJECT)
    assert thinking_text(reply(text), declared) == "hm"
    for wrong in ("", "...x"):
        with pytest.raises(InputError, match="--delimiter"):
            EndpointOptions(delimiters=(wrong,))


def test_a_delimiter_in_a_text_is_text():
    said = '{"reasoning": ["the sign reads <think>"]}'
    assert reply_object(reply(said)) == json.loads(said)


def test_a_reply_filed_under_reasoning():
    assert reply_object(reply("", reasoning=f"thoughts</think>{OBJECT}")) == json.loads(OBJECT)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "   ",
        "null",
        "[]",
        "2",
        '"x"',
        "I will look left.",
        f"Sure! {OBJECT}",
        f"{OBJECT} Hope this helps",
        f"{OBJECT}\n{OBJECT}",
        f"```json\n{OBJECT}\n```\n```json\n{OBJECT}\n```",
        f"```json\n{OBJECT}",
        f"```python\n{OBJECT}\n```",
        OBJECT[:-1],
        OBJECT.replace('"', "'"),
        '{"a": NaN}',
        '{"a": Infinity}',
        '{"a": 1, "a": 2}',
        '{"a": {"b": 1, "b": 1}}',
        f"<think>I could say {OBJECT}",
        f"{OBJECT}<think>or else</think>{OBJECT}",
        f"<think>left</think>{OBJECT}<think>or right</think>{OBJECT}",
        f"<think>left</think>{OBJECT}<think>or right, {OBJECT}",
        f"Sure! <think>left</think>{OBJECT}",
        f"{OBJECT}<think>or else",
        f"\ufeff{OBJECT}",
        f"<|channel|>analysis<|message|>{OBJECT}<|end|>",
        f"<|begin_of_box|>{OBJECT}<|end_of_box|><|begin_of_box|>{OBJECT}<|end_of_box|>",
        f"<unused94>{OBJECT}",
        f"```json {OBJECT}```",
        f"~~~json\n{OBJECT}\n~~~",
        "[" * 100_000,
        '{"a": ' + "9" * 5000 + "}",
        '{"a":' * 50_000 + "1" + "}" * 50_000,
    ],
)
def test_anything_else_is_invalid(text):
    with pytest.raises(DecodeError):
        reply_object(reply(text))


@pytest.mark.parametrize(
    ("content", "reasoning", "words"),
    [
        ("", OBJECT, "out of which no answer is taken"),
        (" ", f"<think>{OBJECT}", "out of which no answer is taken"),
        ("", f"{OBJECT}</think>", "out of which no answer is taken"),
        ("", f"<|channel>thought\n{OBJECT}<channel|> ", "out of which no answer is taken"),
        (f"<think>{OBJECT}", "", "after its thinking"),
        (f"<think>{OBJECT}</think>", "", "after its thinking"),
        ("", "", "empty"),
    ],
)
def test_no_answer_is_taken_out_of_the_reasoning(content, reasoning, words):
    with pytest.raises(DecodeError, match=f"the reply is empty.*{words}" if words != "empty" else "is empty$"):
        reply_object(reply(content, reasoning=reasoning))


@pytest.mark.parametrize("finish_reason", ["stop", "length", "content_filter"])
@pytest.mark.parametrize("content", ["", OBJECT])
def test_a_refusal_is_no_answer(content, finish_reason):
    refused = Reply(content, finish_reason=finish_reason, refusal="I cannot\x1b help\nwith that.")
    with pytest.raises(DecodeError, match="the model refused: I cannot") as caught:
        reply_object(refused)
    assert str(caught.value).isprintable()


@given(st.sampled_from(sorted(BACKBONES)), st.text(), st.text(), st.text(), st.text())
def test_any_reply_is_an_object_or_a_reason(model, content, reasoning, finish_reason, refusal):
    """Junk never raises anything but DecodeError, and its reason can be printed."""
    for reason in (finish_reason, "stop"):
        for text in (content, content + OBJECT, f"```json\n{content}", f"<think>{content}</think>{{}}"):
            try:
                found = reply_object(Reply(text, reasoning, reason, refusal=refusal), convention_of(model))
            except DecodeError as error:
                assert str(error).isascii() and str(error).isprintable()
            else:
                assert isinstance(found, dict)
                assert not refusal


@given(st.text(max_size=60), st.text(max_size=60), st.sampled_from(sorted(BACKBONES)))
def test_what_was_thought_is_never_what_was_said(thoughts, words, model):
    convention = convention_of(model)
    for opening, closing in convention.thinking:
        assume(closing not in thoughts + words and opening not in thoughts + words)
        whole = Reply(f"{opening}{thoughts}{closing}{words}", finish_reason="stop")
        assert answer_text(whole, convention) == words.strip()
        assert thinking_text(whole, convention) == thoughts.strip()
        stranded = Reply("", f"{thoughts}{closing}{words}", "stop")
        assert answer_text(stranded, convention) == words.strip()
        assert answer_text(Reply(f"{opening}{thoughts}", finish_reason="stop"), convention) == ""
    assert answer_text(Reply("", thoughts, "stop"), convention) == ""
    assert thinking_text(Reply("", thoughts, "stop"), convention) == thoughts.strip()


# -- answers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "value", "answer"),
    [
        ("multiple_choice", 1, Choice(1)),
        ("multiple_choice", 4, Choice(4)),
        ("multiple_choice", 2.0, Choice(2)),
        ("frame", {"frame_id": "000150"}, FrameAnswer(150)),
        ("span", {"start_frame": "000010", "end_frame": "000010"}, Span(10, 10)),
        ("frame_viewpoint", {"frame_id": "000999", "angle_deg": -30}, FrameViewpoint(999, 330.0)),
        ("number", {"value": "12.5"}, Number(12.5)),
        ("number", {"value": "4"}, Number(4.0)),
    ],
)
def test_answers_that_fit(mode, value, answer):
    assert read_answer(value, mode, 4, 1000) == answer


@pytest.mark.parametrize(
    ("mode", "value"),
    [
        ("multiple_choice", 0),
        ("multiple_choice", 5),
        ("multiple_choice", True),
        ("multiple_choice", 2.5),
        ("multiple_choice", 1e400),
        ("multiple_choice", "2"),
        ("multiple_choice", "B"),
        ("multiple_choice", "sitting"),
        ("multiple_choice", {"choice": 2}),
        ("multiple_choice", None),
        ("frame", 150),
        ("frame", "000150"),
        ("frame", {"frame_id": 150}),
        ("frame", {"frame_id": "150"}),
        ("frame", {"frame_id": "001000"}),
        ("frame", {"frame_id": "-00150"}),
        ("frame", {"frame_id": "٠٠٠١٥٠"}),
        ("frame", {"frame_id": "000150\n"}),
        ("frame", {"frame_id": "000150", "angle_deg": 3}),
        ("span", {"start_frame": "000010"}),
        ("span", {"start_frame": "000010", "end_frame": "000009"}),
        ("frame_viewpoint", {"frame_id": "000150"}),
        ("frame_viewpoint", {"frame_id": "000150", "angle_deg": "90"}),
        ("frame_viewpoint", {"frame_id": "000150", "angle_deg": float("inf")}),
        ("frame_viewpoint", {"frame_id": "000150", "angle_deg": 10**400}),
        ("frame_viewpoint", {"frame_id": "000150", "angle_deg": True}),
        ("number", {"value": 12.5}),
        ("number", {"value": "nan"}),
        ("number", {"value": "1e3"}),
        ("number", {"value": "about 12"}),
        ("number", {"value": "12.5", "unit": "s"}),
        ("number", "12.5"),
    ],
)
def test_answers_that_do_not_fit(mode, value):
    with pytest.raises(DecodeError):
        read_answer(value, mode, 4, 1000)


@pytest.mark.parametrize(
    ("degrees", "said"),
    [("90", "must be a number"), (True, "must be a number"), (10**400, "a finite number"), (1e999, "a finite number")],
)
def test_what_is_said_of_an_angle_that_is_none(degrees, said):
    with pytest.raises(DecodeError, match=f"{said}.* of degrees"):
        decode.angle(degrees)


# -- boxes ------------------------------------------------------------------------------------------------------------


def evidence(bbox, frame="000150", key="bbox"):
    return [{"frame_id": frame, key: bbox}]


def test_whole_floats_are_integers_unless_they_may_be_fractions():
    assert decode.read_box([0.0, 0, 500.0, 1e3], (480, 480)) == Box(0, 0, 240, 480)
    for numbers in ([0.0, 0.0, 1.0, 1.0], [0.5, 0, 500.0, 700], ["1", 0, 500.0, 700], [True, 0, 500.0, 700]):
        with pytest.raises(DecodeError, match="four integers"):
            decode.read_box(numbers, (480, 480))


@pytest.mark.parametrize(
    ("scale", "number", "said"),
    [
        ("thousandths", 10**400, "box has a coordinate outside 0..1000"),
        ("unit", 10**400, "box has a coordinate outside 0..1"),
        ("unit", float("inf"), "box has a coordinate outside 0..1"),
        ("unit", float("nan"), "box has a coordinate outside 0..1"),
        ("unit", True, "box must be a list of four numbers"),
        ("thousandths", float("inf"), "box must be a list of four integers"),
    ],
)
def test_what_is_said_of_numbers_without_bounds(scale, number, said):
    convention = dataclasses.replace(CONTRACT, scales={"bbox": scale})
    with pytest.raises(DecodeError, match=f"^{said}$"):
        decode.read_box([number, 1, 2, 3], (480, 480), convention, "bbox")


@pytest.mark.parametrize(
    "value",
    [
        None,
        [],
        {},
        evidence([0, 0, 10, 10]) * 2,
        [[0, 0, 10, 10]],
        evidence([-21, 0, 10, 10]),
        evidence([0, 0, 10, 1021]),
        evidence([10, 0, 0, 10]),
        evidence([0, 10, 10, 0]),
        evidence([5, 0, 5, 10]),
        evidence([-20, 0, -1, 10]),
        evidence([0, 0, 10]),
        evidence([0, 0, 10, 10, 10]),
        evidence([0, 0, 10.5, 10]),
        evidence([0, 0, "10", 10]),
        evidence([0, 0, True, 10]),
        evidence("0 0 10 10"),
        evidence([0, 0, 10, 10], "000151"),
        evidence([0, 0, 10, 10], 150),
        evidence([0, 0, 10, 10], key="bbox_2d"),
        [{"frame_id": "000150"}],
        [{"bbox": [0, 0, 10, 10]}],
        [{"frame_id": "000150", "bbox": [0, 0, 10, 10], "label": "man"}],
    ],
)
def test_boxes_that_do_not_fit(value):
    with pytest.raises(DecodeError):
        read_evidence(value, {150}, (480, 480))


SIDE = st.floats(0, 480, allow_nan=False)


@given(SIDE, SIDE, st.floats(8, 480), st.floats(8, 480), st.sampled_from(["xyxy", "yxyx"]))
def test_boxes_survive_writing_and_reading(x, y, w, h, order):
    box = Box(x, y, min(w, 480 - x), min(h, 480 - y))
    if box.w < 2 or box.h < 2:
        return
    convention = decode.Convention("test", {"bbox": order})
    left, top, right, bottom = write_box(box, (480, 480))
    written = [left, top, right, bottom] if order == "xyxy" else [top, left, bottom, right]
    back = read_evidence(evidence(written), {150}, (480, 480), convention).box
    for a, b in ((back.x, box.x), (back.y, box.y), (back.x + back.w, box.x + box.w), (back.y + back.h, box.y + box.h)):
        assert abs(a - b) <= 0.25


# -- the schema shown to servers --------------------------------------------------------------------------------------


def test_schemas_close_every_object():
    for mode in ("multiple_choice", "frame", "span", "frame_viewpoint", "number"):
        schema = answer_schema(mode, ["a", "b"], range(9))
        assert schema["type"] == "integer" or schema["additionalProperties"] is False
    assert answer_schema("multiple_choice", ["a", "b"], range(9))["maximum"] == 2


@given(st.integers(201, 999_999), st.integers(0, 999_999))
def test_of_many_frames_a_schema_states_form_and_range(count, frame):
    pattern = re.compile(frame_schema(range(count))["pattern"])
    assert bool(pattern.search(f"{frame:06d}")) == (frame < count)
    for id in (f"{count - 1:06d}", "000000"):
        assert pattern.search(id) and not pattern.search(id + "0") and not pattern.search("x" + id)
    assert frame_schema((3, 15)) == {"type": "string", "enum": ["000003", "000015"]}


@pytest.mark.slow
@pytest.mark.parametrize(
    "filler", [" ", "\n", "\t", "`", "{", "```\n", "</think>", "<think>", "<think></think>", "<|channel>thought"]
)
@pytest.mark.parametrize("start", ["", "```\n", "```json\n{", "<think>", "<think></think>"])
def test_a_long_reply_is_read_in_a_moment(start, filler):
    """A megabyte took hours where reading was quadratic."""
    started = time.thread_time()
    with pytest.raises(DecodeError):
        reply_object(Reply(start + filler * (1_000_000 // len(filler)) + "x", finish_reason="stop"))
    assert time.thread_time() - started < 5


def test_reasons_hold_no_control_characters():
    for word in ("\x1b[2J", "a\nb", "\x00", "\x9b31m", "\ud800", "\u202e"):
        for reply in ({"action": "observe", word: 1}, {word: 1}):
            with pytest.raises(DecodeError) as caught:
                decode.only_keys(reply, ("action",), "x")
            assert str(caught.value).isascii() and str(caught.value).isprintable()
        with pytest.raises(DecodeError) as caught:
            reply_object(Reply("", finish_reason=word))
        assert str(caught.value).isascii() and str(caught.value).isprintable()
