"""The virtual lab: the plant, what pulls at it and the simulated devices around it."""

import numpy as np

from core.robot import Array
from station.devices.interfaces import Devices, Truth
from station.lab.config import LabConfig
from station.lab.devices import SimulatedBaseSensors, SimulatedStages, SimulatedTracker
from station.lab.loads import Load, NoLoad
from station.lab.plant import Plant
from station.robots import RobotFile


class VirtualLab:
    """A bench that is not there. Everything random comes from `seed`."""

    def __init__(self, robot: RobotFile, config: LabConfig, seed: int, positions: Array) -> None:
        # One stream for each part, so that another part does not change what this one draws.
        plant, tracker, sensors = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
        description = robot.robot()
        self.time = 0.0  #: [s]
        self._plant = Plant(description, config.plant, plant, positions)
        self._stages = SimulatedStages(robot.joints, config.line, positions)
        self._tracker = SimulatedTracker(config.tracker, tracker)
        self._sensors = SimulatedBaseSensors(config.sensors, len(description.tubes), sensors)
        self._load: Load = NoLoad()
        self._load_start = 0.0
        self.devices = Devices(self._stages, self._tracker, self._sensors)
        self.truth: Truth
        self.truth, wrenches = self._plant.advance(positions, np.zeros(3))
        self._sensors.advance(wrenches)

    def pull(self, load: Load, start: float) -> None:
        """Put a load on the tip whose time counts from `start` [s]."""
        self._load, self._load_start = load, start

    def advance(self, now: float) -> Truth:
        """Let time pass until `now` [s]."""
        before = self.truth.tip
        self._stages.advance(self.time, now)
        self.truth, wrenches = self._plant.advance(self._stages.positions, self._load.force(now - self._load_start))
        self._tracker.advance(self.time, now, before, self.truth.tip)
        self._sensors.advance(wrenches)
        self.time = now
        return self.truth
