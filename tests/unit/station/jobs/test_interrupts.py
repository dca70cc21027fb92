"""Ctrl-C as a flag that a loop polls."""

import os
import signal
import threading
from collections.abc import Iterator

import pytest

from station.jobs.interrupts import interrupts


@pytest.fixture
def ordinary() -> Iterator[None]:
    """Restore the default handler of Ctrl-C, which is ignored when the tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ordinary")
def test_the_first_ctrl_c_sets_the_interrupt_flag_and_the_second_raises_keyboard_interrupt() -> None:
    before = signal.getsignal(signal.SIGINT)
    with interrupts() as interrupted:
        assert not interrupted()
        os.kill(os.getpid(), signal.SIGINT)
        assert interrupted()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_the_interrupt_flag_is_never_set_in_a_thread_other_than_the_main_one() -> None:
    answers: list[bool] = []

    def poll() -> None:
        with interrupts() as interrupted:
            answers.append(interrupted())

    thread = threading.Thread(target=poll)
    thread.start()
    thread.join()
    assert answers == [False]
