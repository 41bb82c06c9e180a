"""A few cases of the fuzzer hold, and it finds faults that are put into the program."""

import importlib
import sys
from pathlib import Path
from random import Random

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import records

from jrdb_avr.agent.model import decode
from jrdb_avr.loaders.labelfiles.facts import Decoded
from jrdb_avr.loaders.layers import boxes_2d


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A random world, which is quickly loaded."""
    return records.World(tmp_path_factory.mktemp("fuzz"), 1, 2)


@pytest.fixture(autouse=True)
def no_clock(monkeypatch):
    """No limits of time, which would end the process of the tests."""
    monkeypatch.setattr(importlib.import_module("limits"), "begin", lambda: None)


def check(world, count):
    for number in range(count):
        case = records.Case(world, Random(f"1 records {number}"))
        case.check(case.changes)


def ask(folder, count):
    replies = importlib.import_module("replies")
    return sum(replies.run_case(1, number, folder, lambda name, content: None) for number in range(count))


def test_a_few_cases_hold(world, tmp_path):
    check(world, 3)
    assert ask(tmp_path, 10) > 10


@pytest.mark.slow
def test_an_error_out_of_the_tree_is_found(world, monkeypatch):
    monkeypatch.setattr(boxes_2d, "_cluster", int)
    with pytest.raises(TypeError):
        check(world, 40)


def test_a_fact_made_certain_by_what_is_unreadable_is_found(world, monkeypatch):
    read = Decoded.difficulty
    monkeypatch.setattr(Decoded, "difficulty", lambda self, value, name: read(self, value, name) or 1)
    with pytest.raises(AssertionError, match="became certain"):
        check(world, 40)


def test_an_unguarded_number_of_a_reply_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(decode, "frame_id", lambda value, what="": int(value))
    with pytest.raises((ValueError, TypeError)):
        ask(tmp_path, 100)
