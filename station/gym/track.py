"""The task of `CtrTrack-v0`: keep the tip on a path while a load that nobody tells of comes."""

import numpy as np
from gymnasium.spaces import Box

from core.compiled import compiled
from core.errors import NoSolution
from core.model.many import solve_many
from core.model.statics import Statics
from core.robot.robot import Array, Indices
from station.config.strict import ConfigError
from station.gym import TRACK_STEPS
from station.gym.actions import Actions
from station.gym.bodies import Bodies, Bools, Setting
from station.gym.reach import MOST_DRAWS

#: Of their speed the joints need no more than this part to follow the path without load.
SPARE = 0.5
#: The load comes within this time [s], at some moment in the first half.
RAMP = 1.0
#: Of a path so many points are solved at least; its last quarter of waves is no larger than this [m].
POINTS, SMOOTH = 64, 1e-5


class Track:
    """So many episodes side by side. The path is where the described robot's tip goes without load, and back."""

    def __init__(self, rows: int, setting: Setting, steps: int = TRACK_STEPS) -> None:
        if steps < POINTS:
            raise ConfigError(f"steps = {steps} are fewer than {POINTS}")
        self.bodies, self.steps = Bodies(setting, rows), steps
        n, reach = self.bodies.lower.size, self.bodies.reach
        self.paths, self.onsets = np.zeros((rows, steps + 2, 3)), np.zeros(rows)
        self.loads, self.at = np.zeros((rows, 6)), np.zeros(rows, np.int64)
        self._model = Statics(self.bodies.robot)
        high = np.concatenate((self.bodies.felt_bounds, 2.0 * reach, 2.0 * reach))
        self._width = high.size
        self.observation_space = Box(-high, high, dtype=np.float64)
        self.action_space = Actions(n)

    def reset(self, row: int, random: np.random.Generator) -> None:
        """Begin an episode in this row: robot, load and path are drawn."""
        bodies = self.bodies
        for _ in range(MOST_DRAWS):
            robot, load = bodies.disturbed(random), bodies.drawn_load(random)
            joints = self._drawn_joints(random)
            path = self._path(joints)
            start = bodies.put(row, robot, joints[:1], np.zeros(6))
            if path is not None and np.isfinite(start).all():
                self.paths[row], self.loads[row], self.at[row] = path, load, 0
                self.onsets[row] = random.uniform(0.0, 0.5 * self.steps)
                return
        raise NoSolution(f"robot '{bodies.robot.name}': no path was found along which it has shapes")

    def observe(self) -> Array:
        """What the rows feel of their joints, their tips, the ways to their targets and to the next ones [m]."""
        bodies = self.bodies
        seen = np.empty((bodies.rows, self._width))
        bodies.feel(seen)
        _look_ahead(self.paths, self.at, bodies.tips, seen)
        return seen

    def step(self, actions: Array) -> tuple[Array, dict[str, Array | Bools]]:
        """Rewards (k,), the distance from the path in mm and negative, and the same in metres."""
        bodies = self.bodies
        _come(self.at, self.steps + 1, self.onsets, RAMP / bodies.setting.period, self.loads, bodies.wrenches)
        bodies.move(actions)
        away = np.empty(bodies.rows)
        _fall_behind(self.paths, self.at, bodies.tips, away)
        return -1e3 * away, {"error": away}

    def marks(self, row: int) -> Array:
        """Points (m, 3) to show [m]."""
        return self.paths[row]

    def _path(self, joints: Array) -> Array | None:
        """The described tip without load (steps + 2, 3) [m]; None where it has no shape, or jumps.

        What is closed and smooth is known everywhere by some of its points.
        """
        most = self.steps // POINTS
        every = max((part for part in range(1, most + 1) if self.steps % part == 0), default=1)
        poses = joints[: self.steps : every]
        found = solve_many(self._model, poses, np.zeros((len(poses), 6)), along=True)
        waves = np.fft.rfft(found.tip, axis=0)
        if not np.abs(waves[-len(waves) // 4 :]).max() < SMOOTH * len(poses):  # NaN included
            return None
        path = every * np.fft.irfft(waves, self.steps, axis=0)
        return np.concatenate((path, path[:2]))

    def _drawn_joints(self, random: np.random.Generator) -> Array:
        """Joints (steps + 2, n) between three poses, where the tubes stand everywhere: their limits are straight."""
        bodies = self.bodies
        start = bodies.drawn_pose(random)
        ways = [bodies.drawn_pose(random) - start for _ in range(2)]
        turn = 2.0 * np.pi / self.steps
        # The fastest that a quarter of (1 - cos) takes a joint on in a step, over its stride.
        fastest = np.max([0.25 * turn * np.abs(ways[0]) + 0.5 * turn * np.abs(ways[1])], axis=0) / bodies.stride
        part = min(1.0, SPARE / float(fastest.max(initial=1e-12)))
        phase = turn * np.arange(self.steps + 2)
        first, second = 0.25 * part * (1.0 - np.cos(phase)), 0.25 * part * (1.0 - np.cos(2.0 * phase))
        return start + first[:, None] * ways[0] + second[:, None] * ways[1]


@compiled
def _come(at: Indices, last: int, onsets: Array, ramp: float, loads: Array, wrenches: Array) -> None:
    """On by a step, and as much of the loads as has come then; paths have `steps` + 2 points."""
    for row in range(at.shape[0]):
        at[row] = min(at[row] + 1, last)
        part = min(max((at[row] - onsets[row]) / ramp, 0.0), 1.0)
        for k in range(6):
            wrenches[row, k] = part * loads[row, k]


@compiled
def _look_ahead(paths: Array, at: Indices, tips: Array, seen: Array) -> None:
    """The ways to the targets and to the next ones, the last six of what is seen (k, m)."""
    last, behind = paths.shape[1] - 1, seen.shape[1] - 6
    for row in range(at.shape[0]):
        later = min(at[row] + 1, last)
        for k in range(3):
            seen[row, behind + k] = paths[row, at[row], k] - tips[row, k]
            seen[row, behind + 3 + k] = paths[row, later, k] - tips[row, k]


@compiled
def _fall_behind(paths: Array, at: Indices, tips: Array, away: Array) -> None:
    """Distances (k,) from the targets."""
    for row in range(at.shape[0]):
        total = 0.0
        for k in range(3):
            gap = tips[row, k] - paths[row, at[row], k]
            total += gap * gap
        away[row] = np.sqrt(total)
