"""A message on stderr while Numba compiles: a command that waits for the compiler would seem to hang."""

import logging
import math
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager

#: Time since the start of the compilation after which the message is written [s].
PATIENCE_S = 3.0
#: Time without a compiled function after which the compilation counts as finished [s].
PAUSE_S = 30.0
NOTICE = "ctr-station: compiling the model for this computer: each part once, about two minutes in all"


class _Notice:
    """Log filter that writes `NOTICE` to stderr once if a series of compilations takes `PATIENCE_S` or longer."""

    def __init__(self) -> None:
        self.first = self.last = -math.inf  #: times of the first and of the latest function of a compilation [s]
        self.written = False

    def __call__(self, _record: logging.LogRecord) -> bool:
        now = time.monotonic()
        if now - self.last > PAUSE_S:
            self.first = now
        self.last = now
        if now - self.first >= PATIENCE_S and not self.written:
            self.written = True
            print(NOTICE, file=sys.stderr)  # noqa: T201
        return True


@contextmanager
def noticed_compilation() -> Generator[None]:
    """Write `NOTICE` if `core.compiled` compiles for `PATIENCE_S` or longer inside the `with` statement."""
    log, notice = logging.getLogger("core.compiled"), _Notice()
    level = log.level
    log.setLevel(logging.INFO)
    log.addFilter(notice)
    try:
        yield
    finally:
        log.removeFilter(notice)
        log.setLevel(level)
