"""Ctrl-C as a question."""

import os
import signal
import threading
from collections.abc import Iterator

import pytest

from station.experiments.interrupt import interrupts


@pytest.fixture
def ordinary() -> Iterator[None]:
    """Ctrl-C raises, also where these tests were started in the background and were to be deaf to it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ordinary")
def test_the_first_press_is_noted_and_the_second_is_the_ordinary_exception() -> None:
    before = signal.getsignal(signal.SIGINT)
    with interrupts() as interrupted:
        assert not interrupted()
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_another_thread_asks_in_vain_but_may_ask() -> None:
    said: list[bool] = []

    def ask() -> None:
        with interrupts() as interrupted:
            said.append(interrupted())

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    assert said == [False]
