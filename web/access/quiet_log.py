"""Limit the log lines that any client can cause by invalid requests and invalid WebSocket handshakes.

The libraries log each of them, some with a traceback. A program that sends invalid data would otherwise fill the
terminal and the log of the system.
"""

import logging
import time
from collections.abc import Callable

#: Messages that are limited, and the loggers of the libraries that write them.
LIMITED = ("opening handshake failed", "Invalid HTTP request received.", "Unsupported upgrade request.")
LOGGERS = ("websockets.server", "uvicorn.error")
#: Time within which a message is written only once [s].
INTERVAL_S = 60.0


class OncePerInterval(logging.Filter):
    """Filter that writes a limited message once per interval, with the number of messages that were left out."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._until: dict[str, float] = {}
        self._omitted: dict[str, int] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to write a record; a limited one is written without its traceback."""
        text = record.getMessage()
        if not text.startswith(LIMITED):
            return True
        if self._clock() < self._until.get(text, 0.0):
            self._omitted[text] = self._omitted.get(text, 0) + 1
            return False
        self._until[text] = self._clock() + INTERVAL_S
        cause = record.exc_info[1] if record.exc_info else None
        omitted = self._omitted.pop(text, 0)
        parts = (text, "" if cause is None else f": {cause}", f" ({omitted} more before)" if omitted else "")
        record.msg, record.args, record.exc_info, record.exc_text = " ".join("".join(parts).split()), (), None, None
        return True


def limit_log() -> None:
    """Limit the log lines of the web server's libraries in this process."""
    for name in LOGGERS:
        logger = logging.getLogger(name)
        if not any(isinstance(known, OncePerInterval) for known in logger.filters):
            logger.addFilter(OncePerInterval())
