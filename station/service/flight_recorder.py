"""The flight recorder: write changes of state to the audit log, and telemetry before a HOLD or FAULT to a file.

The file has the last second of telemetry. A separate thread writes, so that the supervision of the loop never waits for
a disk.
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

#: Names of the station and of the control loop in the audit log.
STATION, CONTROL_LOOP = "station", "control loop"
#: Folder of the files with the last second of telemetry, number of rows in a file (one second at 500 Hz), and number
#: of files that are kept.
LAST_SECONDS_FOLDER, KEPT_ROWS, KEPT_FILES = "last_seconds", 500, 20
#: States that are caused by a failure; for these a file is written.
FAILURE_STATES = (State.HOLD, State.FAULT)


class FlightRecorder:
    """Writer of state changes to the audit log, and of the last second of telemetry to files; both are optional."""

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
    for old in sorted(path.parent.glob("*.csv"))[: -(KEPT_FILES - 1)]:
        old.unlink(missing_ok=True)
    with path.open("x", newline="", encoding="utf-8") as file:
        file.write(f"# {' '.join(cause.split())}\n")
        lines = csv.writer(file)
        lines.writerow([channel.column for channel in channels.all])
        lines.writerows(rows.tolist())
