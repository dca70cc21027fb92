"""Compiles the station's control loop before its start by running it on a simulated bench in memory.

Otherwise a tick of the running station would wait for the compiler and be late.
"""

from dataclasses import replace

import numpy as np

from core.control.setpoint_request import DEFAULT_MOTION_BOUNDS, StreamedTip
from core.control.step import Controller, Sample, start_controller, step
from core.control.trajectories import JointMotion, Setpoint
from station.config.controllers import PERIOD_S
from station.config.robots import RobotFile
from station.control.loop import ControlLoop
from station.lab.config import LabConfig
from station.lab.virtual_bench import virtual_bench

#: Largest number of ticks that a bench in memory needs to reach the state READY.
WARMUP_TICKS = 1500


def warm_up_control(
    robot: RobotFile, config: LabConfig, seed: int, park: tuple[float, ...], controller: Controller
) -> None:
    """Compile all code that a tick can call.

    Args:
        robot: robot of the station.
        config: configuration of the virtual lab.
        seed: seed of everything random in the lab.
        park: joint positions at power-up [rad or m].
        controller: controller of the station.
    """
    joints, tubes = np.array(park), len(robot.tubes)
    still = Sample(joints, np.zeros_like(joints), np.zeros((tubes, 6)), np.zeros(3), 0.0)
    memory = start_controller(controller, still)
    for order in (Setpoint(np.zeros(3), np.zeros(3)), JointMotion(np.zeros_like(joints)), None):
        memory = step(controller, memory, still, order).memory
    for _ in range(2):  # with the tip's direction, which a calibration reads even if the direction is not controlled
        memory = step(replace(controller, watches=True), memory, still, None).memory
    StreamedTip(DEFAULT_MOTION_BOUNDS).advance(0.0, None, PERIOD_S)
    # Compile the drivers' code, too: while a driver compiles at its first frame or record, its device would seem dead.
    lab, devices = virtual_bench(robot, config, seed, joints)
    loop = ControlLoop(controller, devices)
    loop.connect(0.0)
    for tick in range(WARMUP_TICKS):
        lab.advance(tick * PERIOD_S)
        loop.tick(tick * PERIOD_S)
