"""A closed loop at 500 Hz: a controller and an exact rod with ideal sensors, whose joints follow without delay."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from core.control.controller_settings import Controller
from core.control.step import ControllerState, Sample, Tick, set_origin, start_controller, step
from core.control.trajectories import JointMotion, Setpoint
from core.model.cosserat import ExactRod, Rod
from core.robot.robot import Array, Robot

PERIOD = 0.002
#: Ticks between two frames of the tracker.
FRAME_TICKS = 13
HERE = Setpoint(np.zeros(3), np.zeros(3))


class ExactPlant:
    """Simulated robot; joint 0 turns the outer tube, which carries the whole load."""

    def __init__(self, robot: Robot, joints: Array) -> None:
        self.rod, self.robot, self.joints = ExactRod(robot, step=0.02), robot, joints.copy()
        self.sent, self.force = np.zeros(joints.size), np.zeros(3)
        self.rest = self.now = self.rod.solve(self.joints, np.zeros(6))  #: shape without load, and the present one

    def solved(self) -> Rod:
        self.now = self.rod.solve(self.joints, np.r_[self.force, np.zeros(3)], self.now)
        return self.now

    def sample(self, frame: bool = True) -> Sample:
        """Return a sample of all sensors; the wrench is in the axes of the outer tube."""
        rod, angle = self.solved(), self.joints[0]
        turn = np.array([[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1.0]])
        wrenches = np.zeros((len(self.robot.tubes), 6))
        wrenches[-1] = np.r_[turn @ self.force, turn @ np.cross(rod.tip, self.force)]
        tip, axis = (rod.tip, rod.rotation[:, 2]) if frame else (None, None)
        return Sample(self.joints.copy(), self.sent, wrenches, tip, 0.0, axis)

    def obey(self, command: Array) -> None:
        self.sent = command
        self.joints = self.joints + PERIOD * command


class ClosedLoop(NamedTuple):
    """Ticks of a closed loop."""

    ticks: list[Tick]
    orders: list[Setpoint | JointMotion]
    rods: list[Rod]  #: true shape at the sample of each tick
    tips: Array  #: true tip at the sample of each tick, from the start tip (ticks, 3) [m]
    memory: ControllerState


def run(
    unit: Controller, plant: ExactPlant, seconds: float,
    order: Callable[[float], Setpoint | JointMotion] = lambda _: HERE,
    force: Callable[[float], Array] = lambda _: np.zeros(3),
) -> ClosedLoop:  # fmt: skip
    """Run a closed loop with orders and forces by time."""
    memory = start_controller(unit, plant.sample())
    memory = set_origin(unit, memory, plant.now.tip)
    start, ticks, orders, rods = plant.now.tip, list[Tick](), list[Setpoint | JointMotion](), list[Rod]()
    for number in range(round(seconds / PERIOD)):
        plant.force = force(number * PERIOD)
        orders.append(order(number * PERIOD))
        ticks.append(step(unit, memory, plant.sample(number % FRAME_TICKS == 0), orders[-1]))
        memory = ticks[-1].memory
        rods.append(plant.now)
        plant.obey(ticks[-1].command)
    return ClosedLoop(ticks, orders, rods, np.array([rod.tip for rod in rods]) - start, memory)
