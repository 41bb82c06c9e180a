"""Conventions per backbone: what is declared of each, and that boxes survive being written and read in every one."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from fake_server import BACKBONES
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from jrdb_avr.agent.model.conventions import CONTRACT, Convention, convention_of
from jrdb_avr.agent.model.decode import box_key, read_box
from jrdb_avr.agent.model.options import EndpointOptions
from jrdb_avr.schema.errors import DecodeError
from jrdb_avr.schema.panorama import CROP, HEIGHT, WIDTH, Box

GEMMA = ("gemma-4", {"bbox": "xyxy", "box_2d": "yxyx"}, False)
QWEN_VL = ("qwen3-vl", {"bbox": "xyxy", "bbox_2d": "xyxy"}, False)
QWEN_35 = ("qwen3.5", {"bbox": "xyxy", "bbox_2d": "xyxy"}, True)
CONTRACTS = ("contract", {"bbox": "xyxy"}, None)


@pytest.mark.parametrize(
    ("model", "declared"),
    [
        ("google/gemma-4-E2B-it", GEMMA),
        ("google/gemma-4-E4B-it", GEMMA),
        ("gemma4:e4b", GEMMA),
        ("unsloth/Gemma_4_E2B", GEMMA),
        ("Qwen/Qwen3-VL-4B-Instruct", QWEN_VL),
        ("Qwen/Qwen3-VL-8B-Instruct-FP8", QWEN_VL),
        ("qwen3vl:8b", QWEN_VL),
        ("Qwen/Qwen3-VL-8B-Thinking", ("qwen3-vl-thinking", QWEN_VL[1], True)),
        ("Qwen/Qwen3.5-4B", QWEN_35),
        ("Qwen/Qwen3.5-9B", QWEN_35),
        ("qwen3.5:9b", QWEN_35),
        ("simulated", CONTRACTS),
        ("google/gemma-3-4b-it", CONTRACTS),
        ("google/gemma-4.5-E2B", CONTRACTS),
        ("Qwen/Qwen3-4B", CONTRACTS),
        ("Qwen/Qwen2.5-VL-7B-Instruct", CONTRACTS),
        ("Qwen/Qwen3.55", CONTRACTS),
    ],
)
def test_what_is_declared_of_a_model(model, declared):
    convention = convention_of(model)
    assert (convention.name, dict(convention.boxes), convention.thinks) == declared


@pytest.mark.parametrize(
    ("model", "thinking", "sent", "thinks"),
    [
        ("Qwen/Qwen3.5-9B", "off", {"enable_thinking": False}, False),
        ("Qwen/Qwen3.5-9B", "on", {}, True),
        ("Qwen/Qwen3.5-9B", "template", {}, True),
        ("google/gemma-4-E4B-it", "off", {}, False),
        ("google/gemma-4-E4B-it", "on", {"enable_thinking": True}, True),
        ("google/gemma-4-E4B-it", "template", {}, False),
        ("Qwen/Qwen3-VL-8B-Instruct", "off", {}, False),
        ("Qwen/Qwen3-VL-8B-Thinking", "off", {}, False),
        ("some-model", "off", {}, False),
        ("some-model", "template", {}, None),
    ],
)
def test_thinking_is_switched_where_it_can_be(model, thinking, sent, thinks):
    """What cannot be switched is declared alone: preflight finds the server that thinks otherwise."""
    options, convention = EndpointOptions(thinking=thinking), convention_of(model)
    assert dict(options.template(convention)) == sent
    assert options.thinks(convention) is thinks


SIDES = st.integers(32, 4000)
PROCESSORS = {
    "Qwen/Qwen3-VL-8B-Instruct": {
        "size": {"shortest_edge": 65_536, "longest_edge": 16_777_216},
        "patch_size": 16,
        "merge_size": 2,
    },
    "google/gemma-4-E4B-it": {"max_soft_tokens": 280, "patch_size": 16, "pooling_kernel_size": 3},
}
"""The sizes in the published configurations of the image processors (docs/servers.md)."""


@pytest.mark.parametrize(
    ("model", "crop", "panorama", "tokens"),
    [
        ("Gemma-4 E2B", (768, 768), (2208, 240), (256, 230)),
        ("Qwen3-VL 4B", (480, 480), (3776, 480), (225, 1770)),
        ("Qwen3.5 4B", (480, 480), (3776, 480), (225, 1770)),
        ("some-model", (480, 480), (3760, 480), (None, None)),
    ],
)
def test_how_a_backbone_resizes_pictures(model, crop, panorama, tokens):
    convention = convention_of(model)
    assert (convention.resized(CROP, CROP), convention.resized(WIDTH, HEIGHT)) == (crop, panorama)
    assert (convention.picture_tokens(CROP, CROP), convention.picture_tokens(WIDTH, HEIGHT)) == tokens
    if all(tokens):
        cells = " | ".join(["x".join(map(str, size)) for size in (crop, panorama)] + [f"{n:,}" for n in tokens])
        page = (Path(__file__).parents[3] / "docs" / "servers.md").read_text("utf-8")
        assert re.search(rf"^\| {re.escape(model)}, .* {re.escape(cells)} \|", page, re.MULTILINE)


@settings(max_examples=1000)
@given(SIDES, SIDES)
def test_sizes_are_those_of_the_image_processors(width, height):
    """The functions of the processors themselves, if `transformers` is installed."""
    gemma4 = pytest.importorskip("transformers.models.gemma4.image_processing_pil_gemma4")
    qwen = pytest.importorskip("transformers.models.qwen2_vl.image_processing_pil_qwen2_vl")
    assume(max(width, height) <= 100 * min(width, height))
    resized = {model: convention_of(model).resized(width, height)[::-1] for model in PROCESSORS}
    assert resized == {
        "Qwen/Qwen3-VL-8B-Instruct": qwen.smart_resize(height, width, 32, 65_536, 16_777_216),
        "google/gemma-4-E4B-it": gemma4.get_aspect_ratio_preserving_size(height, width, 16, 280 * 9, 3),
    }


@pytest.mark.parametrize("size", [(CROP, CROP), (WIDTH, HEIGHT), (64, 64), (5000, 4000)])
@pytest.mark.parametrize("model", PROCESSORS)
def test_tokens_are_those_of_the_image_processors(model, size):
    """The processors run on a picture with the published configuration."""
    gemma4 = pytest.importorskip("transformers.models.gemma4.image_processing_pil_gemma4")
    qwen = pytest.importorskip("transformers.models.qwen2_vl.image_processing_pil_qwen2_vl")
    picture = np.zeros((size[1], size[0], 3), np.uint8)
    tokens = convention_of(model).picture_tokens(*size)
    if "gemma" in model:
        assert gemma4.Gemma4ImageProcessorPil(**PROCESSORS[model])(picture)["num_soft_tokens_per_image"] == [tokens]
    else:
        grid = qwen.Qwen2VLImageProcessorPil(**PROCESSORS[model])(picture)["image_grid_thw"]
        assert grid.prod().item() / 4 == tokens


# -- boxes ------------------------------------------------------------------------------------------------------------

CONVENTIONS = [CONTRACT, *{id(c): c for c in map(convention_of, BACKBONES)}.values()]
SCALED = [
    Convention(f"{order} {scale}", {"bbox": order}, scales={"bbox": scale}, multiple=32, image_pixels=500_000)
    for order in ("xyxy", "yxyx")
    for scale in ("thousandths", "unit", "pixels", "resized")
]
SIZES = st.sampled_from([(CROP, CROP), (WIDTH, HEIGHT)])
SHARE = st.floats(0, 1)


def encode(corners, reading, convention, width, height):
    """Four numbers as a model of this convention writes them: independent of the product's reading of them."""
    left, top, right, bottom = corners
    full = {
        "thousandths": (1000, 1000),
        "unit": (1, 1),
        "pixels": (width, height),
        "resized": convention.resized(width, height),
    }[reading.scale]
    numbers = [left * full[0], top * full[1], right * full[0], bottom * full[1]]
    if reading.scale != "unit":
        numbers = [round(number) for number in numbers]
    return numbers if reading.order == "xyxy" else [numbers[1], numbers[0], numbers[3], numbers[2]]


