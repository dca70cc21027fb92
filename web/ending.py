"""Ctrl-C, or a SIGTERM, ends the station once: what it begins, stopping the axes above all, goes to its end.

Pressed again and again it would cut that off wherever it is, and show the place as a traceback.
"""

import signal
from types import FrameType
from typing import Protocol

ENDINGS = (signal.SIGINT, signal.SIGTERM)


class Handler(Protocol):
    """Of a signal, while `frame` is carried out."""

    def __call__(self, sig: int, frame: FrameType | None) -> None:
        """Do what the signal asks for."""
        ...


def once(handle: Handler) -> Handler:
    """`handle` for the first of these signals; later ones are ignored."""

    def first(sig: int, frame: FrameType | None) -> None:
        for ending in ENDINGS:
            signal.signal(ending, signal.SIG_IGN)  # the interpreter's own end leaves that as it is
        handle(sig, frame)

    return first


def end_once() -> None:
    """From now on the first of these signals is a KeyboardInterrupt; in the main thread."""
    for ending in ENDINGS:
        signal.signal(ending, once(_interrupt))


def _interrupt(sig: int, frame: FrameType | None) -> None:  # noqa: ARG001 - what a handler is given
    raise KeyboardInterrupt
