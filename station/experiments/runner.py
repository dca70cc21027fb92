"""Carries out one case in the virtual lab: the same control loop as at a bench, on any clock."""

import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.controllers import PERIOD
from station.control.clock import Clock
from station.control.loop import ControlLoop
from station.control.realtime import uncollected
from station.control.states import State
from station.control.task import Phase, Task
from station.control.telemetry import Channels
from station.experiments.experiment import Case
from station.experiments.interrupt import interrupts
from station.lab.virtual_bench import virtual_bench

#: Longest wait until the devices are connected and the controller has begun [s].
BRING_UP = 60.0
#: Why a run did not complete that Ctrl-C has ended.
INTERRUPTED = "interrupted"


class Recording(NamedTuple):
    """What a case left behind."""

    case: Case
    channels: Channels
    #: (ticks, channels) of the motion, without its preparation; time counts from its start. None if recorded.
    rows: Array
    completed: bool
    cause: str  #: why it did not complete
    simulated_s: float  #: preparation included
    wall_s: float
    #: Of each device at the end: who it is and what it has counted; and of each axis that says so, the
    #: velocities and polls a second that it got during the motion.
    devices: Mapping[str, Any] = MappingProxyType({})
    rates: Mapping[str, Mapping[str, float]] = MappingProxyType({})


def run_case(
    case: Case,
    seed: int,
    clock: Clock,
    progress: Callable[[float], None],
    record: Callable[[Array], None] | None = None,
) -> Recording:
    """Run to the end, to a stop, or to Ctrl-C.

    Args:
        case: what to run.
        seed: of everything random in the virtual lab.
        clock: real or virtual.
        progress: told the fraction done, twice a simulated second.
        record: given each row as it comes; then none is kept in memory, however long the run is.
    """
    wall = time.perf_counter()
    lab, devices = virtual_bench(case.robot, case.lab, seed, case.start, case.registration)
    loop = ControlLoop(case.controller, devices)
    rows: list[Array] = []
    keep = rows.append if record is None else record
    later = np.zeros(len(loop.channels))  # what is taken off a row, for times to count from the motion's start
    tick, kept, motion_start, cause, begun = 0, 0, 0.0, "", False
    counted: Mapping[str, Any] = {}
    loop.connect(0.0)
    try:
        with interrupts() as interrupted, uncollected():
            while True:
                if interrupted():
                    cause = INTERRUPTED
                    break
                now = tick * PERIOD
                clock.wait_until(now)
                row = loop.tick(now, lab.advance(now))
                if not begun:
                    if loop.state is State.READY:
                        loop.start(Task(case.controller, case.orders, case.file.duration, case.start))
                        begun = True
                    elif loop.cause or now > BRING_UP:
                        cause = loop.cause or f"{loop.state.name} after {BRING_UP:g} s: {_waiting_for(loop, now)}"
                        break
                elif loop.progress is None:
                    cause = loop.cause
                    break
                elif loop.phase is Phase.SETTLING and motion_start == 0.0 and loop.progress is not None:
                    motion_start = loop.progress.motion_start
                    for group in ("time", "tip_time"):
                        loop.channels.of(later, group)[:] = motion_start
                    lab.apply_load(case.file.load, motion_start)
                    lab.inject(case.file.faults, motion_start)
                elif loop.phase is Phase.MOVING and row is not None:
                    if not kept:
                        counted = devices.stages.details()
                    if lab.trouble:
                        cause = f"the simulated robot cannot follow its stages: {lab.trouble}"
                        break
                    keep(row - later)
                    kept += 1
                tick += 1
                if tick % 250 == 0:
                    progress(loop.part_done(now))
    except CtrError as error:
        cause = str(error)
    table = np.array(rows) if rows else np.empty((0, len(loop.channels)))
    said = {name: getattr(devices, name).details() for name in ("stages", "tracker", "sensors")}
    rates = _rates(counted, said["stages"], kept * PERIOD)
    return Recording(
        case, loop.channels, table, not cause, cause, tick * PERIOD, time.perf_counter() - wall, said, rates
    )


def _rates(before: Mapping[str, Any], after: Mapping[str, Any], time: float) -> dict[str, dict[str, float]]:
    """Velocities and polls a second of each axis."""
    return {
        axis: {f"{kind}_per_s": round((now[kind] - before[axis][kind]) / time, 2) for kind in ("velocities", "polls")}
        for axis, now in after.items()
        if time > 0.0 and axis in before and isinstance(now, Mapping) and "velocities" in now
    }


def _waiting_for(loop: ControlLoop, now: float) -> str:
    """What keeps the bench from coming up."""
    devices = loop.devices
    troubles = [device.trouble(now) for device in (devices.stages, devices.tracker, devices.sensors)]
    return "; ".join(trouble.text for trouble in troubles if trouble is not None) or "the stages are not homed"
