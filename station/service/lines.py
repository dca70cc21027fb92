"""A file of lines that never fills a disk: at its limit it becomes `NAME.1.jsonl`, and the oldest of a few goes."""

import contextlib
import os
from collections import deque
from pathlib import Path


class Lines:
    """One such file. Not for several threads; several processes may each have it open."""

    def __init__(self, path: Path, limit: int, kept: int) -> None:
        """Open it, to be turned over at `limit` [bytes]; `kept` old ones stay.

        Raises:
            OSError: it cannot be written.
        """
        self._path, self._limit, self._kept = path, limit, kept
        self._file = path.open("a", encoding="utf-8")

    def add(self, line: str) -> None:
        """Write a line; one that the disk does not take is lost."""
        with contextlib.suppress(OSError):
            self._file.write(line + "\n")
            self._file.flush()
            if self._file.tell() >= self._limit:
                self._turn_over()

    def last(self, count: int) -> list[str]:
        """The last `count` lines at most, the newest first."""
        lines: deque[str] = deque(maxlen=count)
        for path in (self._older(1), self._path):
            with contextlib.suppress(OSError), path.open(encoding="utf-8", errors="replace") as file:  # not there yet
                lines.extend(file)
        return list(reversed(lines))

    def close(self) -> None:
        """Let go of the file; a line that the disk has not taken goes with it."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _turn_over(self) -> None:
        mine = os.fstat(self._file.fileno())
        # Another station on the same folder may have turned it over before.
        if self._path.exists() and os.path.samestat(mine, self._path.stat()):
            for number in range(self._kept, 0, -1):
                newer = self._path if number == 1 else self._older(number - 1)
                if newer.exists():
                    newer.replace(self._older(number))
        turned_over, self._file = self._file, self._path.open("a", encoding="utf-8")
        turned_over.close()

    def _older(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.stem}.{number}.jsonl")
