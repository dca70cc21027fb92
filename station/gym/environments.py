"""Gymnasium environments of the tasks `Reach` and `Track`, with a single episode or with many in parallel.

Parallel episodes solve the model in batches. A single environment uses the same task with a single row,
so single and parallel episodes give the same results.
"""

from typing import Any, Literal, Protocol

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.gym import REACH_STEPS, TRACK_STEPS
from station.gym.bodies import Bools, EpisodeSettings, RobotBatch
from station.gym.reach import Reach
from station.gym.track import Track

#: Width and height of a picture [pixels].
IMAGE_PX = 480
Pixels = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]


def picture(robot: Robot, joints: Array, wrench: Array, tip: Array, marks: Array) -> Pixels:
    """Return a picture (IMAGE_PX, IMAGE_PX, 3) of the loaded model's shape, the tip and the points `marks` (m, 3)."""
    model = Statics(robot)
    line = 1e3 * model.shape(model.solve(joints, wrench))[:, 10:13]
    figure = Figure((IMAGE_PX / 100, IMAGE_PX / 100), dpi=100)
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    axes.plot(*line.T, color="#3b6ea5", linewidth=3)
    axes.plot(*(1e3 * marks.T), color="#c2571a", marker="o" if len(marks) == 1 else None)
    axes.scatter(*(1e3 * tip), color="black", s=18)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_aspect("equal")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba(), dtype=np.uint8)[:, :, :3].copy()


class EnvironmentTask(Protocol):
    """Interface of a task with parallel episodes; each row of an array belongs to one episode."""

    bodies: RobotBatch
    observation_space: Any
    action_space: Any

    def reset(self, row: int, random: np.random.Generator) -> None: ...  # noqa: D102
    def observe(self) -> Any: ...  # noqa: D102
    def step(self, actions: Array) -> tuple[Array, dict[str, Any]]: ...  # noqa: D102
    def marks(self, row: int) -> Array: ...  # noqa: D102


