"""A process of the station's own beside the one that needs it, with a pipe between the two."""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Callable
from typing import Any


class Child:
    """Owner of one process."""

    def __init__(self, main: Callable[..., None], *arguments: Any, name: str, daemon: bool = True) -> None:
        """Start `main(*arguments, pipe, parent)` in a new interpreter.

        Args:
            main: gets its end of the pipe, and this process's number, to see when it is gone.
            arguments: before those two.
            name: of the process.
            daemon: it ends with this process; False: it may outlive it.
        """
        context: Any = multiprocessing.get_context("spawn")
        self.pipe, end = context.Pipe()  #: to it; has something to read when it has said something
        self._process = context.Process(target=main, args=(*arguments, end, os.getpid()), name=name, daemon=daemon)
        # Ctrl-C in a terminal reaches the whole group: the parent decides when we end, from the first instruction on.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        end.close()

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.is_alive()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid or 0

    def tell(self, message: Any) -> None:
        """Send it a message; to one that has ended, nothing."""
        with contextlib.suppress(OSError):
            self.pipe.send(message)

    def ended(self, patience: float | None = None) -> str:
        """Wait until it has ended, for `patience` [s] at most: how it ended, or did not, in words."""
        self._process.join(patience)
        code = self._process.exitcode
        if code is None:
            return "not at all"
        return f"by signal {-code}" if code < 0 else f"with status {code}"

    def terminate(self) -> None:
        """Have it end whatever it is doing (SIGTERM)."""
        self._process.terminate()

    def kill(self) -> None:
        """End it at once (SIGKILL)."""
        self._process.kill()

    def end(self, patience: float) -> None:
        """Ask it to end by sending None; one that has not ended after `patience` [s] is killed."""
        self.tell(None)
        self._process.join(patience)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def close(self, patience: float) -> None:
        """`end` it, and close the pipe."""
        self.end(patience)
        self.pipe.close()
