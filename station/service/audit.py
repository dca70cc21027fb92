"""Logs of a station in its data folder: the audit log, and the telemetry before a HOLD or FAULT.

Each line of the audit log is a JSON object with the wall-clock time: who sent which request from where, and its
outcome. Executed requests and events are in `audit.jsonl`, refusals in `refused.jsonl`, so that many refusals cannot
displace commands from the log.
"""

import contextlib
import csv
import itertools
import json
import os
import threading
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

from core.errors import CtrError
from core.robot.robot import Array
from station.config.strict import Strict
from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels


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
            # The older file may not exist yet.
            with contextlib.suppress(OSError), path.open(encoding="utf-8", errors="replace") as file:
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


AUDIT_FILE, REFUSALS_FILE = "audit.jsonl", "refused.jsonl"
#: Size of a log file at which a new file is started [bytes], and number of old files that are kept.
MAX_FILE_BYTES, KEPT_FILES = 2_000_000, 4
#: Length at which the text of one field of an entry is cut [characters].
MAX_FIELD_CHARS = 500


class AuditError(CtrError):
    """The audit log cannot be written."""


class Entry(Strict):
    """One line of the audit log."""

    time: str
    """wall-clock time in ISO 8601 with the time zone"""
    who: str
    """name of the client, or of the part of the station, that caused the entry"""
    what: str
    """request or event"""
    where: str
    """address or part of the station that the request or event came from"""
    outcome: str
    """result, or reason of a refusal"""


class Audit:
    """Audit log in one folder; its methods are thread-safe."""

    def __init__(self, folder: Path, limit: int = MAX_FILE_BYTES) -> None:
        """Open the log and create its folder if necessary.

        Raises:
            AuditError: the folder or the file cannot be written, or the folder's name is not valid UTF-8.
        """
        self._lock = threading.Lock()
        try:
            str(folder.absolute()).encode()
            folder.mkdir(parents=True, exist_ok=True)
            self._done, self._refused = (
                RotatingLog(folder / name, limit, KEPT_FILES) for name in (AUDIT_FILE, REFUSALS_FILE)
            )
        except UnicodeEncodeError:
            raise AuditError(
                f"{str(folder)!r}: a folder's name must be UTF-8; rename it or choose another folder"
            ) from None
        except OSError as error:
            raise AuditError(f"{folder / AUDIT_FILE}: the audit log cannot be written: {error.strerror}") from None

    def write(self, who: str, what: str, where: str, outcome: str) -> None:
        """Add an executed request or an event.

        An entry that cannot be written is lost, so that a full disk does not prevent a STOP.
        """
        self._add(self._done, who, what, where, outcome)

    def refused(self, who: str, what: str, where: str, outcome: str) -> None:
        """Add a refused request to the file of refusals; an entry that cannot be written is lost, as in `write`."""
        self._add(self._refused, who, what, where, outcome)

    def tail(self, count: int) -> list[Entry]:
        """Return the last entries, at most `count`, the newest first; damaged lines are skipped.

        The clock may have been set back: entries with a time in the future count as old.
        """
        with self._lock:
            lines = [log.last(count) for log in (self._done, self._refused)]
        entries = [entry for log in lines for line in log if (entry := _entry(line)) is not None]
        now = datetime.now().astimezone()
        whens = {entry.time: datetime.fromisoformat(entry.time) for entry in entries}
        return sorted(entries, key=lambda one: (whens[one.time] <= now, whens[one.time]), reverse=True)[:count]

    def close(self) -> None:
        """Close the log files."""
        with self._lock:
            self._done.close()
            self._refused.close()

    def _add(self, log: RotatingLog, who: str, what: str, where: str, outcome: str) -> None:
        fields = {"who": who, "what": what, "where": where, "outcome": outcome}
        entry = Entry(time=_now(), **{key: text[:MAX_FIELD_CHARS] for key, text in fields.items()})
        with self._lock:
            log.add(json.dumps(entry.model_dump(), ensure_ascii=True))


def _entry(line: str) -> Entry | None:
    try:
        entry = Entry(**json.loads(line))
        return entry if datetime.fromisoformat(entry.time).tzinfo else None
    except (ValueError, TypeError, RecursionError):
        return None  # the line was truncated by a crash


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="milliseconds")


#: Names of the station and of the control loop in the audit log.
STATION, CONTROL_LOOP = "station", "control loop"
#: Folder of the files with the last second of telemetry, number of rows in a file (one second at 500 Hz), and number
#: of files that are kept.
LAST_SECONDS_FOLDER, KEPT_ROWS, KEPT_SECONDS_FILES = "last_seconds", 500, 20
#: States that are caused by a failure; for these a file is written.
FAILURE_STATES = (State.HOLD, State.FAULT)


class FlightRecorder:
    """Writer of state changes to the audit log, and of the last second of telemetry to files; both are optional.

    A separate thread writes, so that the supervision of the control loop never waits for a disk.
    """

    def __init__(self, ring: Ring, channels: Channels, audit: Audit | None, folder: Path | None, session: str) -> None:
        self._ring, self._channels, self._audit, self._folder = ring, channels, audit, folder
        self._session, self._count = session, 0
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="flight recorder")

    def state(self, state: State, cause: str) -> None:
        """Record a change of state without waiting for the disk."""
        rows = None
        if state in FAILURE_STATES and self._folder is not None:
            # Read the rows now, before the ring overwrites them.
            rows, _, _ = self._ring.read(max(0, self._ring.written - KEPT_ROWS))
            self._count += 1
        self._thread.submit(self._write, state, cause, rows, self._count)

    def note(self, what: str, outcome: str) -> None:
        """Add an entry about another event to the audit log without waiting for the disk."""
        if self._audit is not None:
            self._thread.submit(self._audit.write, STATION, what, CONTROL_LOOP, outcome)

    def close(self) -> None:
        """Write the pending entries and end the thread."""
        self._thread.shutdown()

    def _write(self, state: State, cause: str, rows: Array | None, number: int) -> None:
        kept = ""
        if rows is not None and len(rows) and self._folder is not None:
            names = (f"{self._session}-{one:03}-{state.name.lower()}.csv" for one in itertools.count(number))
            # Never overwrite a file of another station with the same folder.
            path = next(path for name in names if not (path := self._folder / LAST_SECONDS_FOLDER / name).exists())
            try:
                _keep(path, rows, self._channels, cause)
                kept = f" (the last second before it: {path.name})"
            except OSError as error:
                kept = f" (the last second before it could not be kept: {error.strerror})"
        if self._audit is not None:
            self._audit.write(STATION, f"state {state.name}", CONTROL_LOOP, f"{cause}{kept}".strip())


def _keep(path: Path, rows: Array, channels: Channels, cause: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    for old in sorted(path.parent.glob("*.csv"))[: -(KEPT_SECONDS_FILES - 1)]:
        old.unlink(missing_ok=True)
    with path.open("x", newline="", encoding="utf-8") as file:
        file.write(f"# {' '.join(cause.split())}\n")
        lines = csv.writer(file)
        lines.writerow([channel.column for channel in channels.all])
        lines.writerows(rows.tolist())
