"""Carries a procedure out in the virtual lab, with the same control loop and drivers as at a bench."""

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from core.calibration.visits import Visit
from core.robot import Array
from core.trajectories import JointMotion
from station.calibration.plan import Subject
from station.calibration.procedure import AbortedError, Ask, GoTo, Guided, Procedure, StoppedByHandError, Swing, Swung
from station.clock import Clock
from station.devices.aurora_tracker import Registration
from station.experiments.experiment import BEST, PERIOD
from station.interrupt import interrupts
from station.lab.config import LabConfig
from station.lab.loads import ConstantLoad, Load, NoLoad
from station.lab.virtual_bench import virtual_bench
from station.loop import ControlLoop
from station.margins import Margins
from station.motions import Orders
from station.rest import SETTLE
from station.states import State
from station.task import Phase, Task
from station.telemetry import Channels

Result = TypeVar("Result")
#: Longest wait until the devices are connected [s].
BRING_UP = 60.0
#: At each rest the loop tares away the weight that hangs, and its model goes on without it; and nothing is calibrated
#: yet. Only a tip that is somewhere else altogether stops a procedure.
MARGINS = Margins(apart=0.12)
#: After a weight was hung or taken off it may swing this long [s].
SWINGING = 2.0


class _Joints:
    """Orders in joints: to and fro from where they are, or nothing at all."""

    def __init__(self, amplitudes: Array, period: float) -> None:
        self._amplitudes, self._rate = amplitudes, 2.0 * math.pi / period

    def at(self, time: float) -> JointMotion:
        # a (1 - cos) / 2: begins and ends at rest where it began
        return JointMotion(0.5 * self._rate * math.sin(self._rate * time) * self._amplitudes)


def carry_out(
    procedure: Procedure[Result], subject: Subject, lab: LabConfig, seed: int, clock: Clock,
    progress: Callable[[float, str], None], registration: Registration | None = None,
) -> Result:  # fmt: skip
    """Run a procedure to its end.

    Args:
        procedure: of `procedures` or `commission`.
        subject: what it is about.
        lab: virtual lab.
        seed: of everything random in the lab.
        clock: real or virtual.
        progress: told the part done and what a person is asked to do.
        registration: where the tracker is believed to stand.

    Raises:
        StoppedByHandError: Ctrl-C.
        AbortedError: the loop stopped; with the reason.
        CtrError: what the procedure makes of the visits.
    """
    guided = Guided(procedure)
    bench, devices = virtual_bench(subject.file, lab, seed, subject.start, registration)
    loop = ControlLoop(BEST.controller(subject.file), devices, MARGINS)
    loop.connect(0.0)
    rows: list[Array] = []
    tick, free_from, under_way, at = 0, 0.0, False, subject.start
    with interrupts() as interrupted:
        while (step := guided.step) is not None:
            now = tick * PERIOD
            clock.wait_until(now)
            row = loop.tick(now, bench.advance(now))
            tick += 1
            if interrupted():
                loop.stop(now)
                guided.abort()
                raise StoppedByHandError(f"interrupted after {100.0 * step.done:.0f} %; nothing was written")
            if loop.cause or bench.trouble:
                guided.abort()
                raise AbortedError(f"stopped after {100.0 * step.done:.0f} %: {loop.cause or bench.trouble}")
            if loop.state is State.READY and now >= free_from:
                if under_way:
                    answer = _answer(loop.channels, np.array(rows), step, at)
                    at = answer.joints if isinstance(answer, Visit) else answer.joints[-1]
                    guided.answer(answer)
                    rows, under_way = [], False
                    progress(guided.done, "")
                elif isinstance(step, Ask):
                    progress(step.done, step.text)
                    load: Load = ConstantLoad(magnitude=step.weight) if step.weight > 0.0 else NoLoad()
                    bench.pull(load, now)
                    free_from = now + SWINGING
                    guided.answer(None)
                else:
                    loop.start(_task(loop, step, subject.start.size))
                    under_way = True
            elif loop.state not in (State.READY, State.RUNNING) and now > BRING_UP:
                raise AbortedError(f"the devices are {loop.state.name} after {BRING_UP:g} s")
            elif row is not None and _counts(loop, now, step):
                rows.append(row)
    if guided.result is None:
        raise AbortedError("the procedure ended without a result")
    return guided.result


def _task(loop: ControlLoop, step: GoTo | Swing, joints: int) -> Task:
    """A visit ends with the rest before its motion, a swing begins there."""
    if isinstance(step, GoTo):
        return Task(loop.controller, cast(Orders, cast(Any, _Joints(np.zeros(joints), 1.0))), 0.0, step.joints)
    orders = cast(Orders, cast(Any, _Joints(step.amplitudes, step.period)))
    return Task(loop.controller, orders, step.duration)


def _counts(loop: ControlLoop, now: float, step: GoTo | Ask | Swing) -> bool:
    """Whether what is measured now belongs to the step: at rest and long enough, or swinging."""
    if isinstance(step, Swing):
        return loop.phase is Phase.MOVING
    progress = loop.progress
    return progress is not None and loop.phase is Phase.SETTLING and now >= progress.settle_start + SETTLE


def _answer(channels: Channels, rows: Array, step: GoTo | Ask | Swing, before: Array) -> Visit | Swung:
    """Averages of rows (m, channels) at rest, or what was recorded of a swing; `before` (n,) is where it came from.

    Raises:
        AbortedError: the tracker saw nothing meanwhile.
    """
    frames = rows[channels.of(rows, "tip_new")[:, 0] > 0.0]
    if len(frames) == 0:
        raise AbortedError("no tracker frame while the robot rested; is the coil inside the tracker's volume?")
    times, joints = channels.of(rows, "time")[:, 0], channels.of(rows, "joints")
    coils = channels.of(frames, "tip_measured")
    if isinstance(step, Swing):
        measured = channels.of(frames, "tip_time")[:, 0]
        # The first frames were measured before the swing began.
        inside = (measured > times[0] + 0.1) & (measured < times[-1])
        return Swung(times, joints, measured[inside], coils[inside])
    wrenches = channels.of(rows, "wrench_raw").mean(axis=0).reshape(-1, 6)
    weight = step.weight if isinstance(step, GoTo) else None
    came = np.sign(joints[-1] - before)
    return Visit(float(times.mean()), joints[-1].copy(), coils.mean(axis=0), wrenches, weight, came)
