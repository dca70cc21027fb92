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
import re
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from io import TextIOWrapper
from pathlib import Path
from queue import Full, Queue

from core.errors import CtrError
from core.robot.robot import Array
from station.config.strict import Strict
from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from station.regular_file import is_regular, open_regular, open_to_append


class RotatingLog:
    """One rotating log file. It is not thread-safe, but several processes may have it open."""

    def __init__(self, path: Path, limit: int, kept: int) -> None:
        """Open the file, rotate it at `limit` [bytes] and keep `kept` old files.

        Raises:
            OSError: the file cannot be written, or is a link, a FIFO or a device.
        """
        self._path, self._limit, self._kept = path, limit, kept
        self._file = open_to_append(path)

    def add(self, line: str) -> None:
        """Write a line; the line is lost if the disk is full. A file that was removed is created again."""
        with contextlib.suppress(OSError):
            if not self._is_in_place():
                self._open_again()
            self._file.write(f"{line}\n".encode())
            if self._file.tell() >= self._limit:
                self._rotate()

    def last(self, count: int) -> list[str]:
        """Return the last lines, at most `count`, the newest first."""
        lines: deque[str] = deque(maxlen=count)
        for path in (self._older(1), self._path):
            # The older file may not exist yet.
            with contextlib.suppress(OSError), TextIOWrapper(open_regular(path), "utf-8", "replace") as file:
                lines.extend(file)
        return list(reversed(lines))

    def close(self) -> None:
        """Close the file; lines that could not be written are lost."""
        with contextlib.suppress(OSError):
            self._file.close()

    def _is_in_place(self) -> bool:
        """Return whether the open file still has its name; another station may have moved it, or a user removed it."""
        try:
            return os.path.samestat(os.fstat(self._file.fileno()), self._path.lstat())
        except OSError:
            return False

    def _open_again(self) -> None:
        """Open the file again; if that fails, for example because its folder is missing, keep the old file open."""
        with contextlib.suppress(OSError):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            before, self._file = self._file, open_to_append(self._path)
            before.close()

    def _rotate(self) -> None:
        # Another station with the same folder may already have rotated the file.
        if self._is_in_place():
            for number in range(self._kept, 0, -1):
                newer = self._path if number == 1 else self._older(number - 1)
                if os.path.lexists(newer):
                    newer.replace(self._older(number))
        self._open_again()

    def _older(self, number: int) -> Path:
        return self._path.with_name(f"{self._path.stem}.{number}.jsonl")


AUDIT_FILE, REFUSALS_FILE = "audit.jsonl", "refused.jsonl"
#: Size of a log file at which a new file is started [bytes], and number of old files that are kept.
MAX_FILE_BYTES, KEPT_FILES = 2_000_000, 4
#: Longest time that `write` waits for the disk [s]; largest number of entries that wait for a slow disk; longest time
#: that `close` and `tail` wait until these entries are written [s].
DISK_PATIENCE_S, MAX_WAITING, CLOSE_PATIENCE_S = 0.2, 10_000, 2.0
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
    """Audit log in one folder; its methods are thread-safe.

    A separate thread writes, so that no request waits for a disk that does not answer. Usually an entry has been
    written when `write` returns.
    """

    def __init__(self, folder: Path, limit: int = MAX_FILE_BYTES) -> None:
        """Open the log and create its folder if necessary.

        Raises:
            AuditError: the folder or the file cannot be written, or the folder's name is not valid UTF-8.
        """
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
        self._lock = threading.Lock()  # protects the files; only the thread and `tail` use it
        self._waiting: Queue[Callable[[], None]] = Queue(MAX_WAITING)
        self._slow = self._closed = False
        # The end of the interpreter does not wait for a daemon thread.
        self._thread = threading.Thread(target=self._work, name="audit", daemon=True)
        self._thread.start()

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
        caught_up = threading.Event()
        if not self._closed and self._submit(caught_up.set):
            caught_up.wait(CLOSE_PATIENCE_S)
        with self._lock:
            lines = [log.last(count) for log in (self._done, self._refused)]
        entries = [entry for log in lines for line in log if (entry := _entry(line)) is not None]
        now = datetime.now().astimezone()
        whens = {entry.time: datetime.fromisoformat(entry.time) for entry in entries}
        return sorted(entries, key=lambda one: (whens[one.time] <= now, whens[one.time]), reverse=True)[:count]

    def close(self) -> None:
        """Write the waiting entries and close the log files, unless the disk does not answer."""
        if not self._closed:
            self._closed = True
            self._submit(self._end)
            self._thread.join(CLOSE_PATIENCE_S)

    def _add(self, log: RotatingLog, who: str, what: str, where: str, outcome: str) -> None:
        fields = {"who": who, "what": what, "where": where, "outcome": outcome}
        entry = Entry(time=_now(), **{key: text[:MAX_FIELD_CHARS] for key, text in fields.items()})
        line, written = json.dumps(entry.model_dump(), ensure_ascii=True), threading.Event()

        def write() -> None:
            with self._lock:
                log.add(line)
            written.set()

        if not self._closed and self._submit(write) and not self._slow:
            self._slow = not written.wait(DISK_PATIENCE_S)

    def _submit(self, work: Callable[[], None]) -> bool:
        """Queue work for the thread; return whether there was room for it."""
        try:
            self._waiting.put_nowait(work)
        except Full:
            return False
        return True

    def _work(self) -> None:
        with contextlib.suppress(_EndedError):
            while True:
                self._waiting.get()()
                if self._waiting.empty():
                    self._slow = False

    def _end(self) -> None:
        with self._lock:
            self._done.close()
            self._refused.close()
        raise _EndedError


class _EndedError(Exception):
    """The log has been closed."""


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
#: Names of these files: start of the session, number of the failure in it, and state.
_SECONDS_NAME = re.compile(r"\d{8}-\d{6}-\d{3,}-(hold|fault)\.csv")
#: States that a failure causes; the last second of telemetry before them is written to a file.
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
        """Add an event that is no change of state to the audit log, without waiting for the disk."""
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
                kept = f" (telemetry of the last second before it: {path.name})"
            except OSError as error:
                kept = f" (telemetry of the last second before it cannot be written: {error.strerror})"
        if self._audit is not None:
            self._audit.write(STATION, f"state {state.name}", CONTROL_LOOP, f"{cause}{kept}".strip())


def _keep(path: Path, rows: Array, channels: Channels, cause: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    ours = (one for one in path.parent.iterdir() if _SECONDS_NAME.fullmatch(one.name) and is_regular(one))
    for old in sorted(ours)[: -(KEPT_SECONDS_FILES - 1)]:
        old.unlink(missing_ok=True)
    with path.open("x", newline="", encoding="utf-8") as file:
        file.write(f"# {' '.join(cause.split())}\n")
        lines = csv.writer(file)
        lines.writerow([channel.column for channel in channels.all])
        lines.writerows(rows.tolist())