class TaskEnv(gymnasium.Env[Any, Any]):
    """Gymnasium environment with one episode of a task at a time."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - as in Gymnasium

    def __init__(self, task: EnvironmentTask, render_mode: str | None) -> None:
        self.task, self.render_mode = task, render_mode
        self.observation_space, self.action_space = task.observation_space, task.action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode: draw robot, load and task at random."""
        super().reset(seed=seed, options=options)
        self.task.reset(0, self.np_random)
        return self._first(self.task.observe()), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Carry out an action for a period. An episode ends only when its number of steps is reached."""
        rewards, more = self.task.step(np.asarray(action, np.float64)[None])
        return self._first(self.task.observe()), float(rewards[0]), False, False, {k: v[0] for k, v in more.items()}

    def render(self) -> Any:
        """Return a picture of the robot as pixels, in the render mode `rgb_array`."""
        return _picture(self.task, 0) if self.render_mode == "rgb_array" else None

    @staticmethod
    def _first(observed: Any) -> Any:
        return {key: part[0] for key, part in observed.items()} if isinstance(observed, dict) else observed[0]


class ReachEnv(TaskEnv):
    """Environment `CtrReach-v0`; arguments: `tolerance` [m], `reward`, and the fields of `EpisodeSettings`."""

    def __init__(
        self,
        render_mode: str | None = None,
        tolerance: float = 1e-3,
        reward: Literal["sparse", "dense"] = "sparse",
        **setting: Any,
    ) -> None:
        task = Reach(1, EpisodeSettings(**setting), tolerance, reward)
        self.compute_reward = task.compute_reward
        super().__init__(task, render_mode)

    def compute_terminated(self, achieved: Any, desired: Any, info: Any) -> bool:  # noqa: ARG002
        """Return False, because reaching the goal does not end an episode."""
        return False

    def compute_truncated(self, achieved: Any, desired: Any, info: Any) -> bool:  # noqa: ARG002
        """Return False, because the achieved goal does not truncate an episode."""
        return False


class TrackEnv(TaskEnv):
    """Environment `CtrTrack-v0`; arguments: `steps` of the path, and the fields of `EpisodeSettings`."""

    def __init__(self, render_mode: str | None = None, steps: int = TRACK_STEPS, **setting: Any) -> None:
        super().__init__(Track(1, EpisodeSettings(**setting), steps), render_mode)


class TaskVectorEnv(VectorEnv[Any, Any, Any]):
    """Gymnasium vector environment with parallel episodes of a task.

    The step after the end of an episode starts the next episode in its row, as in Gymnasium's vector environments.
    """

    metadata: dict[str, Any] = {**TaskEnv.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, task: EnvironmentTask, num_envs: int, max_episode_steps: int, render_mode: str | None) -> None:
        self.task, self.num_envs, self.render_mode = task, num_envs, render_mode
        self.single_observation_space, self.single_action_space = task.observation_space, task.action_space
        self.observation_space = batch_space(task.observation_space, num_envs)
        self.action_space = batch_space(task.action_space, num_envs)
        self._max_steps, self._steps = max_episode_steps, np.zeros(num_envs, np.int64)
        self._over: Bools = np.zeros(num_envs, np.bool_)
        self._randoms: list[np.random.Generator] = []

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start all episodes. If `seed` is a single number, row i gets the seed `seed` + i."""
        super().reset(seed=seed if isinstance(seed, int) else None, options=options)
        seeds = seed if isinstance(seed, list) else [None if seed is None else seed + i for i in range(self.num_envs)]
        if seed is not None or not self._randoms:
            self._randoms = [seeding.np_random(own)[0] for own in seeds]
        for row in range(self.num_envs):
            self.task.reset(row, self._randoms[row])
        self._steps[:], self._over = 0, np.zeros(self.num_envs, np.bool_)
        return self.task.observe(), {}

    def step(self, actions: Any) -> tuple[Any, Array, Bools, Bools, dict[str, Any]]:
        """Carry out one action in every episode for a period."""
        rewards, more = self.task.step(np.asarray(actions, np.float64))
        self._steps += 1
        reported = ~self._over
        if self._over.any():
            for row in np.flatnonzero(self._over).tolist():
                self.task.reset(row, self._randoms[row])
            rewards, self._steps = np.where(self._over, 0.0, rewards), np.where(self._over, 0, self._steps)
        truncated = self._steps >= self._max_steps
        infos = {name: part for key, value in more.items() for name, part in ((key, value), (f"_{key}", reported))}
        self._over = truncated
        return self.task.observe(), rewards, np.zeros(self.num_envs, np.bool_), truncated.copy(), infos

    def render(self) -> Any:
        """Return a picture of each episode as pixels, in the render mode `rgb_array`."""
        enabled = self.render_mode == "rgb_array"
        return tuple(_picture(self.task, row) for row in range(self.num_envs)) if enabled else None


class ReachVectorEnv(TaskVectorEnv):
    """Vector environment with parallel episodes of `ReachEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int = REACH_STEPS,
        render_mode: str | None = None,
        tolerance: float = 1e-3,
        reward: Literal["sparse", "dense"] = "sparse",
        **setting: Any,
    ) -> None:
        task = Reach(num_envs, EpisodeSettings(**setting), tolerance, reward)
        self.compute_reward = task.compute_reward
        super().__init__(task, num_envs, max_episode_steps, render_mode)


class TrackVectorEnv(TaskVectorEnv):
    """Vector environment with parallel episodes of `TrackEnv`."""

    def __init__(
        self,
        num_envs: int = 1,
        max_episode_steps: int = TRACK_STEPS,
        render_mode: str | None = None,
        steps: int = TRACK_STEPS,
        **setting: Any,
    ) -> None:
        super().__init__(Track(num_envs, EpisodeSettings(**setting), steps), num_envs, max_episode_steps, render_mode)


def _picture(task: EnvironmentTask, row: int) -> Pixels:
    bodies = task.bodies
    return picture(
        bodies.robots[row], bodies.joints[row], bodies.wrenches[row], bodies.tips[row], task.marks(row)
    )  # fmt: skip
