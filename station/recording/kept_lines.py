"""Files of JSON lines that one process at a time adds to: a line is there whole, or not at all.

Half a line at the end (kill -9, a full disk) counts as none, and the next one takes its place.
"""

import fcntl
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from station.recording.label import RecordingError


class KeptLines:
    """Such a file, locked until it is closed; whoever has read it says by `length` where its `whole_lines` end."""

    def __init__(self, path: Path, busy: str) -> None:
        """Open it, new if it is not there; `busy` says what another process that has it does.

        Raises:
            RecordingError: another process has it.
            OSError: it cannot be opened.
        """
        self.path, self.length = path, 0
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise RecordingError(f"{path}: another process {busy}") from None
        except OSError:
            pass  # a file system without locks, as some clusters have

    def append(self, value: Mapping[str, Any]) -> bytes:
        """Add a line, behind `length`.

        Raises:
            RecordingError: the disk does not take it.
        """
        line = json.dumps(value).encode() + b"\n"
        try:
            os.ftruncate(self._file, self.length)  # half a line, if there was one
            _write(self._file, line, self.length)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._file, self.length)
            raise RecordingError(f"{self.path}: cannot be written: {error.strerror}") from None
        self.length += len(line)
        return line

    def close(self) -> None:
        """Let others have it."""
        os.close(self._file)


def whole_lines(path: Path, data: bytes) -> tuple[list[Any], int]:
    """What the whole lines of a file's content say, and their length [bytes].

    Raises:
        RecordingError: one before the last, or the only one, is no JSON.
    """
    *lines, _ = data.split(b"\n")
    found: list[Any] = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(json.loads(line))
        except ValueError:
            if number == len(lines) > 1:  # a computer that lost its power may leave anything there
                break
            raise RecordingError(f"{path}, line {number}: no JSON; repair it, or take another folder") from None
    return found, sum(len(line) + 1 for line in lines[: len(found)])


def _write(file: int, data: bytes, place: int) -> None:
    while data:
        written = os.pwrite(file, data, place)
        data, place = data[written:], place + written
    os.fsync(file)
