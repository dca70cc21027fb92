"""The task of `CtrReach-v0`: bring the tip to a point that it can reach under the load that it has."""

from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box, Dict

from core.compiled import compiled
from core.errors import NoSolution
from core.robot.robot import Array
from station.gym.actions import Actions
from station.gym.bodies import Bodies, Bools, Setting

#: Starts and goals that are drawn before a setting is given up: a load beyond what the tubes bear.
MOST_DRAWS = 100


class Reach:
    """So many episodes side by side; the observation is a dictionary as goal-conditioned learners expect it."""

    def __init__(
        self, rows: int, setting: Setting, tolerance: float = 1e-3, reward: Literal["sparse", "dense"] = "sparse"
    ) -> None:
        self.bodies, self.tolerance, self.reward = Bodies(setting, rows), tolerance, reward
        n, reach = self.bodies.lower.size, self.bodies.reach
        self.goals = np.zeros((rows, 3))
        felt = self.bodies.felt_bounds
        place = Box(-reach, reach, dtype=np.float64)
        self.observation_space = Dict(
            observation=Box(-felt, felt, dtype=np.float64),
            achieved_goal=place,
            desired_goal=place,
        )
        self.action_space = Actions(n)

    def reset(self, row: int, random: np.random.Generator) -> None:
        """Begin an episode in this row: robot, load, start and goal are drawn."""
        bodies = self.bodies
        for _ in range(MOST_DRAWS):
            robot, load = bodies.disturbed(random), bodies.drawn_load(random)
            poses = np.array([bodies.drawn_pose(random), bodies.drawn_pose(random)])
            tips = bodies.put(row, robot, poses, load)
            if np.isfinite(tips).all():
                self.goals[row] = tips[1]
                return
        raise NoSolution(f"no start and goal under up to {bodies.setting.load:g} N; is it within reach of the tubes?")

    def observe(self) -> dict[str, Array]:
        """The rows' observations."""
        tips = self.bodies.tips
        return {"observation": self.bodies.felt(), "achieved_goal": tips.copy(), "desired_goal": self.goals.copy()}

    def step(self, actions: Array) -> tuple[Array, dict[str, Array | Bools]]:
        """Rewards (k,) of actions (k, n), and more about each row."""
        self.bodies.move(actions)
        rewards, there = self._judged(self.bodies.tips, self.goals)
        return rewards, {"is_success": there}

    def compute_reward(self, achieved: Array, desired: Array, info: Any = None) -> Any:  # noqa: ARG002 - as learners ask
        """Of tips and goals (..., 3) [m]: 0 within the tolerance, else -1; dense: the distance in mm, negative."""
        here, there = (np.array(places, np.float64, order="C") for places in (achieved, desired))
        rewards, _ = self._judged(here.reshape(-1, 3), there.reshape(-1, 3))
        return rewards.reshape(here.shape[:-1])[()]

    def _judged(self, here: Array, there: Array) -> tuple[Array, Bools]:
        """Rewards (k,) of tips and goals (k, 3), and which are there (k,)."""
        rewards, within = np.empty(len(here)), np.empty(len(here), np.bool_)
        _judge(here, there, self.tolerance, self.reward == "dense", rewards, within)
        return rewards, within

    def marks(self, row: int) -> Array:
        """Points (m, 3) to show [m]."""
        return self.goals[row : row + 1]


@compiled
def _judge(here: Array, there: Array, tolerance: float, dense: bool, rewards: Array, within: Bools) -> None:
    """See `Reach._judged`; in numpy's own functions it takes as long as half a solve for one row."""
    for row in range(here.shape[0]):
        x, y, z = (here[row, 0] - there[row, 0], here[row, 1] - there[row, 1], here[row, 2] - there[row, 2])
        away = np.sqrt(x * x + y * y + z * z)
        within[row] = away <= tolerance
        if dense:
            rewards[row] = -1e3 * away
        else:
            rewards[row] = 0.0 if within[row] else -1.0
