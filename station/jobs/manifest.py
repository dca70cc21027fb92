"""Manifest of a list of jobs: a file of JSON lines. The first line is the plan; each further line is a finished job.

Each line is written as soon as its job is done. A kill or a full disk may leave an incomplete last line: a reader
ignores it, the next line overwrites it, and its job is repeated.
"""

import fcntl
import json
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

from station.recording.run_outcome import RecordingError

K = TypeVar("K")
#: JSON object that identifies a list of jobs; its start time `started` [s since 1970] may differ.
Plan = Mapping[str, Any]
#: Line of a finished job.
Row = Mapping[str, Any]
#: Length of the longest value that the message about a difference between two plans shows [characters].
MAX_SHOWN_CHARS = 60


class Manifest(Generic[K]):
    """Manifest that this process writes; the file is locked until it is closed."""

    def __init__(self, path: Path, plan: Plan, key_of: Callable[[Row], K]) -> None:
        """Create the manifest, or continue an existing one.

        Args:
            path: file of the manifest.
            plan: plan of the jobs.
            key_of: returns the key of a row; raises ValueError with the reason if the row is not valid.

        Raises:
            RecordingError: the file has another plan or invalid lines, another process writes it, or the disk is full.
        """
        self.path, self._key_of = path, key_of
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise RecordingError(f"{path}: cannot write results: {error.strerror}") from None
        try:
            self._lock()
            refuse_another(path, read_plan(path), plan)
            stored, self.rows, self._length = read(path, key_of)
            #: Plan with the time of the first start.
            self.plan: Plan = self._append(plan) if stored is None else stored
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __contains__(self, key: object) -> bool:
        return key in self.rows

    def __setitem__(self, key: K, row: Row) -> None:
        """Store the row of a finished job.

        Raises:
            RecordingError: the row is not valid, or the disk is full.
        """
        _key(f"{self.path}: not stored", row, self._key_of)
        self.rows[key] = self._append(row)

    def close(self) -> None:
        """Close and unlock the file."""
        os.close(self._file)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RecordingError(f"{self.path}: another process carries out these jobs; wait until it ends") from None
        except OSError:
            pass  # some file systems of clusters do not support locks

    def _append(self, value: Mapping[str, Any]) -> Mapping[str, Any]:
        """Write a line after the complete lines, and return its value as a reader would parse it."""
        line = json.dumps(value).encode() + b"\n"
        try:
            os.ftruncate(self._file, self._length)  # removes an incomplete last line
            data, offset = line, self._length
            while data:
                written = os.pwrite(self._file, data, offset)
                data, offset = data[written:], offset + written
            os.fsync(self._file)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._file, self._length)
            raise RecordingError(f"{self.path}: cannot be written: {error.strerror}") from None
        self._length += len(line)
        return json.loads(line)


def read_plan(path: Path) -> Plan | None:
    """Return the plan of a manifest; None if the first line is missing or incomplete.

    Raises:
        RecordingError: the file cannot be read, or its first line is not a JSON object.
    """
    try:
        with path.open("rb") as file:
            first = file.readline()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    return _value(path, 1, first) if first.endswith(b"\n") else None


def read(path: Path, key_of: Callable[[Row], K]) -> tuple[Plan | None, dict[K, Row], int]:
    """Return the plan of a manifest, its rows by key, and the length of all complete lines [bytes].

    Raises:
        RecordingError: the file cannot be read, or a line other than the last one is not valid.
    """
    plan, rows = read_plan(path), dict[K, Row]()
    if plan is None:
        return None, rows, 0
    first, *lines = path.read_bytes().split(b"\n")[:-1]
    length = len(first) + 1
    for number, line in enumerate(lines, 2):
        try:
            row = _value(path, number, line)
        except RecordingError:
            if number == 1 + len(lines):  # a power loss may leave any bytes in the last line
                break
            raise
        key = _key(f"{path}, line {number}", row, key_of)
        if key in rows:
            raise RecordingError(f"{path}, line {number}: the job occurs twice")
        rows[key] = row
        length += len(line) + 1
    return plan, rows, length


def difference(stored: Any, requested: Any, name: str = "") -> str:
    """Return a text about the first difference between two plans, or two parts of plans; empty if they are equal."""
    if isinstance(stored, dict) and isinstance(requested, Mapping):
        keys = (key for key in {**stored, **requested} if key != "started")
        parts = (difference(stored.get(key), requested.get(key), f"{name}.{key}".lstrip(".")) for key in keys)
        return next(filter(None, parts), "")
    old, new = json.dumps(stored), json.dumps(requested)
    if old == new:
        return ""
    if max(len(old), len(new)) > MAX_SHOWN_CHARS:
        return f"{name} has changed since"
    return f"{name}: {old} stored, {new} requested"


def refuse_another(path: Path, stored: Plan | None, plan: Plan) -> None:
    """Raise RecordingError with the first difference if the plan that is stored at `path` differs from `plan`."""
    if stored is not None and (text := difference(stored, plan)):
        raise RecordingError(f"{path}: the folder has other results: {text}; choose another folder")


def _value(path: Path, number: int, line: bytes) -> Mapping[str, Any]:
    with suppress(ValueError, RecursionError):
        if isinstance(value := json.loads(line), dict):
            return value
    raise RecordingError(f"{path}, line {number}: not a JSON object; repair it, or choose another folder")


def _key(where: str, row: Row, key_of: Callable[[Row], K]) -> K:
    try:
        return key_of(row)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{where}: {error}") from None
