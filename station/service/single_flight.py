"""A function whose simultaneous calls are merged into one."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

T = TypeVar("T")


class SingleFlight(Generic[T]):
    """Callable that runs a function once for simultaneous calls; every caller gets its result or exception."""

    def __init__(self, function: Callable[[], T]) -> None:
        self._function = function
        self._lock = threading.Lock()
        self._in_progress: Future[T] | None = None

    def __call__(self) -> T:
        """Return the result of a new call or of the call in progress; thread-safe."""
        mine = Future[T]()
        with self._lock:
            in_progress = self._in_progress
            if in_progress is None:
                self._in_progress = mine
        if in_progress is not None:
            return in_progress.result()
        try:
            mine.set_result(self._function())
        except BaseException as error:
            mine.set_exception(error)
        finally:
            with self._lock:
                self._in_progress = None
        return mine.result()
