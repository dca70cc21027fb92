"""Ctrl-C and SIGTERM end a station in order: the first of them is a KeyboardInterrupt, later ones change nothing."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def ended_once() -> Iterator[None]:
    """Of the main thread: whatever it does at the first one is left, and what it does then is not."""
    said: list[int] = []

    def hear(number: int, _frame: FrameType | None) -> None:
        said.append(number)
        for ending in ENDING:
            signal.signal(ending, signal.SIG_IGN)  # the interpreter's own end leaves that as it is
        raise KeyboardInterrupt

    before = {number: signal.signal(number, hear) for number in ENDING}
    try:
        yield
    finally:
        if not said:
            for number, handler in before.items():
                signal.signal(number, handler)