@given(st.sampled_from(CONVENTIONS + SCALED), SIZES, SHARE, SHARE, SHARE, SHARE, st.data())
def test_what_a_convention_writes_it_reads(convention, size, a, b, c, d, data):
    key = data.draw(st.sampled_from(sorted(convention.boxes)))
    left, right = sorted((a, b))
    top, bottom = sorted((c, d))
    assume(right - left > 0.01 and bottom - top > 0.01)
    width, height = size
    written = encode((left, top, right, bottom), convention.reading(key), convention, width, height)
    box = read_box(json.loads(json.dumps(written)), (width, height), convention, key)
    # Half a pixel of the smallest resized side, which has 224.
    slack = 0.0005 if convention.reading(key).scale == "thousandths" else 0.5 / 224
    for seen, true, side in (
        (box.x, left, width),
        (box.y, top, height),
        (box.x + box.w, right, width),
        (box.y + box.h, bottom, height),
    ):
        assert math.isclose(seen / side, true, abs_tol=slack + 1e-9)


@given(st.sampled_from(CONVENTIONS), SIZES, st.lists(st.integers(0, 1000), min_size=4, max_size=4))
def test_reversed_corners_are_never_a_box(convention, size, numbers):
    for key in convention.boxes:
        a, b, c, d = numbers
        if a < c and b < d:
            read_box(numbers, size, convention, key)
            for swapped in ([c, b, a, d], [a, d, c, b], [c, d, a, b]):
                with pytest.raises(DecodeError, match="reversed"):
                    read_box(swapped, size, convention, key)
        else:
            with pytest.raises(DecodeError, match="reversed"):
                read_box(numbers, size, convention, key)


