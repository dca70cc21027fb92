"""Log file of limited size: a full file is renamed to `NAME.1.jsonl`, and the oldest file is removed."""

import contextlib
import os
from collections import deque
from pathlib import Path


class RotatingLog:
    """One rotating log file. It is not thread-safe, but several processes may have it open."""

    def __init__(self, path: Path, limit: int, kept: int) -> None:
        """Open the file, rotate it at `limit` [bytes] and keep `kept` old files.

        Raises:
            OSError: the file cannot be written.
        """
        self._path, self._limit, self._kept = path, limit, kept
        self._file = path.open("a", encoding="utf-8")

    def add(self, line: str) -> None:
        """Write a line; the line is lost if the disk is full."""
        with contextlib.suppress(OSError):
            self._file.write(line + "\n")
            self._file.flush()
            if self._file.tell() >= self._limit:
                self._rotate()

    def last(self, count: int) -> list[str]:
        """Return the last lines, at most `count`, the newest first."""
        lines: deque[str] = deque(maxlen=count)
        for path in (self._older(1), self._path):
            with (
                contextlib.suppress(OSError),
                path.open(encoding="utf-8", errors="replace") as file,
            ):  # the older file may not exist yet
                lines.extend(file)
        return list(reversed(lines))

    def close(self) -> None:
        """Close the file; lines that could not be written are lost."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _rotate(self) -> None:
        mine = os.fstat(self._file.fileno())
        # Another station with the same folder may already have rotated the file.
        if self._path.exists() and os.path.samestat(mine, self._path.stat()):
            for number in range(self._kept, 0, -1):
                newer = self._path if number == 1 else self._older(number - 1)
                if newer.exists():
                    newer.replace(self._older(number))
        rotated, self._file = self._file, self._path.open("a", encoding="utf-8")
        rotated.close()

    def _older(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.stem}.{number}.jsonl")
