"""The expected angle of a person at other frames: between sightings, beyond them, and over the seam."""

from hypothesis import example, given
from hypothesis import strategies as st
from readings import toward

from jrdb_avr.agent.perceive.expectation import expected_place
from jrdb_avr.agent.perceive.readings import PersonReading
from jrdb_avr.schema.panorama import Box, angle_error


def read(angle, frame, whole=True):
    return PersonReading(f"o{frame}", 1, frame, Box(toward(angle), 100.0, 50.0, 150.0), whole=whole)


@given(st.floats(0, 359), st.floats(-2, 2), st.integers(0, 40), st.integers(41, 100))
@example(350.0, 1.0, 20, 60)
def test_constant_speed_over_the_seam_and_less_of_it_beyond(start, speed, between, beyond):
    readings = [read((start + speed * frame) % 360, frame) for frame in (0, 40)]
    last = expected_place(readings, 40)
    for frame in (0, between, 40):
        place = expected_place(readings, frame)
        assert angle_error(place.angle, start + speed * frame) < 1e-6
        assert place.angle_spread >= last.angle_spread
    later = expected_place(readings, beyond)
    way = angle_error(later.angle, last.angle)
    assert 0.18 * abs(speed) * min(beyond - 40, 60) - 1e-6 <= way <= abs(speed) * min(beyond - 40, 60) + 1e-6
    assert angle_error(later.angle, start + speed * beyond) <= abs(speed) * (beyond - 40) + 1e-6


def test_the_uncertainty_grows_with_time():
    spreads = [expected_place([read(10, 30)], frame).angle_spread for frame in (30, 31, 60, 300)]
    assert spreads == sorted(spreads) and spreads[0] < spreads[1] < spreads[3] <= 120


def test_a_whole_view_counts_more_than_a_cut_one_of_the_same_frame():
    assert round(expected_place([read(40, 15), read(10, 15, whole=False)], 15).angle) == 40


def test_an_angle_that_rounds_to_a_whole_turn_is_0():
    walked = [PersonReading("o1", 1, at, Box(left, 0.0, 50.0, 100.0)) for at, left in ((0, 3755.0), (9, 3710.0))]
    assert expected_place(walked, 4).angle == 0.0
