"""`ctr-station bench setpoints`: delay of a setpoint from a script to the stages' line, on a running station.

    ctr-station bench setpoints

A script streams setpoints of the tip along a circle. A separate lab records when the bytes arrive. Measured with
and without a browser that draws the page.
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
from station.devices.zaber.frame_safety import alias_number
from station.devices.zaber.protocol import SPEED_UNIT, ZaberCommand
from station.service.rig import Rig
from station.service.station_file import load_station

#: Rates of the setpoints [1/s].
SETPOINT_RATES_HZ = (50.0, 100.0, 500.0)
#: Radius and period of the circle [m], [s].
CIRCLE_RADIUS_M, CIRCLE_PERIOD_S = 0.010, 20.0
#: Interval of reading the rows, which are kept for 8 s [s].
POLL_INTERVAL_S = 1.0
#: A run ends without a setpoint for this long; long enough for a busy computer [s].
SILENCE_TIMEOUT_S = 2.0
VELOCITY_COMMANDS = (ZaberCommand.MOVE_SPEED, ZaberCommand.STOP)
#: Limits that keep a late loop running: lateness is measured here.
TOLERANT_OVERRUNS = {"hold_in_a_row": 1000, "hold_share": 1.0, "fault_in_a_row": 5000}


def setpoints(seconds: float, progress: Callable[[float], None]) -> dict[str, Any]:
    """Measure delays at each of `SETPOINT_RATES_HZ`, without and then with the page open, `seconds` in total.

    `hearing` lasts until the server has received the message, `tick` until the next tick, `line` until the line sends
    the next velocity of the axis: each axis gets one every 25 ms. Milliseconds.

    Raises:
        CtrError: the station does not start, or a run ends early.
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
    """Measure one run at `rate` setpoints per second."""
    with Station(station.url) as script:
        script.goto()  # a partial turn ends at another position: repeated runs would move the tip out of its reach
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
            # Without the sender's time: then the server records the time of reception.
            tip.send({"tip": [CIRCLE_RADIUS_M * (math.cos(angle) - 1.0), CIRCLE_RADIUS_M * math.sin(angle), 0.0]})
            if now - last_read > POLL_INTERVAL_S:
                last_read = now
                more, since, _ = ring.read(since)
                rows.append(more)
        time.sleep(0.1)  # by then the last setpoint was used and the line has sent to every axis
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
    """Return when the loop's time was 0, on the station's clock [s]: the last setpoint has both times."""
    latest, row = ring.request(int(ring.counters[RUN])), ring.latest()
    assert latest is not None  # noqa: S101 - the tip has just been streamed
    assert latest.setpoint is not None  # noqa: S101
    assert row is not None  # noqa: S101
    return latest.setpoint.time - float(Channels(bench.robot.robot()).of(row, "request_time")[0])


def _used_setpoints(bench: Rig, rows: Array, start: Array, angles: Array, loop_start: float) -> UsedSetpoint:
    """Return the setpoint that each row's tick has used, identified by the angle of its request."""
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
    """Return when the line started to send the velocities of each axis."""
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
