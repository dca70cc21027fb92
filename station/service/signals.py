"""Orderly end by Ctrl-C or SIGTERM: the first signal raises KeyboardInterrupt, and later signals are ignored."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

EXIT_SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def exit_on_signal() -> Iterator[None]:
    """Interrupt the main thread's work at the first signal; ignore signals during the cleanup that follows."""
    received: list[int] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        for ending in EXIT_SIGNALS:
            signal.signal(ending, signal.SIG_IGN)  # the signals stay ignored while the interpreter ends
        raise KeyboardInterrupt

    before = {number: signal.signal(number, on_signal) for number in EXIT_SIGNALS}
    try:
        yield
    finally:
        if not received:
            for number, handler in before.items():
                signal.signal(number, handler)
