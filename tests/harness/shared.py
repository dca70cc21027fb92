"""A station or a browser that consecutive tests share; it ends before the first test that does not use it.

A fixture of the scope `session`, or of the scope `package` in a folder without `__init__.py`, would end after the last
test of the session. Until then an idle station occupies a quarter of a processor.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from typing import Generic, TypeVar

T = TypeVar("T")


class Shared(Generic[T]):
    """Holder of a context's value; the context is entered at the first use."""

    def __init__(self, make: Callable[[], AbstractContextManager[T]]) -> None:
        """`make` returns a new context; it is called again for the first use after `end`."""
        self._make, self._owned = make, ExitStack()
        self._value: T | None = None

    def __call__(self) -> T:
        """Return the value of the context, and enter the context if necessary."""
        if self._value is None:
            self._value = self._owned.enter_context(self._make())
        return self._value

    def end(self) -> None:
        """Exit the context if it has been entered."""
        self._value = None
        self._owned.close()
