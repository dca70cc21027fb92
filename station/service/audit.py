"""The audit log: who asked for what, from where, and what came of it; refusals too.

One JSON object a line in `audit.jsonl`, with the wall-clock time. When the file has grown to its limit
it becomes `audit.1.jsonl`, and the oldest of a few such files goes: the log never fills a disk.
"""

import contextlib
import json
import threading
from collections import deque
from datetime import datetime
from pathlib import Path

from core.errors import CtrError
from station.config.strict import Strict

NAME = "audit.jsonl"
#: Size at which a new file is begun [bytes], and how many old ones stay.
LIMIT, KEPT = 2_000_000, 4
#: Longest text of one field; what is longer is cut.
LONGEST = 500


class AuditError(CtrError):
    """The log cannot be written."""


class Entry(Strict):
    """One line of the audit log."""

    time: str
    """ISO 8601 with the zone"""
    who: str
    what: str
    where: str
    outcome: str


class Audit:
    """The log in one folder; any thread may write."""

    def __init__(self, folder: Path, limit: int = LIMIT) -> None:
        """Open the log, making the folder when it is not there.

        Raises:
            AuditError: the folder or the file cannot be written.
        """
        self._path, self._limit = folder / NAME, limit
        self._lock = threading.Lock()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("a", encoding="utf-8")
        except OSError as error:
            raise AuditError(f"{self._path}: the audit log cannot be written: {error.strerror}") from None

    def write(self, who: str, what: str, where: str, outcome: str) -> None:
        """Add a line.

        A full disk does not keep anybody from stopping the robot: what cannot be written is lost.
        """
        told = {"who": who, "what": what, "where": where, "outcome": outcome}
        entry = Entry(time=_now(), **{key: text[:LONGEST] for key, text in told.items()})
        with self._lock:
            try:
                self._file.write(json.dumps(entry.model_dump(), ensure_ascii=True) + "\n")
                self._file.flush()
                if self._file.tell() >= self._limit:
                    self._turn_over()
            except OSError:
                return

    def tail(self, count: int) -> list[Entry]:
        """The last `count` lines at most, the newest first; a damaged line is left out."""
        lines: deque[str] = deque(maxlen=count)
        with self._lock:
            for path in (self._older(1), self._path):
                if path.exists():
                    with path.open(encoding="utf-8", errors="replace") as file:
                        lines.extend(file)
        return [entry for line in reversed(lines) if (entry := _entry(line)) is not None]

    def close(self) -> None:
        """Let go of the file; a line that the disk has not taken goes with it."""
        with self._lock, contextlib.suppress(OSError):
            self._file.close()

    def _turn_over(self) -> None:
        self._file.close()
        for number in range(KEPT, 0, -1):
            newer = self._path if number == 1 else self._older(number - 1)
            if newer.exists():
                newer.replace(self._older(number))
        self._file = self._path.open("a", encoding="utf-8")

    def _older(self, number: int) -> Path:
        return self._path.with_name(f"audit.{number}.jsonl")


def _entry(line: str) -> Entry | None:
    try:
        return Entry(**json.loads(line))
    except (ValueError, TypeError):
        return None  # cut off by a crash


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="milliseconds")
