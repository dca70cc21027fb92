"""Task of the environment `CtrTrack-v0`: keep the tip on a path while an unknown load is applied."""

import numpy as np
from gymnasium.spaces import Box

from core.compiled import compiled
from core.errors import NoSolution
from core.model.batch import solve_many
from core.model.statics import Statics
from core.robot.robot import Array, Indices
from station.config.strict import ConfigError
from station.gym import TRACK_STEPS
from station.gym.bodies import Actions, Bools, EpisodeSettings, RobotBatch
from station.gym.reach import MAX_DRAWS

#: Largest fraction of the joints' top speed that a path requires from the unloaded robot of the robot file.
MAX_SPEED_SHARE = 0.5
#: Rise time of the load, which starts at a random time in the first half of the episode [s].
LOAD_RAMP_S = 1.0
#: Smallest number of points of a path at which the model is solved. A path is smooth if the amplitudes in the upper
#: quarter of its frequencies are smaller than the second constant [m]; the path of a robot that snaps is not.
MIN_PATH_POINTS, MAX_TAIL_AMPLITUDE_M = 64, 1e-5


class Track:
    """Task of following a path, with parallel episodes.

    The path is a closed path of the tip, computed for the unloaded robot of the robot file, without tube errors.
    """

    def __init__(self, rows: int, setting: EpisodeSettings, steps: int = TRACK_STEPS) -> None:
        if steps < MIN_PATH_POINTS:
            raise ConfigError(f"steps = {steps} is less than {MIN_PATH_POINTS}, the smallest number; increase it")
        self.bodies, self.steps = RobotBatch(setting, rows), steps
        n, reach = self.bodies.lower.size, self.bodies.reach
        self.paths, self.onsets = np.zeros((rows, steps + 2, 3)), np.zeros(rows)
        self.loads, self.at = np.zeros((rows, 6)), np.zeros(rows, np.int64)
        self._model = Statics(self.bodies.robot)
        high = np.concatenate((self.bodies.observation_bounds, 2.0 * reach, 2.0 * reach))
        self._width = high.size
        self.observation_space = Box(-high, high, dtype=np.float64)
        self.action_space = Actions(n)

    def reset(self, row: int, random: np.random.Generator) -> None:
        """Start an episode in this row with a random robot, load and path."""
        bodies = self.bodies
        for _ in range(MAX_DRAWS):
            robot, load = bodies.disturb_robot(random), bodies.draw_load(random)
            joints = self._draw_joints(random)
            path = self._path(joints)
            start = bodies.put(row, robot, joints[:1], np.zeros(6))
            if path is not None and np.isfinite(start).all():
                self.paths[row], self.loads[row], self.at[row] = path, load, 0
                self.onsets[row] = random.uniform(0.0, 0.5 * self.steps)
                return
        raise NoSolution(f"robot '{bodies.robot.name}': the model has no solution on some points of every drawn path")

    def observe(self) -> Array:
        """Return the observations of all rows: joints, tip, vectors from the tip to its target and next target [m]."""
        bodies = self.bodies
        observations = np.empty((bodies.rows, self._width))
        bodies.observe_into(observations)
        _look_ahead(self.paths, self.at, bodies.tips, observations)
        return observations

    def step(self, actions: Array) -> tuple[Array, dict[str, Array | Bools]]:
        """Carry out actions (k, n); return the distances (k,) [m] from the targets, and as rewards minus them [mm]."""
        bodies = self.bodies
        _advance_loads(
            self.at, self.steps + 1, self.onsets, LOAD_RAMP_S / bodies.setting.period, self.loads, bodies.wrenches
        )
        bodies.move(actions)
        away = np.empty(bodies.rows)
        _distances(self.paths, self.at, bodies.tips, away)
        return -1e3 * away, {"error": away}

    def marks(self, row: int) -> Array:
        """Return the points (m, 3) that a picture of this row marks [m]: the path."""
        return self.paths[row]

    def _path(self, joints: Array) -> Array | None:
        """Return the path of the tip (steps + 2, 3) [m] for the unloaded robot of the robot file.

        The path is None if the robot has no shape at a point or its tip jumps. The model is solved at some points only;
        a Fourier series through them gives all points of the closed smooth path.
        """
        max_stride = self.steps // MIN_PATH_POINTS
        every = max((part for part in range(1, max_stride + 1) if self.steps % part == 0), default=1)
        poses = joints[: self.steps : every]
        found = solve_many(self._model, poses, np.zeros((len(poses), 6)), along=True)
        waves = np.fft.rfft(found.tip, axis=0)
        if not np.abs(waves[-len(waves) // 4 :]).max() < MAX_TAIL_AMPLITUDE_M * len(poses):  # NaN included
            return None
        path = every * np.fft.irfft(waves, self.steps, axis=0)
        return np.concatenate((path, path[:2]))

    def _draw_joints(self, random: np.random.Generator) -> Array:
        """Draw joint positions (steps + 2, n) between three valid poses; as the limits are linear, all are valid."""
        bodies = self.bodies
        start = bodies.draw_pose(random)
        routes = [bodies.draw_pose(random) - start for _ in range(2)]
        turn = 2.0 * np.pi / self.steps
        # Largest motion of any joint in a step with 0.25 times both routes, relative to the motion at top speed.
        fastest = np.max([0.25 * turn * np.abs(routes[0]) + 0.5 * turn * np.abs(routes[1])], axis=0) / bodies.stride
        part = min(1.0, MAX_SPEED_SHARE / float(fastest.max(initial=1e-12)))
        phase = turn * np.arange(self.steps + 2)
        first, second = 0.25 * part * (1.0 - np.cos(phase)), 0.25 * part * (1.0 - np.cos(2.0 * phase))
        return start + first[:, None] * routes[0] + second[:, None] * routes[1]


@compiled
def _advance_loads(at: Indices, last: int, onsets: Array, ramp: float, loads: Array, wrenches: Array) -> None:
    """Advance all episodes by a step and write their loads to `wrenches`; `last`: index of a path's last point."""
    for row in range(at.shape[0]):
        at[row] = min(at[row] + 1, last)
        part = min(max((at[row] - onsets[row]) / ramp, 0.0), 1.0)
        for k in range(6):
            wrenches[row, k] = part * loads[row, k]


@compiled
def _look_ahead(paths: Array, at: Indices, tips: Array, observations: Array) -> None:
    """Write the vectors from tips to targets and next targets into the last six columns of `observations` (k, m)."""
    last, behind = paths.shape[1] - 1, observations.shape[1] - 6
    for row in range(at.shape[0]):
        later = min(at[row] + 1, last)
        for k in range(3):
            observations[row, behind + k] = paths[row, at[row], k] - tips[row, k]
            observations[row, behind + 3 + k] = paths[row, later, k] - tips[row, k]


@compiled
def _distances(paths: Array, at: Indices, tips: Array, away: Array) -> None:
    """Write the distances (k,) of the tips from their targets into `away` [m]."""
    for row in range(at.shape[0]):
        total = 0.0
        for k in range(3):
            gap = tips[row, k] - paths[row, at[row], k]
            total += gap * gap
        away[row] = np.sqrt(total)
