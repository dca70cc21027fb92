"""An act that many may ask for at the same time and that is done once for all of them."""

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

T = TypeVar("T")


class OnceAtATime(Generic[T]):
    """Whoever asks while it is being done waits for the end and has the same answer, or the same error."""

    def __init__(self, act: Callable[[], T]) -> None:
        self._act = act
        self._lock = threading.Lock()
        self._under_way: Future[T] | None = None

    def __call__(self) -> T:
        """Its answer; any thread may ask."""
        mine = Future[T]()
        with self._lock:
            waited_for = self._under_way
            if waited_for is None:
                self._under_way = mine
        if waited_for is not None:
            return waited_for.result()
        try:
            mine.set_result(self._act())
        except BaseException as error:
            mine.set_exception(error)
        finally:
            with self._lock:
                self._under_way = None
        return mine.result()
