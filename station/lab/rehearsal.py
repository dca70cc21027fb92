"""A station's tick rehearsed on a bench in memory, so that nothing is compiled when it counts."""

from dataclasses import replace

import numpy as np

from core.control.leading import BOUNDS, LedTip
from core.control.step import Controller, Sample, begin, step
from core.control.trajectories import JointMotion, Setpoint
from station.config.controllers import PERIOD
from station.config.robots import RobotFile
from station.control.loop import ControlLoop
from station.lab.config import LabConfig
from station.lab.virtual_bench import virtual_bench

#: A bench in memory is READY after less than these [ticks].
TICKS = 1500


def rehearse(robot: RobotFile, config: LabConfig, seed: int, park: tuple[float, ...], controller: Controller) -> None:
    """Compile everything that a tick can reach.

    Args:
        robot: of the station.
        config: of the virtual lab.
        seed: of everything random in it.
        park: joints at power-up [rad or m].
        controller: of the station.
    """
    joints, tubes = np.array(park), len(robot.tubes)
    still = Sample(joints, np.zeros_like(joints), np.zeros((tubes, 6)), np.zeros(3), 0.0)
    memory = begin(controller, still)
    for order in (Setpoint(np.zeros(3), np.zeros(3)), JointMotion(np.zeros_like(joints)), None):
        memory = step(controller, memory, still, order).memory
    for _ in range(2):  # a calibration looks at the direction, controlled or not
        memory = step(replace(controller, watches=True), memory, still, None).memory
    LedTip(BOUNDS).advance(0.0, None, PERIOD)
    # The drivers, too: what a first frame or record compiled later would look like a dead device.
    lab, devices = virtual_bench(robot, config, seed, joints)
    loop = ControlLoop(controller, devices)
    loop.connect(0.0)
    for tick in range(TICKS):
        lab.advance(tick * PERIOD)
        loop.tick(tick * PERIOD)
