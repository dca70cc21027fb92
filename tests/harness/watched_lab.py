"""A virtual lab in a separate process that records which commands its stages received and when.

Times are those of a station's clock, which all processes of a computer share. A stage has received a command when the
last byte of the message has passed its line.
"""

import multiprocessing
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from station.config.robots import load_robot
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.realtime import request_fifo
from station.devices.zaber.protocol import ZaberStatus
from station.lab.config import LabConfig, StagesKind, load_lab
from station.lab.lab_server import LabServer
from station.service.station_file import load_station
from tests.harness.waiting import NET, until

#: Time without a step after which the stages are at rest [s].
REST_S = 0.6


class Note(NamedTuple):
    """A change of the stages' statuses."""

    time: float  #: time of the change [s]
    statuses: tuple[int, ...]

    @property
    def moving(self) -> bool:
        """Whether a stage moves and has received no command to stop."""
        return any(status not in (ZaberStatus.IDLE, ZaberStatus.STOPPING) for status in self.statuses)


class WatchedLab:
    """Handle of the lab's process; it is a context manager."""

    def __init__(
        self, clock: StationClock = REAL_TIME_CLOCK, stages: StagesKind = "zaber", lab: str = "gentle"
    ) -> None:
        """`clock`: clock of the station that will drive the lab. `stages`: kind of the stages of the lab `lab`."""
        self.clock = clock
        self.config = load_lab(lab, load_robot("paper")).model_copy(update={"stages": stages})
        context = multiprocessing.get_context("spawn")
        self._pipe, child = context.Pipe()
        self._process = context.Process(target=_run, args=(child, clock, self.config), name="watched lab")
        self._process.start()
        child.close()
        self.endpoints: Mapping[str, Any] = self._pipe.recv()

    def notes(self) -> list[Note]:
        """Return all recorded changes of the stages' statuses."""
        self._pipe.send("notes")
        return self._pipe.recv()

    def moving(self) -> bool:
        """Return whether a stage moves now and has received no command to stop."""
        notes = self.notes()
        return bool(notes) and notes[-1].moving

    def last_step(self) -> float:
        """Return the time at which a stage of any kind moved last, by at least a microstep [s]; 0 before that."""
        self._pipe.send("last step")
        return self._pipe.recv()

    def rest_after(self, since: float) -> float:
        """Wait until no stage has moved for a while; return the time from `since` to the last step [s]."""
        until(lambda: self.clock.now() - max(since, self.last_step()) > REST_S, "rest of every stage")
        return max(0.0, self.last_step() - since)

    def stop_delay(self, since: float) -> float:
        """Wait until all stages, one of which moved at `since` [s], must stop; return the time after `since` [s]."""
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


def _run(pipe: Connection, clock: StationClock, config: LabConfig) -> None:
    bench = load_station(None).bench()
    notes: list[Note] = []
    counts, last_step = tuple[int, ...](), 0.0
    zaber = config.stages == "zaber"
    with LabServer(bench.robot, config, 0, np.array(bench.park), homed=True, clock=clock) as lab:
        request_fifo(40)
        pipe.send(lab.endpoints)

        def ended() -> bool:
            nonlocal counts, last_step
            now = tuple(round(unit.true_position) for unit in lab.lab.chain.units)
            if now != counts:
                last_step = lab.start_time + lab.lab.time if counts else 0.0
                counts = now
            statuses = tuple(unit.status for unit in lab.lab.chain.units) if zaber else ()
            if not notes or notes[-1].statuses != statuses:
                notes.append(Note(lab.start_time + lab.lab.chain.time, statuses))
            while pipe.poll():
                if (asked := pipe.recv()) is None:
                    return True
                pipe.send(last_step if asked == "last step" else notes)
            return False

        lab.run(ended)
