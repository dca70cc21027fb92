"""Files of JSON lines with one writing process at a time; a line is either complete or ignored.

A kill or a full disk may leave an incomplete last line. A reader ignores this line, and the next line overwrites it.
"""

import fcntl
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from station.recording.run_outcome import RecordingError


class KeptLines:
    """File of JSON lines that is being written; it is locked until it is closed.

    After the existing lines have been read, set `length` to the end of `complete_lines`: the next line starts there.
    """

    def __init__(self, path: Path, busy: str) -> None:
        """Open or create the file; `busy` describes the activity of another process that has locked it.

        Raises:
            RecordingError: another process has locked the file.
            OSError: the file cannot be opened.
        """
        self.path, self.length = path, 0
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise RecordingError(f"{path}: another process {busy}") from None
        except OSError:
            pass  # some file systems of clusters do not support locks

    def append(self, value: Mapping[str, Any]) -> bytes:
        """Write a JSON line at the offset `length`, and return its bytes.

        Raises:
            RecordingError: the line cannot be written.
        """
        line = json.dumps(value).encode() + b"\n"
        try:
            os.ftruncate(self._file, self.length)  # removes an incomplete last line
            _write(self._file, line, self.length)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._file, self.length)
            raise RecordingError(f"{self.path}: cannot be written: {error.strerror}") from None
        self.length += len(line)
        return line

    def close(self) -> None:
        """Close and unlock the file."""
        os.close(self._file)


def complete_lines(path: Path, data: bytes) -> tuple[list[Any], int]:
    """Return the JSON values of the complete lines in a file's content, and the length of these lines [bytes].

    Raises:
        RecordingError: the only line, or a line before the last one, is not JSON.
    """
    *lines, _ = data.split(b"\n")
    found: list[Any] = []
    for number, line in enumerate(lines, 1):
        try:
            found.append(json.loads(line))
        except ValueError:
            if number == len(lines) > 1:  # a power loss may leave any bytes in the last line
                break
            raise RecordingError(f"{path}, line {number}: not JSON; repair it, or choose another folder") from None
    return found, sum(len(line) + 1 for line in lines[: len(found)])


def _write(file: int, data: bytes, offset: int) -> None:
    while data:
        written = os.pwrite(file, data, offset)
        data, offset = data[written:], offset + written
    os.fsync(file)
