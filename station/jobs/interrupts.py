"""Ctrl-C as a flag that a loop polls."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from core.errors import CtrError


class JobInterrupted(CtrError):
    """Ctrl-C ended a job before it had a result."""


@contextmanager
def interrupts() -> Iterator[Callable[[], bool]]:
    """Return a function that reports whether Ctrl-C was pressed; a second press raises KeyboardInterrupt.

    A KeyboardInterrupt may occur at any instruction, and inside compiled code it becomes a SystemError. A loop that
    polls this function ends at a safe point instead.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False  # Python delivers signals to the main thread only
        return
    pressed = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def note(_number: int, _frame: object) -> None:
        pressed.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, note)
    try:
        yield pressed.is_set
    finally:
        signal.signal(signal.SIGINT, before)
