"""Keys counted in JSON texts, against Python's own reading of the text."""

from __future__ import annotations

import json
import tracemalloc

import pytest
from effort import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from jrdb_avr.loaders.labelfiles.json import keys_exceed

KEYS = ("id", "box", "pair", "box_pair", "label_id", "demographics_info", "group_info", "keypoints", "num_keypoints")
words = st.sampled_from([*KEYS, "", ":", '"box":', "a :b", "pedestrian:1", "\u00e9"])
blanks = st.text(" \t\r\n", max_size=2)


@st.composite
def values(draw, depth=3):
    """A JSON value as text, keys repeated and blanks anywhere."""
    if depth == 0 or draw(st.integers(0, 3)) == 0:
        return json.dumps(draw(st.one_of(words, st.integers(0, 99), st.none())), ensure_ascii=False)
    space = draw(blanks)
    inner = [draw(values(depth=depth - 1)) for _ in range(draw(st.integers(0, 4)))]
    if draw(st.booleans()):
        return f"[{space}{f'{space},'.join(inner)}{space}]"
    members = (f"{json.dumps(draw(words), ensure_ascii=False)}{space}:{draw(blanks)}{value}" for value in inner)
    return f"{{{draw(blanks)}{f',{space}'.join(members)}}}"


@settings(max_examples=examples(25))
@given(
    values(),
    st.lists(st.sampled_from(KEYS), min_size=1, max_size=3, unique=True),
    st.integers(0, 3),
    st.sampled_from((17, 17, 4096)),
)
def test_keys_that_stand_more_often_than_allowed_are_noticed(text, keys, limit, short):
    found = []

    def members(pairs):
        found.extend(key for key, _ in pairs)

    json.loads(text, object_pairs_hook=members)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jrdb_avr.loaders.labelfiles.json._SHORT", short)
        exceed = keys_exceed(text.encode(), [(limit, tuple(f'"{key}"'.encode() for key in keys))])
    if sum(map(found.count, keys)) > limit:
        assert exceed
    if sum(text.count(f'"{key}"') for key in keys) <= limit:
        assert not exceed


def test_strings_full_of_colons_cost_no_memory():
    text = b'[{"image_id": 1, "note": "%b", "image_id": 2}]' % (b":" * (4 << 20))
    tracemalloc.start()
    try:
        assert keys_exceed(text, [(1, (b'"image_id"',))]) and not keys_exceed(text, [(2, (b'"image_id"',))])
        assert tracemalloc.get_traced_memory()[1] < 2.1 * len(text)
    finally:
        tracemalloc.stop()
