"""`python -m tests.measure setpoints`: delay of a setpoint from a script to the serial line of a running station.

    python -m tests.measure setpoints

A script streams setpoints of the tip along a circle. A virtual lab in a separate process records when the bytes arrive
at the stages. The delay is measured without and with a browser that draws the page.
"""

import contextlib
import math
import os
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array
from station.benchmarks.loop import stolen_seconds
from station.benchmarks.served import ServedStation, browser, open_page, serve_station
from station.client import Station
from station.control.child_process import ChildProcess
from station.control.realtime import freeze_garbage_collection, request_fifo, set_process_name
from station.control.ring import MISSED, RUN, Ring
from station.control.telemetry import Channels
from station.devices.config import BenchFile
from station.devices.zaber.protocol import MESSAGE_BYTES, MESSAGE_TIME_S, SPEED_UNIT, ZaberCommand, alias_number, decode
from station.lab.lab_server import PRIORITY, LabServer, devices_at
from station.service.station_file import Rig, load_station


class UsedSetpoint(NamedTuple):
    """Setpoints that the ticks of the control loop have used, oldest first; all times are of the same clock [s]."""

    ticks: Array  #: due time of each tick (m,) [s]
    setpoint: NDArray[np.int64]  #: index of the newest setpoint at each tick (m,); -1: none
    received: Array  #: time when the server received this setpoint (m,) [s]
    desired: NDArray[np.int64]  #: desired velocities of the axes (m, n) [units of the stages]
    sent: NDArray[np.int64]  #: velocities sent before each tick (m, n) [units of the stages]


class Delays(NamedTuple):
    """Parts of the delay, with one element for each pair of a used setpoint and an axis [s].

    sent -- hearing --> received -- tick --> tick -- line --> first byte of the axis's next velocity
    """

    hearing: Array  #: time from the sending of the setpoint to its reception by the server
    tick: Array  #: time from the reception to the tick that uses the setpoint
    line: Array  #: time from the tick to the start of the axis's next velocity command on the line (6 bytes, 6.25 ms)

    @property
    def whole(self) -> Array:
        """Whole delay: the sum of the three parts [s]."""
        return self.hearing + self.tick + self.line


def on_the_line(arrivals: Array) -> Array:
    """Return the times at which the serial line starts to transmit messages (m,) that reach it at `arrivals` [s]."""
    starts = np.empty_like(arrivals)
    free = -np.inf
    for number, arrival in enumerate(arrivals):
        starts[number] = max(free, arrival)
        free = starts[number] + MESSAGE_TIME_S
    return starts


def delays(sent_at: Array, used: UsedSetpoint, transmitted: Sequence[Array]) -> Delays:
    """Return the delays of the setpoints that a tick has used.

    A setpoint that was replaced before the next tick is not counted. A setpoint is also not counted for an axis whose
    velocity it leaves unchanged, because no command is sent to this axis.

    Args:
        sent_at: times at which the client sent the setpoints (s,) [s].
        used: setpoints that the control loop has used.
        transmitted: for each axis, times at which the line started to transmit velocity commands [s].
    """
    numbers, first = np.unique(used.setpoint, return_index=True)
    first = first[numbers >= 0]
    found: list[tuple[float, float, float]] = []
    for axis, times in enumerate(transmitted):
        # A row has the velocities that were sent before its tick. So a changed value was sent in the previous tick.
        out = np.flatnonzero(np.diff(used.sent[:, axis]) != 0)
        right = np.flatnonzero(used.desired[:, axis] == used.sent[:, axis])
        for tick in first:
            due, received = float(used.ticks[tick]), float(used.received[tick])
            sent, needless = _next(out, tick), _next(right, tick)
            if sent is None or (needless is not None and needless <= sent):
                continue
            on_line = _next(times, float(used.ticks[int(sent)]))
            if on_line is not None:
                found.append((received - float(sent_at[used.setpoint[tick]]), due - received, float(on_line) - due))
    table = np.array(found).reshape(-1, 3)
    return Delays(table[:, 0], table[:, 1], table[:, 2])


def figures(found: Delays) -> dict[str, Any]:
    """Return median, p99 and maximum of the whole delay and of its parts [ms]."""
    return {
        f"{name}_ms": dict(zip(("median", "p99", "max"), _three(part), strict=True))
        for name, part in (("whole", found.whole), *found._asdict().items())
    }


def _next(among: NDArray[Any], since: float) -> Any:
    """Return the first value of an ascending array that is at least `since`; None if all values are smaller."""
    index = int(np.searchsorted(among, since))
    return among[index] if index < len(among) else None


