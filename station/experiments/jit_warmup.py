"""Warm-up before a run: load or compile (JIT) the code of the lab, the drivers and the control law.

A new installation compiles for many seconds. So a second process runs this warm-up while the first process compiles
the model of the robot and checks the motions of the experiment on it.
"""

import math

import numpy as np

from core.control.command import command
from core.control.trajectories import Setpoint
from core.model.solution import at_rest
from station.config.controllers import ControllerFile
from station.config.robots import load_robot
from station.lab.config import LabConfig
from station.lab.virtual_bench import virtual_bench


def warm_up() -> None:
    """Call each compiled function once on the paper's robot; any robot with as many joints uses the same code."""
    robot = load_robot("paper")
    joints = np.array([0.0, 0.5 * math.pi, -0.1])
    controller = ControllerFile().controller(robot)
    rest = at_rest(joints, math.inf, len(robot.tubes))
    estimate = controller.estimator.start(rest, rest, np.zeros(3), np.zeros(3))
    bench = virtual_bench(robot, LabConfig(), 0, joints)
    bench.lab.advance(0.0)
    bench.devices.sensors.connect(0.0)
    bench.lab.advance(0.01)
    bench.devices.sensors.poll(0.01)
    zero, still = np.zeros(3), Setpoint(np.zeros(3), np.zeros(3))
    command(controller.strategy, controller.feedback, controller.limits, joints, estimate, zero, still, zero, zero)