NUMBER = (
    st.integers()
    | st.floats()
    | st.booleans()
    | st.none()
    | st.text(max_size=3)
    | st.sampled_from([math.nan, math.inf, -math.inf, True, "10", 10**400, 1e308])
)


@given(
    st.sampled_from(CONVENTIONS + SCALED), st.lists(NUMBER, max_size=6) | NUMBER | st.dictionaries(st.text(), NUMBER)
)
def test_junk_is_no_box(convention, value):
    """Whatever is no list of four fitting numbers gives a reason, and what does fit lies in the image."""
    try:
        box = read_box(value, (480, 480), convention)
    except DecodeError as error:
        assert str(error).isprintable()
        return
    assert isinstance(value, list) and len(value) == 4
    assert all(type(v) in (int, float) and math.isfinite(v) for v in value)
    assert 0 <= box.x < box.x + box.w <= 480.001 and 0 <= box.y < box.y + box.h <= 480.001


@pytest.mark.parametrize(
    ("value", "outcome"),
    [
        ([-20, 0, 500, 1000], Box(0, 0, 240, 480)),
        ([0, -20, 500, 1020], Box(0, 0, 240, 480)),
        ([-21, 0, 500, 1000], None),
        ([0, 0, 500, 1021], None),
        ([0, 0, 1021, 500], None),
    ],
)
def test_two_percent_are_clipped_and_no_more(value, outcome):
    if outcome:
        assert read_box(value, (480, 480)) == outcome
    else:
        with pytest.raises(DecodeError, match="outside"):
            read_box(value, (480, 480))


def test_two_percent_of_pixels_are_of_each_side():
    pixels = Convention("p", {"bbox": "xyxy"}, scales={"bbox": "pixels"})
    assert read_box([0, 0, 3835, 489], (WIDTH, HEIGHT), pixels) == Box(0, 0, WIDTH, HEIGHT)
    for beyond in ([0, 0, 3836, 480], [0, 0, 3760, 490]):
        with pytest.raises(DecodeError, match="outside"):
            read_box(beyond, (WIDTH, HEIGHT), pixels)


def test_a_key_of_another_tool_is_read_as_the_contracts():
    gemma = convention_of("google/gemma-4-E4B-it")
    assert read_box([100, 200, 300, 600], (1000, 1000), gemma, "box") == Box(100, 200, 200, 400)
    assert read_box([100, 200, 300, 600], (1000, 1000), gemma, "box_2d") == Box(200, 100, 400, 200)


@pytest.mark.parametrize(
    ("entry", "key"),
    [
        ({"box": []}, "box"),
        ({"box_2d": []}, "box_2d"),
        ({"bbox": []}, "bbox"),
        ({"bbox_2d": []}, "box"),
        ({"box": [], "box_2d": []}, "box"),
        ({}, "box"),
        (None, "box"),
        ("box_2d", "box"),
    ],
)
def test_the_key_that_was_written(entry, key):
    assert box_key(entry, convention_of("google/gemma-4-E4B-it"), "box") == key
