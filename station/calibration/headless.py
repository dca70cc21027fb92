"""Carries a procedure out in the virtual lab, with the same control loop and drivers as at a bench."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from core.calibration.visits import Visit
from core.robot import Array
from core.trajectories import JointMotion
from station.calibration.plan import Subject
from station.calibration.procedure import AbortedError, Ask, Guided, Procedure
from station.clock import Clock
from station.experiments.experiment import BEST, PERIOD
from station.interrupt import interrupts
from station.lab.config import LabConfig
from station.lab.loads import ConstantLoad, Load, NoLoad
from station.lab.virtual_bench import virtual_bench
from station.loop import ControlLoop
from station.motions import Orders
from station.rest import SETTLE
from station.states import State
from station.task import Phase, Task
from station.telemetry import Channels

Result = TypeVar("Result")
#: Longest wait until the devices are connected [s].
BRING_UP = 60.0
#: After a weight was hung or taken off it may swing this long [s].
SWING = 2.0


class _StandStill:
    """Orders of a visit: none."""

    def __init__(self, joints: int) -> None:
        self._still = JointMotion(np.zeros(joints))

    def at(self, time: float) -> JointMotion:  # noqa: ARG002 - at any time
        return self._still


def carry_out(
    procedure: Procedure[Result], subject: Subject, lab: LabConfig, seed: int, clock: Clock,
    progress: Callable[[float, str], None],
) -> Result:  # fmt: skip
    """Run a procedure to its end.

    Args:
        procedure: of `procedures`.
        subject: what it is about.
        lab: virtual lab.
        seed: of everything random in the lab.
        clock: real or virtual.
        progress: told the part done and what is going on.

    Raises:
        AbortedError: Ctrl-C, or the loop stopped; with the reason.
        CtrError: what the procedure makes of the visits.
    """
    guided = Guided(procedure)
    bench, devices = virtual_bench(subject.file, lab, seed, subject.start)
    controller = BEST.controller(subject.file)
    loop = ControlLoop(controller, devices)
    orders = cast(Orders, cast(Any, _StandStill(subject.start.size)))
    loop.connect(0.0)
    tick, rows, wait_until, under_way = 0, [], 0.0, False
    with interrupts() as interrupted:
        while (step := guided.step) is not None:
            now = tick * PERIOD
            clock.wait_until(now)
            row = loop.tick(now, bench.advance(now))
            tick += 1
            if interrupted():
                guided.abort()
                loop.stop(now)
                raise AbortedError(f"interrupted after {100.0 * step.done:.0f} %; nothing was written")
            if loop.cause or bench.trouble:
                guided.abort()
                raise AbortedError(f"stopped after {100.0 * step.done:.0f} %: {loop.cause or bench.trouble}")
            if loop.state is State.READY and now >= wait_until:
                if under_way:
                    guided.answer(visit_of(loop.channels, np.array(rows), step))
                    rows, under_way = [], False
                    progress(guided.done, "")
                elif isinstance(step, Ask):
                    progress(step.done, step.text)
                    load: Load = ConstantLoad(magnitude=step.weight) if step.weight > 0.0 else NoLoad()
                    bench.pull(load, now)
                    wait_until = now + SWING
                    guided.answer(None)
                else:
                    loop.start(Task(controller, orders, 0.0, step.joints))
                    under_way = True
            elif loop.state not in (State.READY, State.RUNNING) and now > BRING_UP:
                raise AbortedError(f"the devices are {loop.state.name} after {BRING_UP:g} s")
            elif _averages(loop, now) and row is not None:
                rows.append(row)
    if guided.result is None:
        raise AbortedError("the procedure ended without a result")
    return guided.result


def _averages(loop: ControlLoop, now: float) -> bool:
    """Whether the loop rests, and long enough."""
    progress = loop.progress
    return progress is not None and loop.phase is Phase.SETTLING and now >= progress.settle_start + SETTLE


def visit_of(channels: Channels, rows: Array, step: Any) -> Visit:
    """Averages of rows (m, channels) at rest.

    Raises:
        AbortedError: the tracker saw nothing meanwhile.
    """
    frames = rows[channels.of(rows, "tip_new")[:, 0] > 0.0]
    if len(frames) == 0:
        raise AbortedError("no tracker frame while the robot rested; is the coil inside the tracker's volume?")
    wrenches = channels.of(rows, "wrench_raw").mean(axis=0)
    return Visit(
        float(channels.of(rows, "time").mean()),
        channels.of(rows, "joints")[-1].copy(),
        channels.of(frames, "tip_measured").mean(axis=0),
        wrenches.reshape(-1, 6),
        step.weight,
    )
