"""Bins of answers, and the numbers of the profile of the paper."""

import pytest

from jrdb_avr.engine.generate.bins import answer_bin
from jrdb_avr.engine.generate.selection import PROFILES


@pytest.mark.parametrize(
    ("seconds", "number"),
    [(3, 1), (5.9, 1), (6, 2), (9.9, 2), (10, 3), (14.9, 3), (15, 4), (20.9, 4), (21, 5), (99, 5)],
)
def test_offset_bins(seconds, number):
    assert answer_bin("frame", f'{{"frame":{round(150 + seconds * 15)}}}', [150], "start") == number
    span = f'{{"start_frame":{round(150 + seconds * 15)},"end_frame":9999}}'
    assert answer_bin("span", span, [150], "span") == number


@pytest.mark.parametrize(("value", "number"), [(5, 1), (9.9, 1), (10, 2), (20, 3), (39.9, 3), (40, 4), (400, 4)])
def test_gap_bins(value, number):
    assert answer_bin("number", f'{{"value":{value}}}', [0], "seconds_between") == number


def test_the_paper_profile():
    assert list(PROFILES["paper"].values()) == [67, 76, 222, 32, 51, 30, 1620]
