"""Waiting for a condition without a limit on its speed, because a test must not depend on the computer's speed."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: Time after which a condition counts as a hang [s]; the time is long, so that no test fails on a slow computer.
NET = 300.0


def until(what: Callable[[], T], among: object = "") -> T:
    """Call `what` until its result is true; return the result, or fail with the text of `among` after `NET` seconds."""
    end = time.monotonic() + NET
    while not (answer := what()):
        if time.monotonic() > end:
            raise AssertionError(f"it did not happen: {among}")
        time.sleep(0.02)
    return answer
