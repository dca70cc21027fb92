"""Carries a procedure out in the virtual lab, with the same control loop and drivers as at a bench."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from core.calibration.measurements import Measurement
from core.robot.robot import Array
from station.calibration.plan import Subject
from station.calibration.procedure import AbortedError, Ask, Guided, Procedure, StoppedByHandError
from station.calibration.visiting import SWINGING, measured, task
from station.config.controllers import BEST, PERIOD
from station.control.clock import Clock
from station.control.loop import ControlLoop
from station.control.states import State
from station.devices.aurora.tracker import Registration
from station.experiments.interrupt import interrupts
from station.lab.config import LabConfig
from station.lab.loads import ConstantLoad, Load, NoLoad
from station.lab.virtual_bench import virtual_bench

Result = TypeVar("Result")
#: Longest wait until the devices are connected [s].
BRING_UP = 60.0


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
        CtrError: what the procedure makes of the measurements.
    """
    guided = Guided(procedure)
    bench, devices = virtual_bench(subject.file, lab, seed, subject.start, registration)
    loop = ControlLoop(BEST.controller(subject.file), devices)
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
                if under_way and not isinstance(step, Ask):
                    answer = measured(loop.channels, np.array(rows), step, at, loop.controller)
                    at = answer.joints if isinstance(answer, Measurement) else answer.joints[-1]
                    guided.answer(answer)
                    rows, under_way = [], False
                    progress(guided.done, "")
                elif isinstance(step, Ask):
                    progress(step.done, step.text)
                    load: Load = ConstantLoad(magnitude=step.weight) if step.weight > 0.0 else NoLoad()
                    bench.apply_load(load, now)
                    free_from = now + SWINGING
                    guided.answer(None)
                else:
                    loop.start(task(step, loop.controller))
                    under_way = True
            elif loop.state not in (State.READY, State.RUNNING) and now > BRING_UP:
                raise AbortedError(f"the devices are {loop.state.name} after {BRING_UP:g} s")
            elif row is not None and under_way:
                rows.append(row)
    if guided.result is None:
        raise AbortedError("the procedure ended without a result")
    return guided.result
