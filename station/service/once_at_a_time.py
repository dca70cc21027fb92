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
        with self._lock:
            waited_for = self._under_way
            if waited_for is None:
                mine = self._under_way = Future[T]()
        if waited_for is not None:
            return waited_for.result()
        try:
            answer = self._act()
        except BaseException as error:
            with self._lock:
                self._under_way = None
            mine.set_exception(error)
            raise
        with self._lock:
            self._under_way = None
        mine.set_result(answer)
        return answer
