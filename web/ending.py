"""Ctrl-C, or a SIGTERM, ends the station once: what it begins, stopping the axes above all, goes to its end.

Pressed again and again it would cut that off wherever it is, and show the place as a traceback.
"""

import signal
from collections.abc import Callable
from types import FrameType

Handler = Callable[[int, FrameType | None], None]

ENDINGS = (signal.SIGINT, signal.SIGTERM)


def once(handle: Handler) -> Handler:
    """`handle` for the first of these signals; later ones are ignored."""

    def first(number: int, frame: FrameType | None) -> None:
        for ending in ENDINGS:
            signal.signal(ending, signal.SIG_IGN)  # the interpreter's own end leaves that as it is
        handle(number, frame)

    return first


def end_once() -> None:
    """From now on the first of these signals is a KeyboardInterrupt; in the main thread."""
    for ending in ENDINGS:
        signal.signal(ending, once(_interrupt))


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
