"""A few cases of the fuzzer hold, and it finds faults that are put into the program."""

import importlib
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from jrdb_avr.agent.model import decode


@pytest.fixture(autouse=True)
def no_clock(monkeypatch):
    """No limits of time, which would end the process of the tests."""
    monkeypatch.setattr(importlib.import_module("limits"), "begin", lambda: None)


def ask(folder, count):
    replies = importlib.import_module("replies")
    return sum(replies.run_case(1, number, folder, lambda name, content: None) for number in range(count))


def test_a_few_cases_hold(tmp_path):
    assert ask(tmp_path, 10) > 10


def test_an_unguarded_number_of_a_reply_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(decode, "frame_id", lambda value, what="": int(value))
    with pytest.raises((ValueError, TypeError)):
        ask(tmp_path, 100)
