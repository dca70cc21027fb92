"""Which true robot a lab has: the smooth one, or the one that is as hard as a real bench."""

from typing import Protocol

import numpy as np

from core.robot.robot import Array, Robot
from station.lab.config import PlantConfig
from station.lab.plant import Plant, PlantState
from station.lab.rough_plant import RoughPlant


class TruePlant(Protocol):
    """The true robot at the stages' positions."""

    robot: Robot  #: with its own parameters

    @property
    def rotation(self) -> Array:
        """Frame of the innermost tube at the tip (3, 3), world frame."""
        ...

    def advance(self, positions: Array, force: Array, contact: float = np.inf, now: float = 0.0) -> PlantState:
        """Move the joints to `positions` (n,) with `force` (3,) [N] at `contact` [m] until `now` [s]."""
        ...


def true_plant(robot: Robot, config: PlantConfig, rng: np.random.Generator, positions: Array) -> TruePlant:
    """The one that the lab asks for, at `positions` (n,).

    Raises:
        PoseError, NoSolution: it cannot stand there.
    """
    return (RoughPlant if config.rod == "rough" else Plant)(robot, config, rng, positions)
