"""`ctr-station bench setpoints`: delay of a setpoint from a script to the serial line of a running station.

    ctr-station bench setpoints

A script streams setpoints of the tip along a circle. A virtual lab in a separate process records when the bytes arrive
at the stages. The delay is measured without and with a browser that draws the page.
"""

import contextlib
import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.benchmarks.delays import UsedSetpoint, delays, figures, on_the_line
from station.benchmarks.loop import stolen_seconds
from station.benchmarks.noting_lab import Note, NotingLab
from station.benchmarks.served import ServedStation, browser, open_page, serve_station
from station.client import Station
from station.control.ring import MISSED, RUN, Ring
from station.control.telemetry import Channels
from station.devices.zaber.protocol import SPEED_UNIT, ZaberCommand, alias_number
from station.service.rig import Rig
from station.service.station_file import load_station

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
    assert latest is not None  # noqa: S101 - the tip has just been streamed
    assert latest.setpoint is not None  # noqa: S101
    assert row is not None  # noqa: S101
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
