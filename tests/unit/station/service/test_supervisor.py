"""Simultaneous calls of a function are merged into one."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from core.errors import CtrError
from station.service.supervisor import SingleFlight


def test_simultaneous_calls_of_a_single_flight_function_get_the_same_result() -> None:
    started, proceed, done = threading.Event(), threading.Event(), list[int]()

    def act() -> int:
        started.set()
        proceed.wait()
        done.append(len(done))
        return len(done)

    once = SingleFlight(act)
    answers: list[Future[int]] = []
    with ThreadPoolExecutor(4) as threads:
        answers.append(threads.submit(once))
        started.wait()
        called = threading.Semaphore(0)

        def second() -> int:
            called.release()
            return once()

        answers += [threads.submit(second) for _ in range(3)]
        for _ in range(3):
            called.acquire()
        proceed.set()
        found = [answer.result() for answer in answers]
    assert found[0] == 1
    assert len(done) == max(found)  # a later call runs the function again
    assert once() == len(done)


def test_single_flight_function_runs_again_after_a_failed_call() -> None:
    tries: list[int] = []

    def act() -> None:
        tries.append(1)
        raise CtrError("it cannot be")

    once = SingleFlight(act)
    for _ in range(2):
        with pytest.raises(CtrError, match="it cannot be"):
            once()
    assert len(tries) == 2
