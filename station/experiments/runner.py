"""Runner of one case: the control loop of the real station in the virtual lab, on a real or virtual clock."""

import math
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.config.controllers import PERIOD_S, ControllerFile
from station.config.robots import load_robot
from station.control.clock import Clock
from station.control.loop import ControlLoop
from station.control.realtime import uncollected
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.control.telemetry import Channels
from station.devices.interfaces import with_details
from station.experiments.experiment import Case
from station.jobs.interrupts import interrupts
from station.lab.config import LabConfig
from station.lab.virtual_bench import virtual_bench, warm_up_control

#: Longest time to wait until the devices are connected and the station is READY [s].
CONNECT_TIMEOUT_S = 60.0
#: Value of `cause` in the result of a run that Ctrl-C has ended.
INTERRUPTED = "interrupted"


class Recording(NamedTuple):
    """Result of one run of a case."""

    case: Case
    channels: Channels
    #: Telemetry (ticks, channels) of the motion without its preparation; time counts from the start of the motion.
    #: Empty when the rows were recorded in a file.
    rows: Array
    completed: bool
    cause: str  #: reason why the run did not complete
    simulated_s: float  #: simulated time with the preparation [s]
    wall_s: float  #: elapsed real time [s]
    #: Identity and counters of each device at the end of the run.
    devices: Mapping[str, Any] = MappingProxyType({})
    #: Velocity commands and position polls of each axis during the motion [1/s].
    rates: Mapping[str, Mapping[str, float]] = MappingProxyType({})


def run_case(
    case: Case,
    seed: int,
    clock: Clock,
    progress: Callable[[float], None],
    record: Callable[[Array], None] | None = None,
) -> Recording:
    """Run a case until its motion has ended, the station stops it, or the user presses Ctrl-C.

    Args:
        case: case to run.
        seed: seed of all random numbers in the virtual lab.
        clock: real or virtual clock.
        progress: receives the fraction done, twice in a simulated second.
        record: function that receives each row. With this function no row stays in memory, however long the run is.
    """
    wall = time.perf_counter()
    lab, devices = virtual_bench(case.robot, case.lab, seed, case.start, case.registration, case.views)
    loop = ControlLoop(case.controller, devices)
    rows: list[Array] = []
    # Times of the rows count from the motion's start. Rows in memory are converted together after the run.
    later = np.zeros(len(loop.channels))
    tick, kept, motion_start, cause, started = 0, 0, 0.0, "", False
    counted: Mapping[str, Any] = {}
    loop.connect(0.0)
    try:
        with interrupts() as interrupted, uncollected():
            while True:
                if interrupted():
                    cause = INTERRUPTED
                    break
                now = tick * PERIOD_S
                clock.wait_until(now)
                row = loop.tick(now, lab.advance(now))
                run = loop.progress
                if not started:
                    if loop.state is State.READY:
                        loop.start(MotionTask(case.controller, case.orders, case.file.duration, case.start))
                        started = True
                    elif loop.cause or now > CONNECT_TIMEOUT_S:
                        cause = (
                            with_details(loop.cause, loop.cause_details)
                            or f"{loop.state.name} after {CONNECT_TIMEOUT_S:g} s: {_connect_problem(loop, now)}"
                        )
                        break
                elif run is None:
                    cause = with_details(loop.cause, loop.cause_details)
                    break
                elif run.phase is Phase.SETTLING and motion_start != run.motion_start:
                    motion_start = run.motion_start
                    for group in ("time", "tip_time"):
                        loop.channels.of(later, group)[:] = motion_start
                    lab.apply_load(case.file.load, motion_start)
                    lab.inject(case.file.faults, motion_start)
                elif run.phase is Phase.MOVING and row is not None:
                    if not kept:
                        counted = devices.stages.details()
                    if lab.trouble:
                        cause = f"the simulated robot cannot follow its stages: {lab.trouble}"
                        break
                    if record is None:
                        rows.append(row)
                    else:
                        record(row - later)
                    kept += 1
                tick += 1
                if tick % 250 == 0:
                    progress(loop.part_done(now))
    except CtrError as error:
        cause = str(error)
    table = np.array(rows) - later if rows else np.empty((0, len(loop.channels)))
    details = {kind: device.details() for kind, device in devices.by_kind.items()}
    rates = _rates(counted, details["stages"], kept * PERIOD_S)
    return Recording(
        case, loop.channels, table, not cause, cause, tick * PERIOD_S, time.perf_counter() - wall, details, rates
    )


def _rates(before: Mapping[str, Any], after: Mapping[str, Any], time: float) -> dict[str, dict[str, float]]:
    """Return the velocity commands and position polls of each axis [1/s]."""
    return {
        axis: {f"{kind}_per_s": round((now[kind] - before[axis][kind]) / time, 2) for kind in ("velocities", "polls")}
        for axis, now in after.items()
        if time > 0.0 and axis in before and isinstance(now, Mapping) and "velocities" in now
    }


def _connect_problem(loop: ControlLoop, now: float) -> str:
    """Return the reason why the station is not ready: the faults of its devices, or stages that are not homed."""
    devices = loop.devices
    troubles = [device.trouble(now) for device in devices.by_kind.values()]
    return "; ".join(str(trouble) for trouble in troubles if trouble is not None) or "the stages are not homed"


def warm_up() -> None:
    """Call each compiled function once on the paper's robot; any robot with as many joints uses the same code.

    A new installation compiles for many seconds. So a second process runs this warm-up, while the first one compiles
    the model and checks the motions of the experiment on it. The second process starts with the lab, which does not
    need the model.
    """
    robot, config, park = load_robot("paper"), LabConfig(), (0.0, 0.5 * math.pi, -0.1)
    virtual_bench(robot, config, 0, np.array(park)).lab.advance(0.0)
    warm_up_control(robot, config, 0, park, ControllerFile().controller(robot), all_features=False)
