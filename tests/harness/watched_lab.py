"""The virtual lab in a process of its own that no station owns, and that notes what its stages were told and when.

Times are by a station's clock, which all processes of a machine share: what a stage was told counts from when
the last byte of the message had gone over its line.
"""

import multiprocessing
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from station.control.clock import REAL_TIME, StationClock
from station.control.realtime import ask_for_fifo
from station.devices.zaber.protocol import Status
from station.lab.lab_server import LabServer
from station.service.station_file import load_station
from tests.harness.waiting import NET, until


class Note(NamedTuple):
    """The stages' statuses have changed."""

    time: float  #: [s]
    statuses: tuple[int, ...]

    @property
    def moving(self) -> bool:
        """Whether one has not been told to stop."""
        return any(status not in (Status.IDLE, Status.STOPPING) for status in self.statuses)


class WatchedLab:
    """Use it as a context."""

    def __init__(self, clock: StationClock = REAL_TIME) -> None:
        """`clock`: of the station that will drive it."""
        self.clock = clock
        context = multiprocessing.get_context("spawn")
        self._pipe, child = context.Pipe()
        self._process = context.Process(target=_run, args=(child, clock), name="watched lab")
        self._process.start()
        child.close()
        self.endpoints: Mapping[str, Any] = self._pipe.recv()

    def notes(self) -> list[Note]:
        """All so far."""
        self._pipe.send("notes")
        return self._pipe.recv()

    def moving(self) -> bool:
        """Whether a stage moves now."""
        notes = self.notes()
        return bool(notes) and notes[-1].moving

    def told(self, since: float) -> float:
        """How long after `since` [s], when one was moving, the last stage was told to stop [s]. Waits for it."""
        before = [note for note in self.notes() if note.time <= since]
        assert before, "nothing is known of that time"
        assert before[-1].moving, "no stage was moving then"

        def stopped() -> float | None:
            after = [note for note in self.notes() if note.time > since]
            if not after or after[-1].moving or self.clock.now() - after[-1].time < 0.3:
                return None
            last = max((i for i, note in enumerate(after) if note.moving), default=-1)
            return after[last + 1].time - since

        found = until(stopped, "a stop of every stage")
        assert found is not None
        return found

    def __enter__(self) -> "WatchedLab":
        return self

    def __exit__(self, *_: object) -> None:
        self._pipe.send(None)
        self._process.join(NET)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()
        self._pipe.close()


def _run(pipe: Connection, clock: StationClock) -> None:
    bench = load_station(None).bench()
    notes: list[Note] = []
    with LabServer(bench.robot, bench.lab, 0, np.array(bench.park), homed=True, clock=clock) as lab:
        ask_for_fifo(40)
        pipe.send(lab.endpoints)

        def ended() -> bool:
            statuses = tuple(unit.status for unit in lab.lab.chain.units)
            if not notes or notes[-1].statuses != statuses:
                notes.append(Note(lab.begun + lab.lab.chain.time, statuses))
            while pipe.poll():
                if pipe.recv() is None:
                    return True
                pipe.send(notes)
            return False

        lab.run(ended)
