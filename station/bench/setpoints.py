"""How long a setpoint takes from a script to the stages' line, on a station that really runs.

    ctr-station bench setpoints

A script leads the tip along a circle, message by message; a lab of the bench's own notes when the bytes come. With
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
from station.bench.delays import Used, delays, figures, on_the_line
from station.bench.loop import stolen
from station.bench.noting_lab import Note, NotingLab
from station.bench.served import Served, browser, page_of, served
from station.client import Station
from station.control.ring import MISSED, RUN, Ring
from station.control.telemetry import Channels
from station.devices.zaber.protocol import SPEED_UNIT, Command
from station.devices.zaber.shifts import alias
from station.service.bench import Bench
from station.service.station_file import load_station

#: Setpoints a second.
RATES = (50.0, 100.0, 500.0)
#: The circle [m], [s].
RADIUS, TURN = 0.010, 20.0
#: Between two looks at the rows, which are kept for 8 s [s].
LOOK = 1.0
#: Without a word for so long a run ends; a busy computer may take that [s].
SILENCE = 2.0
VELOCITIES = (Command.MOVE_SPEED, Command.STOP)
#: Lateness is measured here and ends no run.
OVERRUNS = {"hold_in_a_row": 1000, "hold_share": 1.0, "fault_in_a_row": 5000}


def setpoints(seconds: float, progress: Callable[[float], None]) -> dict[str, Any]:
    """Delays at each of `RATES`, first without and then with the page open, `seconds` in all.

    `hearing` is until the server has taken the message in, `tick` until the next tick, `line` until the line takes up
    the next velocity of the axis: one axis's turn comes every 25 ms. Milliseconds.

    Raises:
        CtrError: the station does not start, or a run ends by itself.
    """
    bench = load_station(None).bench()
    showing = browser()
    views = ("no page", "page open")[: 1 if showing is None else 2]
    each = seconds / len(RATES) / len(views)
    result: dict[str, Any] = {"seconds_each": round(each, 1)}
    steal = stolen()
    with (
        tempfile.TemporaryDirectory(prefix="ctr-bench-", ignore_cleanup_errors=True) as name,
        NotingLab(bench) as lab,
        served(Path(name), {"devices": lab.devices.model_dump(mode="json"), "overruns": OVERRUNS}) as station,
        station.ring(bench.robot) as ring,
        contextlib.ExitStack() as opened,
    ):
        for place, view in enumerate(views):
            if view == "page open" and showing is not None:
                opened.enter_context(page_of(station, showing, Path(name, "browser")))
            result[view] = {}
            for number, rate in enumerate(RATES):
                result[view][f"{rate:g}/s"] = _led(bench, station, lab, ring, rate, each)
                progress((place + (number + 1) / len(RATES)) / len(views))
    if showing is None:
        result["page open"] = "not measured: there is no Chromium here"
    load = round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None
    return {**result, "load_average": load, "stolen_s": round(stolen() - steal, 2)}


def _led(bench: Bench, station: Served, lab: NotingLab, ring: Ring, rate: float, seconds: float) -> dict[str, Any]:
    """One run at that many setpoints a second."""
    with Station(station.url) as script:
        script.goto()  # a part of a turn ends elsewhere: one run after the other would lead the tip out of its reach
    lab.notes()
    since, rows, said, angles = ring.written, list[Array](), list[float](), list[float]()
    with Station(station.url) as script, script.setpoints(silence=SILENCE, end=2.0 * SILENCE) as tip:
        looked, missed = 0.0, int(ring.counters[MISSED])
        for now in tip.every(1.0 / rate, seconds):
            angle = 2.0 * math.pi * now / TURN
            angles.append(angle)
            said.append(bench.clock.now())
            # Without the sender's time: the server then notes when it has really come.
            tip.say({"tip": [RADIUS * (math.cos(angle) - 1.0), RADIUS * math.sin(angle), 0.0]})
            if now - looked > LOOK:
                looked = now
                more, since, _ = ring.read(since)
                rows.append(more)
        time.sleep(0.1)  # the last one has been used by now, and the line has had every axis's turn
        rows.append(ring.read(since)[0])
        begun, missed = _begun(ring, bench), int(ring.counters[MISSED]) - missed
        start = np.array(tip.start)
    all_rows, notes = np.concatenate(rows), lab.notes()
    used = _used(bench, all_rows, start, np.array(angles), begun)
    found = delays(np.array(said), used, _heard(bench, notes))
    return {
        "setpoints": len(said),
        "a_second": round(len(said) / seconds, 1),
        "used_by_a_tick": len(np.unique(used.setpoint[used.setpoint >= 0])),
        "counted": len(found.whole),  # a setpoint counts once for each axis that it moves otherwise
        "periods_missed": missed,
        **figures(found),
    }


def _begun(ring: Ring, bench: Bench) -> float:
    """When the loop's time was 0, by the station's clock [s]: the last setpoint's time is known by both."""
    asked, row = ring.asked(int(ring.counters[RUN])), ring.latest()
    assert asked is not None  # noqa: S101 - somebody has just led the tip
    assert asked.wish is not None  # noqa: S101
    assert row is not None  # noqa: S101
    return asked.wish.asked - float(Channels(bench.robot.robot()).of(row, "asked_time")[0])


def _used(bench: Bench, rows: Array, start: Array, angles: Array, begun: float) -> Used:
    """Which setpoint each row's tick has known: the one at the angle at which it was asked to be."""
    channels = Channels(bench.robot.robot())
    away = channels.of(rows, "asked") - start
    asked = channels.of(rows, "asked_kind")[:, 0] == 1.0
    turned = np.unwrap(np.arctan2(away[asked, 1], away[asked, 0] + RADIUS))
    between = 0.5 * (angles[1:] + angles[:-1])
    setpoint = np.full(len(rows), -1)
    setpoint[asked] = np.searchsorted(between, turned)
    told = channels.of(rows, "asked_time")[:, 0] + begun
    unit = SPEED_UNIT * np.array([joint.microstep for joint in bench.robot.joints])
    wanted, sent = (
        np.rint(channels.of(rows, group) / unit).astype(int) for group in ("velocity_commanded", "velocity_sent")
    )
    return Used(rows[:, 0] + begun, setpoint, told, wanted, sent)


def _heard(bench: Bench, notes: list[Note]) -> list[Array]:
    """When the line took up the velocities of each axis."""
    begun = on_the_line(np.array([note.time for note in notes]))
    return [
        np.array(
            [
                time
                for time, note in zip(begun, notes, strict=True)
                if note.command in VELOCITIES and note.device in (axis + 1, alias(axis))
            ]
        )
        for axis in range(len(bench.robot.joints))
    ]