def _three(part: Array) -> list[float] | list[None]:
    if not part.size:
        return 3 * [None]
    return np.round(1e3 * np.percentile(part, [50, 99, 100]), 2).tolist()


class Note(NamedTuple):
    """Message that has arrived at the stages' end of the serial line."""

    time: float  #: time of arrival on the station's clock [s]
    device: int  #: number or alias of the addressed unit
    command: int
    data: int


class NotingLab:
    """Owner of the lab's process, used in a `with` block; the stages start homed and at the rig's parking pose."""

    def __init__(self, bench: Rig) -> None:
        self._child = ChildProcess(_run, bench, name="noting lab")
        self.devices: BenchFile = devices_at(self._child.pipe.recv(), bench.lab, bench.clock)

    def notes(self) -> list[Note]:
        """Return the messages that have arrived since the previous call."""
        self._child.pipe.send("notes")
        return self._child.pipe.recv()

    def __enter__(self) -> "NotingLab":
        return self

    def __exit__(self, *_: object) -> None:
        self._child.close(2.0)


def _run(bench: Rig, pipe: Connection, _parent: int) -> None:
    """Main function of the lab's process, which ends when the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the measuring process ends it
    set_process_name("ctr-lab")
    notes: list[Note] = []
    part = b""
    with LabServer(bench.robot, bench.lab, bench.seed, np.array(bench.park), homed=True, clock=bench.clock) as lab:
        receive = lab.lab.chain.receive

        def receive_and_note(data: bytes, now: float) -> None:
            nonlocal part
            part += data
            while len(part) >= MESSAGE_BYTES:
                notes.append(Note(bench.clock.now(), *decode(part[:MESSAGE_BYTES])))
                part = part[MESSAGE_BYTES:]
            receive(data, now)

        def answer_requests() -> bool:
            while pipe.poll():
                if _next_request(pipe) is None:
                    return True
                pipe.send(notes.copy())
                notes.clear()
            return False

        lab.lab.chain.receive = receive_and_note
        lab.lab.advance(bench.clock.now() - lab.start_time)  # compile the code now, not during the measurement
        freeze_garbage_collection()
        request_fifo(PRIORITY, in_turns=True)  # as the process of a station's lab does
        pipe.send(lab.endpoints)
        lab.run(answer_requests)


def _next_request(pipe: Connection) -> Any:
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None  # the measuring process has ended


#: Rates at which the script sends setpoints [1/s].
SETPOINT_RATES_HZ = (50.0, 100.0, 500.0)
#: Radius [m] and period [s] of the circle.
CIRCLE_RADIUS_M, CIRCLE_PERIOD_S = 0.010, 20.0
#: Interval at which the script reads the telemetry ring, which keeps the rows of the last 8 s [s].
POLL_INTERVAL_S = 1.0
#: Time without a setpoint after which the tip comes to rest; a busy computer may delay a setpoint so long [s].
SILENCE_TIMEOUT_S = 2.0
VELOCITY_COMMANDS = (ZaberCommand.MOVE_SPEED, ZaberCommand.STOP)
#: Limits for late ticks that never end a run, because this benchmark measures delays on slow computers, too.
TOLERANT_OVERRUNS = {"hold_in_a_row": 1000, "hold_share": 1.0, "fault_in_a_row": 5000}


def setpoints(seconds: float, progress: Callable[[float], None]) -> dict[str, Any]:
    """Measure delays at each of `SETPOINT_RATES_HZ`, without and then with the page open, for `seconds` in total.

    The parts of a delay [ms] are `hearing`, from the sending to the reception by the server; `tick`, from the reception
    to the next tick; and `line`, from the tick to the next velocity command of the axis on the serial line. The line
    carries a command for each axis every 25 ms.

    Raises:
        CtrError: the station does not start, or one of its runs ends early.
    """
    bench = load_station(None).bench()
    showing = browser()
    views = ("no page", "page open")[: 1 if showing is None else 2]
    each = seconds / len(SETPOINT_RATES_HZ) / len(views)
    result: dict[str, Any] = {"seconds_each": round(each, 1)}
    steal = stolen_seconds()
    with (
        tempfile.TemporaryDirectory(prefix="ctr-bench-", ignore_cleanup_errors=True) as name,
        NotingLab(bench) as lab,
        serve_station(
            Path(name), {"devices": lab.devices.model_dump(mode="json"), "overruns": TOLERANT_OVERRUNS}
        ) as station,
        station.ring(bench.robot) as ring,
        contextlib.ExitStack() as opened,
    ):
        for index, view in enumerate(views):
            if view == "page open" and showing is not None:
                opened.enter_context(open_page(station, showing, Path(name, "browser")))
            result[view] = {}
            for number, rate in enumerate(SETPOINT_RATES_HZ):
                result[view][f"{rate:g}/s"] = _streamed_run(bench, station, lab, ring, rate, each)
                progress((index + (number + 1) / len(SETPOINT_RATES_HZ)) / len(views))
    if showing is None:
        result["page open"] = "not measured: Chromium is not installed"
    load = round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None
    return {**result, "load_average": load, "stolen_s": round(stolen_seconds() - steal, 2)}


def _streamed_run(
    bench: Rig, station: ServedStation, lab: NotingLab, ring: Ring, rate: float, seconds: float
) -> dict[str, Any]:
    """Stream `rate` setpoints a second for `seconds`, and return the delays of this run."""
    with Station(station.url) as script:
        script.goto()  # otherwise runs that end within a turn would move the tip out of its reach
    lab.notes()
    since, rows, sent_at, angles = ring.written, list[Array](), list[float](), list[float]()
    with (
        Station(station.url) as script,
        script.setpoints(silence=SILENCE_TIMEOUT_S, end=2.0 * SILENCE_TIMEOUT_S) as tip,
    ):
        last_read, missed = 0.0, int(ring.counters[MISSED])
        for now in tip.every(1.0 / rate, seconds):
            angle = 2.0 * math.pi * now / CIRCLE_PERIOD_S
            angles.append(angle)
            sent_at.append(bench.clock.now())
            # The message has no time of the sender, so the server records the time of reception.
            tip.send({"tip": [CIRCLE_RADIUS_M * (math.cos(angle) - 1.0), CIRCLE_RADIUS_M * math.sin(angle), 0.0]})
            if now - last_read > POLL_INTERVAL_S:
                last_read = now
                more, since, _ = ring.read(since)
                rows.append(more)
        time.sleep(0.1)  # in this time a tick uses the last setpoint, and the line carries a command to every axis
        rows.append(ring.read(since)[0])
        loop_start, missed = _loop_start(ring, bench), int(ring.counters[MISSED]) - missed
        start = np.array(tip.start)
    all_rows, notes = np.concatenate(rows), lab.notes()
    used = _used_setpoints(bench, all_rows, start, np.array(angles), loop_start)
    found = delays(np.array(sent_at), used, _velocity_times(bench, notes))
    return {
        "setpoints": len(sent_at),
        "a_second": round(len(sent_at) / seconds, 1),
        "used_by_a_tick": len(np.unique(used.setpoint[used.setpoint >= 0])),
        "counted": len(found.whole),  # a setpoint counts once for each axis whose velocity it changes
        "periods_missed": missed,
        **figures(found),
    }


def _loop_start(ring: Ring, bench: Rig) -> float:
    """Return the start of the loop's time on the station's clock [s]: the last setpoint has its time on both clocks."""
    latest, row = ring.request(int(ring.counters[RUN])), ring.latest()
    assert latest is not None
    assert latest.setpoint is not None
    assert row is not None
    return latest.setpoint.time - float(Channels(bench.robot.robot()).of(row, "request_time")[0])


def _used_setpoints(bench: Rig, rows: Array, start: Array, angles: Array, loop_start: float) -> UsedSetpoint:
    """Return the setpoint that each tick of `rows` has used; the angle on the circle identifies a setpoint."""
    channels = Channels(bench.robot.robot())
    away = channels.of(rows, "request") - start
    requested = channels.of(rows, "request_kind")[:, 0] == 1.0
    turned = np.unwrap(np.arctan2(away[requested, 1], away[requested, 0] + CIRCLE_RADIUS_M))
    between = 0.5 * (angles[1:] + angles[:-1])
    setpoint = np.full(len(rows), -1)
    setpoint[requested] = np.searchsorted(between, turned)
    received = channels.of(rows, "request_time")[:, 0] + loop_start
    unit = SPEED_UNIT * np.array([joint.microstep for joint in bench.robot.joints])
    desired, sent = (
        np.rint(channels.of(rows, group) / unit).astype(int) for group in ("velocity_commanded", "velocity_sent")
    )
    return UsedSetpoint(rows[:, 0] + loop_start, setpoint, received, desired, sent)


def _velocity_times(bench: Rig, notes: list[Note]) -> list[Array]:
    """Return for each axis the times at which the serial line started to transmit its velocity commands [s]."""
    starts = on_the_line(np.array([note.time for note in notes]))
    return [
        np.array(
            [
                time
                for time, note in zip(starts, notes, strict=True)
                if note.command in VELOCITY_COMMANDS and note.device in (axis + 1, alias_number(axis))
            ]
        )
        for axis in range(len(bench.robot.joints))
    ]
