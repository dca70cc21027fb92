"""A virtual lab with its control loop, whose stages are recorded and whose devices can break."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.control.loop import ControlLoop, Phase
from station.control.states import State
from station.devices.interfaces import Devices, GroundTruth, JointReading, Stages
from station.experiments.experiment import Case
from station.lab.virtual_bench import virtual_bench


@dataclass
class Watched:
    """Stages that pass every command on and record it with its time."""

    stages: Stages
    commands: list[tuple[float, Array]] = field(default_factory=list)
    stops: list[float] = field(default_factory=list)

    def poll(self, now: float) -> JointReading:
        return self.stages.poll(now)

    def command(self, velocities: Array, now: float) -> None:
        self.commands.append((now, velocities))
        self.stages.command(velocities, now)

    def stop(self, now: float) -> None:
        self.stops.append(now)
        self.stages.stop(now)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stages, name)


@dataclass
class Broken:
    """A device whose readings are NaN from a given time on."""

    device: Any
    since: float = math.inf

    def poll(self, now: float) -> Any:
        reading = self.device.poll(now)
        if reading is None or now < self.since:
            return reading
        nan = [np.full_like(part, np.nan) if isinstance(part, np.ndarray) else part for part in reading]
        return type(reading)(*nan)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.device, name)


class Bench:
    """A virtual lab with its control loop, which the test ticks; it keeps the telemetry rows."""

    def __init__(self, case: Case, start: Array | None = None, breaks: str = "") -> None:
        self.lab, devices = virtual_bench(case.robot, case.lab, 0, case.start if start is None else start)
        self.devices = devices
        self.broken = Broken(getattr(devices, breaks)) if breaks else None
        if self.broken is not None:
            devices = replace(devices, **{breaks: self.broken})
        self.stages = Watched(devices.stages)
        self.loop = ControlLoop(case.controller, Devices(self.stages, devices.tracker, devices.sensors))
        self.rows: list[Array] = []
        self.truths: list[GroundTruth] = []
        self.now = -PERIOD_S

    def tick(self, count: int = 1) -> Array | None:
        row = None
        for _ in range(count):
            self.now = round(self.now + PERIOD_S, 9)
            self.truths.append(self.lab.advance(self.now))
            row = self.loop.tick(self.now, self.truths[-1])
            if row is not None:
                self.rows.append(row)
        return row

    def until(self, phase: Phase) -> Array | None:
        """Tick until the run is in the given phase."""
        row = None
        while self.loop.phase is not phase:
            assert self.now < 60.0
            row = self.tick()
        return row

    def ready(self) -> None:
        self.loop.connect(self.now)
        while self.loop.state is not State.READY:
            assert self.now < 10.0, (self.loop.state, self.loop.cause)
            self.tick()
        self.stages.stops.clear()

    def of(self, group: str, rows: list[Array] | None = None) -> Array:
        return self.loop.channels.of(np.array(self.rows if rows is None else rows), group)
