"""Selects the plant (the simulated real robot) of a virtual lab: the smooth one or the frictional one."""

from typing import Protocol

import numpy as np

from core.robot.robot import Array, Robot
from station.lab.config import PlantConfig
from station.lab.frictional_plant import FrictionalPlant
from station.lab.plant import Plant, PlantState


class TruePlant(Protocol):
    """Interface of a plant: the simulated real robot at the stages' positions."""

    robot: Robot  #: the robot with its true parameters

    @property
    def rotation(self) -> Array:
        """Frame of the innermost tube at the tip (3, 3), world frame."""
        ...

    def advance(self, positions: Array, force: Array, contact: float = np.inf, now: float = 0.0) -> PlantState:
        """Move the joints to `positions` (n,) with `force` (3,) [N] at `contact` [m] until `now` [s]."""
        ...


def true_plant(robot: Robot, config: PlantConfig, rng: np.random.Generator, positions: Array) -> TruePlant:
    """Return the configured plant with its stages at `positions` (n,).

    Raises:
        PoseError, NoSolution: the robot has no equilibrium shape at `positions`.
    """
    return (FrictionalPlant if config.rod == "rough" else Plant)(robot, config, rng, positions)
