"""Execution of a procedure in the virtual lab, with the same control loop and drivers as on a bench."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TypeVar

import numpy as np

from core.calibration.measurements import Measurement
from core.robot.robot import Array
from station.calibration.plan import PlanSubject
from station.calibration.procedure import (
    SWING_DECAY_S,
    AbortedError,
    GuidedProcedure,
    OperatorPrompt,
    Procedure,
    StoppedByHandError,
    measurement_of,
    task,
)
from station.config.controllers import DEFAULT_CONTROLLER, PERIOD_S
from station.config.loads import ConstantLoad, Load, NoLoad
from station.control.clock import Clock
from station.control.loop import ControlLoop
from station.control.states import State
from station.devices.cameras import CalibratedView
from station.experiments.runner import CONNECT_TIMEOUT_S
from station.jobs.interrupts import interrupts
from station.lab.config import LabConfig
from station.lab.simulated_stages import lab_latency
from station.lab.virtual_bench import virtual_bench

Result = TypeVar("Result")


def run_headless(
    procedure: Procedure[Result], subject: PlanSubject, lab: LabConfig, seed: int, clock: Clock,
    progress: Callable[[float, str], None], views: Mapping[str, CalibratedView] = MappingProxyType({}),
) -> Result:  # fmt: skip
    """Run a procedure to its end and return its result.

    Args:
        procedure: procedure from `procedures` or `commission`.
        subject: robot to calibrate.
        lab: configuration of the virtual lab.
        seed: seed of everything random in the lab.
        clock: real or virtual clock.
        progress: function that receives the completed share and the prompt for the operator.
        views: calibrated lenses and poses of the cameras that measure the tip.

    Raises:
        StoppedByHandError: the operator pressed Ctrl-C.
        AbortedError: the control loop stopped; the message has the reason.
        CtrError: the procedure rejects the measurements.
    """
    guided = GuidedProcedure(procedure)
    bench, devices = virtual_bench(subject.file, lab, seed, subject.start, views=views)
    loop = ControlLoop(
        DEFAULT_CONTROLLER.controller(subject.file, latency=lab_latency(lab.stages, subject.file)), devices
    )
    loop.connect(0.0)
    rows: list[Array] = []
    tick, free_from, under_way, at = 0, 0.0, False, subject.start
    with interrupts() as interrupted:
        while (step := guided.step) is not None:
            now = tick * PERIOD_S
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
                if under_way and not isinstance(step, OperatorPrompt):
                    answer = measurement_of(loop.channels, np.array(rows), step, at, loop.controller)
                    at = answer.joints if isinstance(answer, Measurement) else answer.joints[-1]
                    guided.answer(answer)
                    rows, under_way = [], False
                    progress(guided.done, "")
                elif isinstance(step, OperatorPrompt):
                    progress(step.done, step.text)
                    load: Load = ConstantLoad(magnitude=step.weight) if step.weight > 0.0 else NoLoad()
                    bench.apply_load(load, now)
                    free_from = now + SWING_DECAY_S
                    guided.answer(None)
                else:
                    loop.start(task(step, loop.controller))
                    under_way = True
            elif loop.state not in (State.READY, State.RUNNING) and now > CONNECT_TIMEOUT_S:
                raise AbortedError(f"the devices are {loop.state.name} after {CONNECT_TIMEOUT_S:g} s")
            elif row is not None and under_way:
                rows.append(row)
    return guided.outcome()
