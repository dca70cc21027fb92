"""The audit log: who sent which request from where, and its outcome, including refusals.

Each line is a JSON object with the wall-clock time. Executed requests and events are in `audit.jsonl`, refusals in
`refused.jsonl`, so that many refusals cannot displace commands from the log.
"""

import json
import threading
from datetime import datetime
from pathlib import Path

from core.errors import CtrError
from station.config.strict import Strict
from station.service.rotating_log import RotatingLog

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
