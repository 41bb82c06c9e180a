"""Where the evidence of the baselines lies: by count of columns, in pixels, over the seam, after any reply at all."""

import json
from fractions import Fraction

import pytest
from environment import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scripted import MODES, RedWorld, blank_task, evidence, final, play, proposal, red_eyes, shown

from jrdb_avr.agent.methods.chain_of_thought import ChainOfThought
from jrdb_avr.agent.methods.monolithic import Monolithic
from jrdb_avr.agent.methods.search_recognize import SearchRecognize
from jrdb_avr.schema.answers import Choice
from jrdb_avr.schema.panorama import Box, iou

METHODS = (Monolithic, ChainOfThought, SearchRecognize)

places = st.tuples(st.integers(0, 998), st.integers(0, 998)).flatmap(
    lambda low: st.tuples(
        st.just(low[0]), st.just(low[1]), st.integers(low[0] + 1, 1000), st.integers(low[1] + 1, 1000)
    )
)


def exactly(bbox, width, height=480):
    """Pixels of a box in thousandths: (left, top, width, height)."""
    left, top, right, bottom = (Fraction(v, 1000) for v in bbox)
    return left * width, top * height, (right - left) * width, (bottom - top) * height


def close(box, exact):
    return all(abs(a - float(b)) < 1e-6 for a, b in zip(box, exact, strict=True))


@settings(max_examples=examples(30))
@given(places, st.sampled_from([0, 5, 10]))
def test_a_box_in_a_panorama(bbox, frame):
    prediction, _ = play(Monolithic, [final(2, bbox, frame)], blank_task())
    assert prediction.evidence.frame == frame
    assert close(prediction.evidence.box, exactly(bbox, 3760))


@settings(max_examples=examples(30))
@given(places, places)
def test_a_box_in_the_crop(coarse, fine):
    """The crop's middle column is the coarse box's, to half a column; the fine box counts from the crop's left one."""
    looks = []
    replies = [proposal(coarse, 5), proposal(fine, 5), '{"answer": 2}']
    prediction, chat = play(SearchRecognize, replies, blank_task(looks=looks))
    middle = Fraction(coarse[0] + coarse[2], 2000) * 3760
    left = json.loads(chat.user(1)[1].removeprefix("Crop: "))["left"]
    assert 0 <= left < 3760
    off = (left + 240 - middle + 1880) % 3760 - 1880
    assert abs(off) <= Fraction(1, 2) + Fraction(1, 50)
    frame, angle = looks[-1]
    assert frame == 5 and abs(angle - float(middle) * 360 / 3760 % 360) < 1e-3
    x, y, w, h = exactly(fine, 480)
    assert close(prediction.evidence.box, ((left + x) % 3760, y, w, h))
    told = json.loads(chat.user(2)[-2].removeprefix("Refined box, stitched pixels: "))
    assert all(abs(a - b) < 0.051 for a, b in zip(told, prediction.evidence.box, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("x", [0, 47, 1801, 3620])
def test_a_person_comes_back(tmp_path, method, x):
    """Found in pixels, written by the contract, read back: a thousandth of a panorama is 3.76 columns."""
    world = RedWorld(tmp_path, {0: (x, 101, 140, 239), 5: (900, 50, 90, 100)}, (0, 5))
    steps = []
    prediction, _ = play(method, red_eyes(3), world.task("Who?", "multiple_choice", "abcd", steps))
    assert (prediction.status, prediction.answer) == ("answered", Choice(3))
    assert prediction.evidence.frame == 0
    assert iou(Box(*prediction.evidence.box), Box(x, 101, 140, 239)) > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("x", [-70, -69, -22, 3760 - 22, 3760 - 118])
def test_a_person_over_the_seam(tmp_path, x):
    """One crop shows the person whole. A panorama shows two parts, of which one can be boxed: the larger."""
    true = Box(x, 80, 140, 320)
    world = RedWorld(tmp_path, {0: tuple(true)}, (0,))
    prediction, chat = play(SearchRecognize, red_eyes(), world.task("Who?", "multiple_choice", "abcd"))
    box = Box(*prediction.evidence.box)
    assert 0 <= box.x < 3760 < box.x + box.w
    assert iou(box, true) > 0.95
    ((_, line, _),) = shown(chat.user(1))
    assert json.loads(line.removeprefix("Crop: "))["left"] > 3760 - 480

    for method in (Monolithic, ChainOfThought):
        prediction, _ = play(method, red_eyes(), world.task("Who?", "multiple_choice", "abcd"))
        box = Box(*prediction.evidence.box)
        before = 3760 - x % 3760
        share = max(before, 140 - before) / 140
        assert box.x + box.w <= 3760
        # Half a thousandth of the width on either side.
        assert iou(box, true) == pytest.approx(share, abs=1.88 * 2 / 140)


def test_a_box_may_not_run_over_the_edge_of_a_panorama():
    """Neither backwards nor beyond: only what rounding may do is clipped."""
    for bbox, reason in [((990, 200, 10, 800), "reversed"), ((990, 200, 1021, 800), "outside 0..1000")]:
        for method, reply in [(Monolithic, final(2, bbox)), (SearchRecognize, proposal(bbox))]:
            prediction, _ = play(method, [reply] * 2 + [final(2, bbox)] * 2, blank_task())
            assert (prediction.status, prediction.evidence) == ("invalid", None)
            assert reason in prediction.reason
    prediction, _ = play(Monolithic, [final(2, (990, 200, 1020, 800))], blank_task())
    assert close(prediction.evidence.box, exactly((990, 200, 1000, 800), 3760))


# -- any reply at all -------------------------------------------------------------------------------------------------

json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-30, 1030) | st.floats() | st.text(max_size=8) | st.just("000005"),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["frame_id", "bbox", "answer", "value", "x"]), inner, max_size=3)
    ),
    max_leaves=6,
)
boxes = json_values | st.builds(lambda box: evidence(box, 5), st.lists(st.integers(-30, 1030), min_size=4, max_size=4))
objects = st.fixed_dictionaries(
    {},
    optional={
        "answer": json_values | st.just(2),
        "evidence_bboxes": boxes,
        "reasoning": json_values | st.lists(st.text(max_size=9), max_size=3),
    },
)
replies = (
    st.text(max_size=30)
    | json_values.map(json.dumps)
    | objects.map(json.dumps)
    | places.map(lambda bbox: proposal(bbox, 5))
    | st.just('{"reasoning": ["he stands"]}')
)


@settings(max_examples=examples(50), deadline=None)
@given(st.sampled_from(METHODS), st.sampled_from(MODES), st.lists(replies, min_size=6, max_size=6))
def test_whatever_the_model_says_the_question_ends(method, mode, script):
    task = blank_task(mode, "abcd" if mode == "multiple_choice" else ())
    prediction, chat = play(method, script, task)
    assert prediction.n_model_calls == len(chat.sent) <= 6
    assert (prediction.status == "answered") == (prediction.answer is not None and prediction.evidence is not None)
    assert prediction.status == "answered" or prediction.reason
    assert prediction.raw == script[len(chat.sent) - 1]
    if prediction.evidence is not None:
        x, y, w, h = prediction.evidence.box
        assert prediction.evidence.frame in (0, 5, 10)
        assert 0 <= x < 3760 and w > 0 and h > 0 and 0 <= y <= y + h <= 480 + 1e-9
