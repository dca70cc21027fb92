"""Waiting for what must happen; how fast it does is no test's business."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: What has not happened after this time hangs [s]. A net, never a judgement.
NET = 300.0


def until(what: Callable[[], T], among: object = "") -> T:
    """The first true answer; fails, with what `among` says, if there is none."""
    end = time.monotonic() + NET
    while not (answer := what()):
        if time.monotonic() > end:
            raise AssertionError(f"it did not happen: {among}")
        time.sleep(0.02)
    return answer
