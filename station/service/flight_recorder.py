"""What the station writes down by itself: changes of state in the audit log, and the last second before faults.

All of it in a thread of its own: whoever watches the loop never waits for a disk.
"""

import csv
import itertools
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from core.robot.robot import Array
from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from station.service.audit import Audit

#: As the audit log names it.
STATION, WHERE = "station", "control loop"
#: Folder of the last seconds, rows of one of them at 500 Hz, and how many are kept.
FOLDER, ROWS, KEPT = "last_seconds", 500, 20
#: States that something has led to that was not wanted.
UNWANTED = (State.HOLD, State.FAULT)


class FlightRecorder:
    """Writer of both, as far as there are an audit log and a folder."""

    def __init__(self, ring: Ring, channels: Channels, audit: Audit | None, folder: Path | None, session: str) -> None:
        self._ring, self._channels, self._audit, self._folder = ring, channels, audit, folder
        self._session, self._count = session, 0
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="flight recorder")

    def state(self, state: State, cause: str) -> None:
        """The state has changed; does not wait."""
        rows = None
        if state in UNWANTED and self._folder is not None:
            # Now, before the ring goes on.
            rows, _, _ = self._ring.read(max(0, self._ring.written - ROWS))
            self._count += 1
        self._thread.submit(self._write, state, cause, rows, self._count)

    def note(self, what: str, outcome: str) -> None:
        """Something else for the audit log; does not wait."""
        if self._audit is not None:
            self._thread.submit(self._audit.write, STATION, what, WHERE, outcome)

    def close(self) -> None:
        """Write what is waiting."""
        self._thread.shutdown()

    def _write(self, state: State, cause: str, rows: Array | None, number: int) -> None:
        kept = ""
        if rows is not None and len(rows) and self._folder is not None:
            names = (f"{self._session}-{one:03}-{state.name.lower()}.csv" for one in itertools.count(number))
            # Never over what another station on the same folder has kept.
            path = next(path for name in names if not (path := self._folder / FOLDER / name).exists())
            try:
                _keep(path, rows, self._channels, cause)
                kept = f" (the last second before it: {path.name})"
            except OSError as error:
                kept = f" (the last second before it could not be kept: {error.strerror})"
        if self._audit is not None:
            self._audit.write(STATION, f"state {state.name}", WHERE, f"{cause}{kept}".strip())


def _keep(path: Path, rows: Array, channels: Channels, cause: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    for old in sorted(path.parent.glob("*.csv"))[: -(KEPT - 1)]:
        old.unlink(missing_ok=True)
    with path.open("x", newline="", encoding="utf-8") as file:
        file.write(f"# {' '.join(cause.split())}\n")
        lines = csv.writer(file)
        lines.writerow([channel.column for channel in channels.all])
        lines.writerows(rows.tolist())
