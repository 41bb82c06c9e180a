"""How many calls a server gets at a time, once replies no longer come in time."""

import threading
from concurrent.futures import ThreadPoolExecutor

from jrdb_avr.agent.model.gate import Gate


def together(gate, calls, meet, act=lambda own: None):
    """The most calls inside at a time of `calls`, which leave in groups of `meet` that are inside together."""
    lock, barrier, most = threading.Lock(), threading.Barrier(meet), []
    inside = 0

    def call(_):
        nonlocal inside
        with gate.admitted() as own:
            with lock:
                inside += 1
                most.append(inside)
            barrier.wait(20)
            act(own)
            barrier.wait(20)
            with lock:
                inside -= 1

    with ThreadPoolExecutor(calls) as pool:
        list(pool.map(call, range(calls)))
    return max(most)


def test_all_are_admitted_until_one_times_out():
    assert together(Gate(), 64, 64) == 64


def test_calls_that_time_out_together_halve_once_and_replies_win_places_back():
    gate = Gate()
    assert together(gate, 16, 16, gate.timed_out) == 16
    assert together(gate, 32, 8) == 8
    for _ in range(9):
        gate.replied()
    assert together(gate, 36, 9) == 9, "a round of replies wins one place"
    assert together(gate, 1, 1, gate.timed_out) == 1
    assert together(gate, 8, 1) == 1, "half of those in flight, one at least"


def test_a_call_from_before_the_last_halving_does_not_halve_again():
    gate = Gate()
    with gate.admitted() as first:
        together(gate, 15, 15, gate.timed_out)
        gate.timed_out(first)
    assert together(gate, 16, 8) == 8
