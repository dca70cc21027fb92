"""Task of the environment `CtrReach-v0`: move the tip to a goal that it can reach under the load."""

from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box, Dict

from core.compiled import compiled
from core.errors import NoSolution
from core.robot.robot import Array
from station.gym.bodies import Actions, Bools, EpisodeSettings, RobotBatch

#: Largest number of random pairs of start and goal that are drawn. If none is valid, the load is too large.
MAX_DRAWS = 100


class Reach:
    """Task of reaching a goal, with parallel episodes.

    The observation is a dictionary, because goal-conditioned learning algorithms require one.
    """

    def __init__(
        self,
        rows: int,
        setting: EpisodeSettings,
        tolerance: float = 1e-3,
        reward: Literal["sparse", "dense"] = "sparse",
    ) -> None:
        self.bodies, self.tolerance, self.reward = RobotBatch(setting, rows), tolerance, reward
        n, reach = self.bodies.lower.size, self.bodies.reach
        self.goals = np.zeros((rows, 3))
        bounds = self.bodies.observation_bounds
        position = Box(-reach, reach, dtype=np.float64)
        self.observation_space = Dict(
            observation=Box(-bounds, bounds, dtype=np.float64), achieved_goal=position, desired_goal=position
        )
        self.action_space = Actions(n)

    def reset(self, row: int, random: np.random.Generator) -> None:
        """Start an episode in this row with a random robot, load, start and goal."""
        bodies = self.bodies
        for _ in range(MAX_DRAWS):
            robot, load = bodies.disturb_robot(random), bodies.draw_load(random)
            poses = np.array([bodies.draw_pose(random), bodies.draw_pose(random)])
            tips = bodies.put(row, robot, poses, load)
            if np.isfinite(tips).all():
                self.goals[row] = tips[1]
                return
        raise NoSolution(f"no start and goal with a solution under up to {bodies.setting.load:g} N; reduce the load")

    def observe(self) -> dict[str, Array]:
        """Return the observations of all rows."""
        tips = self.bodies.tips
        return {"observation": self.bodies.observe(), "achieved_goal": tips.copy(), "desired_goal": self.goals.copy()}

    def step(self, actions: Array) -> tuple[Array, dict[str, Array | Bools]]:
        """Carry out actions (k, n); return the reward of each row (k,), and whether its goal is reached."""
        self.bodies.move(actions)
        rewards, there = self._evaluate(self.bodies.tips, self.goals)
        return rewards, {"is_success": there}

    def compute_reward(self, achieved: Array, desired: Array, info: Any = None) -> Any:  # noqa: ARG002 - for learners
        """Return rewards for tips and goals (..., 3) [m]: 0 within the tolerance, else -1; if dense: -distance [mm]."""
        here, there = (np.array(points, np.float64, order="C") for points in (achieved, desired))
        rewards, _ = self._evaluate(here.reshape(-1, 3), there.reshape(-1, 3))
        return rewards.reshape(here.shape[:-1])[()]

    def _evaluate(self, here: Array, there: Array) -> tuple[Array, Bools]:
        """Return rewards (k,) for tips and goals (k, 3) [m], and which tips are within the tolerance (k,)."""
        rewards, within = np.empty(len(here)), np.empty(len(here), np.bool_)
        _judge(here, there, self.tolerance, self.reward == "dense", rewards, within)
        return rewards, within

    def marks(self, row: int) -> Array:
        """Return the points (m, 3) that a picture of this row marks [m]: the goal."""
        return self.goals[row : row + 1]


@compiled
def _judge(here: Array, there: Array, tolerance: float, dense: bool, rewards: Array, within: Bools) -> None:
    """Write the results of `Reach._evaluate` into `rewards` and `within`.

    It is compiled, because for one row numpy would take half as long as a solution of the model.
    """
    for row in range(here.shape[0]):
        x, y, z = (here[row, 0] - there[row, 0], here[row, 1] - there[row, 1], here[row, 2] - there[row, 2])
        away = np.sqrt(x * x + y * y + z * z)
        within[row] = away <= tolerance
        if dense:
            rewards[row] = -1e3 * away
        else:
            rewards[row] = 0.0 if within[row] else -1.0
