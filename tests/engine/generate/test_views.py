"""The fewest crops, against trying every set of crops at every column, and whether one crop is enough."""

from itertools import combinations

import numpy as np
import pytest
from environment import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jrdb_avr.engine.generate.views import single_view
from jrdb_avr.engine.observe.crops import min_crops, min_crops_of_frame

WIDTH = 3760
COLUMNS = st.one_of(
    st.integers(0, 7519).map(lambda n: n / 2),
    # Crowded round a few places, where a column more or less decides.
    st.tuples(st.sampled_from([0, 480, 960, 3280, 3700]), st.integers(-6, 6)).map(lambda t: (t[0] + t[1] / 4) % WIDTH),
)
BOXES = st.lists(st.tuples(COLUMNS, st.sampled_from([12.0, 61.0, 200.0, 480.0])), max_size=7)


LEFTS = np.arange(WIDTH)


def shown(x, w):
    """Whether each crop shows half of the box: its columns and those of its copies round the circle, counted."""
    parts = [
        np.minimum(x + w + turn, LEFTS + 480) - np.maximum(x + turn, LEFTS)
        for turn in (-2 * WIDTH, -WIDTH, 0, WIDTH, 2 * WIDTH)
    ]
    return 2 * sum(np.maximum(0, part) for part in parts) >= w


def brute_force(boxes):
    views = {frozenset(np.flatnonzero(view).tolist()) for view in np.array([shown(*box) for box in boxes]).T}
    for size in range(len(boxes) + 1):
        if any(len(frozenset().union(*some)) == len(boxes) for some in combinations(sorted(views, key=sorted), size)):
            return size
    raise AssertionError("some box cannot be shown")


@pytest.mark.slow
@given(BOXES)
@example([(0.0, 12.0), (480.0, 12.0)])
@example([(0.5, 12.0), (480.5, 12.0)])
@example([(3750.0, 61.0), (400.0, 12.0), (2000.0, 480.0)])
@example([(470.0 * i, 12.0) for i in range(8)])
@settings(deadline=None, max_examples=examples(30))
def test_no_set_of_crops_is_smaller(drawn):
    boxes = [(center - w / 2, w) for center, w in drawn]
    fewest = min_crops_of_frame(x + w / 2 for x, w in boxes)
    assert fewest == brute_force(boxes)
    x, w = np.array([box[0] for box in boxes]), np.array([box[1] for box in boxes])
    assert single_view(x, w, 0.5) == (fewest <= 1)


def test_the_whole_circle():
    assert min_crops_of_frame(range(WIDTH)) == 8
    assert min_crops_of_frame([]) == 0 and min_crops_of_frame([-5.0, 3755.0, 7515.0]) == 1


def test_frames_are_looked_at_one_by_one():
    assert min_crops([(0, 100.0, 50.0), (0, 200.0, 50.0), (15, 100.0, 50.0), (15, 1900.0, 50.0)]) == 3


@pytest.mark.parametrize(
    ("x", "whether"),
    [
        ((100.0, 560.0), True),  # from column 120 to 590: 470 of the 480 of a crop
        ((100.0, 575.0), False),
        ((3700.0, 400.0), True),
        ((3700.0, 415.0), False),
    ],
)
def test_one_view_shows_half_of_each_box(x, whether):
    assert single_view(np.array(x), np.array([40.0, 60.0]), 0.5) == whether
