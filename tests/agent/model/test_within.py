"""Work that another thread does within a time: whose result it is, and how many threads there are."""

import os
import threading
import time

import pytest

from jrdb_avr.agent.model.transport import within


def workers():
    return [
        thread for thread in threading.enumerate() if thread._target is not None and thread._target.__name__ == "_serve"
    ]


def test_what_the_work_returns_or_raises_is_the_callers():
    assert within(5, lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        within(5, lambda: 1 / 0)
    with pytest.raises(SystemExit):
        within(5, lambda: exit(3))
    assert within(5, threading.current_thread) is not threading.current_thread()


def test_a_late_result_reaches_nobody_else():
    go_on = threading.Event()
    with pytest.raises(TimeoutError):
        within(0.01, lambda: go_on.wait(30) and "late")
    assert [within(5, lambda i=i: i) for i in range(3)] == [0, 1, 2]
    go_on.set()
    assert [within(5, lambda i=i: i) for i in range(20)] == list(range(20))


def test_threads_are_kept_and_no_more_are_made_than_work_at_a_time():
    before = len(workers())
    for i in range(50):
        assert within(5, lambda i=i: i) == i
    assert len(workers()) <= max(before, 1)

    together = threading.Barrier(24)
    found = []

    def ask(i):
        for turn in range(20):
            found.append(within(20, lambda turn=turn: (together.wait(20), (i, turn))[1]) == (i, turn))

    callers = [threading.Thread(target=ask, args=(i,)) for i in range(24)]
    for caller in callers:
        caller.start()
    for caller in callers:
        caller.join()
    assert len(found) == 24 * 20 and all(found)
    assert len(workers()) <= max(before, 24)


def test_a_forked_process_has_threads_of_its_own():
    assert within(5, lambda: 1) == 1
    child = os.fork()
    if child == 0:
        os._exit(0 if within(5, os.getpid) == os.getpid() else 1)
    end = time.monotonic() + 20
    while (done := os.waitpid(child, os.WNOHANG))[0] == 0 and time.monotonic() < end:
        time.sleep(0.02)
    if done[0] == 0:
        os.kill(child, 9)
        os.waitpid(child, 0)
    assert done == (child, 0)
