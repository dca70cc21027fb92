"""An act that many ask for at once is done once."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from core.errors import CtrError
from station.service.once_at_a_time import OnceAtATime


def test_those_who_come_meanwhile_have_the_answer_of_the_first() -> None:
    begun, go_on, done = threading.Event(), threading.Event(), list[int]()

    def act() -> int:
        begun.set()
        go_on.wait()
        done.append(len(done))
        return len(done)

    once = OnceAtATime(act)
    answers: list[Future[int]] = []
    with ThreadPoolExecutor(4) as threads:
        answers.append(threads.submit(once))
        begun.wait()
        asked = threading.Semaphore(0)

        def second() -> int:
            asked.release()
            return once()

        answers += [threads.submit(second) for _ in range(3)]
        for _ in range(3):
            asked.acquire()
        go_on.set()
        found = [answer.result() for answer in answers]
    assert found[0] == 1
    assert len(done) == max(found)  # whoever came after the end has it done anew
    assert once() == len(done)


def test_they_have_its_error_and_the_next_one_tries_again() -> None:
    tries: list[int] = []

    def act() -> None:
        tries.append(1)
        raise CtrError("it cannot be")

    once = OnceAtATime(act)
    for _ in range(2):
        with pytest.raises(CtrError, match="it cannot be"):
            once()
    assert len(tries) == 2
