"""Panorama geometry: one convention, checked by oracles and by rolling the strip round."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jrdb_avr.schema.panorama import (
    CROP,
    FOV_DEG,
    HEIGHT,
    WIDTH,
    Box,
    angle_error,
    angle_of_azimuth,
    angle_of_column,
    center_angle,
    clockwise,
    column_of_angle,
    crop_left,
    from_crop,
    iou,
    row_of_height,
    to_crop,
)

columns = st.floats(-3 * WIDTH, 3 * WIDTH)
angles = st.floats(-1000, 1000)
boxes = st.builds(Box, columns, st.floats(-100, 480), st.floats(0.5, 480), st.floats(0.5, 480))


def turn_between(a, b):
    """Degrees between two directions, by vectors."""
    a, b = math.radians(a), math.radians(b)
    return math.degrees(abs(math.atan2(math.sin(a - b), math.cos(a - b))))


def test_the_stated_directions():
    assert pytest.approx(45.957, abs=1e-3) == FOV_DEG
    assert angle_of_column(0.0) == 0.0
    assert angle_of_column(WIDTH / 2) == 180.0
    assert angle_of_azimuth(0.0) == 180.0  # x forward is straight ahead
    assert angle_of_azimuth(math.pi / 2) == pytest.approx(90.0)  # y is left
    assert angle_of_azimuth(-math.pi / 2) == pytest.approx(270.0)
    assert turn_between(angle_of_azimuth(math.pi), 0.0) < 1e-9
    assert row_of_height(0.0, 5.0) < row_of_height(-1.0, 5.0)  # what is lower lies in a lower row


def test_angles_grow_clockwise_seen_from_above():
    # Turning right from straight ahead: the azimuth falls, the angle and the column grow.
    assert angle_of_azimuth(-0.1) > angle_of_azimuth(0.1)
    assert clockwise(180.0, 270.0) == 90.0
    assert clockwise(270.0, 180.0) == 270.0
    assert clockwise(350.0, 10.0) == 20.0


@given(columns)
def test_column_and_angle_are_inverse(column):
    angle = angle_of_column(column)
    assert 0 <= angle < 360
    back = column_of_angle(angle)
    assert 0 <= back < WIDTH
    assert turn_between(angle_of_column(back), column * 360 / WIDTH) < 1e-6


@given(st.sampled_from([-1e-300, -5e-17, -0.0, 0.0, 3760.0, -3760.0, 359.99999999999999, 1e15]))
def test_ranges_are_half_open_even_where_rounding_bites(value):
    assert 0 <= angle_of_column(value) < 360
    assert 0 <= column_of_angle(value) < WIDTH
    assert 0 <= clockwise(value, 0.0) < 360
    assert 0 <= crop_left(value) < WIDTH


@given(angles, angles)
def test_angle_error_is_the_smaller_turn(a, b):
    error = float(angle_error(a, b))
    assert 0 <= error <= 180
    assert error == pytest.approx(turn_between(a, b), abs=1e-6)
    assert error == pytest.approx(float(angle_error(b, a)), abs=1e-9)
    assert error == pytest.approx(float(angle_error(a + 360, b)), abs=1e-6)
    clock = clockwise(a, b)
    assert min(clock, 360 - clock) == pytest.approx(error, abs=1e-6)


@given(st.lists(st.tuples(angles, angles), min_size=1, max_size=20))
def test_arrays_give_what_floats_give(pairs):
    a, b = np.array(pairs).T
    for function in (angle_error, clockwise):
        assert function(a, b).tolist() == [float(function(x, y)) for x, y in pairs]
    for function in (angle_of_column, column_of_angle, angle_of_azimuth):
        assert function(a).tolist() == [float(function(x)) for x in a.tolist()]
    assert center_angle(a, b).tolist() == [float(center_angle(x, y)) for x, y in pairs]


@given(angles)
def test_a_crop_is_centred_on_its_angle(angle):
    left = crop_left(angle)
    assert left == int(left)
    assert 0 <= left < WIDTH
    assert turn_between(angle_of_column(left + CROP / 2), angle) <= 0.5 * 360 / WIDTH + 1e-9


@given(boxes, angles)
def test_crop_and_panorama_are_inverse_but_for_turns(box, angle):
    left = crop_left(angle)
    there = to_crop(box, left)
    assert (there.y, there.w, there.h) == (box.y, box.w, box.h)
    assert abs(there.x + there.w / 2 - CROP / 2) <= WIDTH / 2 + 1e-6
    back = from_crop(there, left)
    turns = (back.x - box.x) / WIDTH
    assert abs(turns - round(turns)) * WIDTH < 1e-6
    if box.w >= 1 and box.h >= 1:
        assert iou(back, box) == pytest.approx(1.0, abs=1e-6)


@given(boxes, angles)
def test_a_crop_centred_on_a_box_shows_it(box, angle):
    there = to_crop(box, crop_left(float(center_angle(box.x, box.w))))
    assert there.x + there.w / 2 == pytest.approx(CROP / 2, abs=0.5 + 1e-6)


@given(boxes, boxes, st.floats(-WIDTH, WIDTH), st.integers(-3, 3))
def test_iou_does_not_change_when_the_panorama_is_rolled(a, b, roll, turn):
    rolled = iou(Box(a.x + roll, *a[1:]), Box(b.x + roll + turn * WIDTH, *b[1:]))
    assert rolled == pytest.approx(iou(a, b), abs=1e-6)


@pytest.mark.parametrize(
    "empty",
    [
        *(Box(0, 0, 0, 5), Box(0, 0, 5, 0), Box(5, 5, -5, -5), Box(0, 0, math.nan, 5), Box(0, 0, 5, math.nan)),
        *(Box(0, math.nan, 10, 10), Box(0.0, 0.0, 1e-200, 1e-200)),
    ],
)
def test_iou_of_an_empty_box_is_zero(empty):
    assert iou(empty, empty) == 0.0
    assert iou(Box(0, 0, 10, 10), empty) == 0.0


def test_touching_boxes_do_not_meet():
    assert iou(Box(0, 0, 10, 10), Box(10, 0, 10, 10)) == 0.0
    assert iou(Box(0, 0, 10, 10), Box(0, 10, 10, 10)) == 0.0
    assert iou(Box(WIDTH - 10, 0, 10, 10), Box(0, 0, 10, 10)) == 0.0
    assert iou(Box(WIDTH - 5, 0, 10, 10), Box(0, 0, 10, 10)) == pytest.approx(50 / 150)
    assert HEIGHT == CROP == 480


@pytest.mark.parametrize(
    "box",
    [
        *((1.7e308, 0, 1.7e308, 3), (-1.7e308, 0, 1.7e308, 3), (0, 1.7e308, 3, 1.7e308), (0, 0, 1.7e308, 1.7e308)),
        *((math.nan, 10, 50, 50), (10, 10, math.inf, 50)),
    ],
)
def test_boxes_as_large_as_numbers_go_do_not_fit_a_person(box):
    assert not iou(Box(*box), Box(10, 10, 50, 50)) > 0.01
