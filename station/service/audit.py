"""The audit log: who asked for what, from where, and what came of it; refusals too.

One JSON object a line, with the wall-clock time: what was done in `audit.jsonl`, what was refused in `refused.jsonl`,
so that no number of refusals pushes a command out.
"""

import json
import threading
from datetime import datetime
from pathlib import Path

from core.errors import CtrError
from station.config.strict import Strict
from station.service.lines import Lines

NAME, REFUSED = "audit.jsonl", "refused.jsonl"
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
            AuditError: the folder or the file cannot be written, or has a name that is no text.
        """
        self._lock = threading.Lock()
        try:
            str(folder.absolute()).encode()
            folder.mkdir(parents=True, exist_ok=True)
            self._done, self._refused = (Lines(folder / name, limit, KEPT) for name in (NAME, REFUSED))
        except UnicodeEncodeError:
            raise AuditError(f"{str(folder)!r}: a folder's name must be UTF-8; rename it, or give another") from None
        except OSError as error:
            raise AuditError(f"{folder / NAME}: the audit log cannot be written: {error.strerror}") from None

    def write(self, who: str, what: str, where: str, outcome: str) -> None:
        """Add what was done, or has happened.

        A full disk does not keep anybody from stopping the robot: what cannot be written is lost.
        """
        self._add(self._done, who, what, where, outcome)

    def refused(self, who: str, what: str, where: str, outcome: str) -> None:
        """Add what was refused, as in `write`."""
        self._add(self._refused, who, what, where, outcome)

    def tail(self, count: int) -> list[Entry]:
        """The last `count` lines at most, the newest first; a damaged line is left out.

        The clock may have been set back in between: lines that say they come from later than now are old.
        """
        with self._lock:
            lines = [log.last(count) for log in (self._done, self._refused)]
        entries = [entry for log in lines for line in log if (entry := _entry(line)) is not None]
        now = datetime.now().astimezone()
        whens = {entry.time: datetime.fromisoformat(entry.time) for entry in entries}
        return sorted(entries, key=lambda one: (whens[one.time] <= now, whens[one.time]), reverse=True)[:count]

    def close(self) -> None:
        """Let go of the files."""
        with self._lock:
            self._done.close()
            self._refused.close()

    def _add(self, log: Lines, who: str, what: str, where: str, outcome: str) -> None:
        told = {"who": who, "what": what, "where": where, "outcome": outcome}
        entry = Entry(time=_now(), **{key: text[:LONGEST] for key, text in told.items()})
        with self._lock:
            log.add(json.dumps(entry.model_dump(), ensure_ascii=True))


def _entry(line: str) -> Entry | None:
    try:
        entry = Entry(**json.loads(line))
        return entry if datetime.fromisoformat(entry.time).tzinfo else None
    except (ValueError, TypeError, RecursionError):
        return None  # cut off by a crash


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="milliseconds")
