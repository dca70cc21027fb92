"""A worked example: Stable-Baselines3's SAC with HER on `CtrReach-v0`. Nothing of the station imports it.

Needs an environment of its own: pip install 'ctr-station[gym]' torch stable-baselines3

    python station/gym/worked/train_reach.py reach --minutes 60  # reach.zip, the best policy; reach.csv, the curve
    python station/gym/worked/train_reach.py reach --test 1000   # what it is worth, on the exact rod, too
"""

import argparse
import csv
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from stable_baselines3 import SAC, HerReplayBuffer  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.callbacks import BaseCallback  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.env_util import make_vec_env  # pyright: ignore[reportMissingImports]
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor  # pyright: ignore[reportMissingImports]

ENVIRONMENT = "station.gym:CtrReach-v0"
#: Distances by which the policy sees its way to the goal: a network cannot tell 1 mm in 300 [m].
SCALES = (0.1, 0.01, 0.001)
#: Within this the goal is reached, and from this far on one place is as bad as another [m].
NEAR, FAR = 0.001, 0.1
#: Episodes side by side, gradient steps after each of their steps, and between two evaluations [s] and their episodes.
ROWS, GRADIENTS, EVERY, EPISODES = 16, 8, 60.0, 200


class Ways(BaseFeaturesExtractor):
    """Joints, tip, and the way to the goal at several scales; nothing in it is learned."""

    def __init__(self, space: gymnasium.spaces.Dict) -> None:
        super().__init__(space, len(space["observation"].sample()) + 3 * len(SCALES))

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (k, m) of observations (k, ...)."""
        joints, tip = seen["observation"][:, :-3], seen["observation"][:, -3:]
        way = seen["desired_goal"] - seen["achieved_goal"]
        return torch.cat((joints, tip / SCALES[0], *(torch.tanh(way / scale) for scale in SCALES)), dim=1)


class Nearer(gymnasium.Wrapper):
    """A reward that tells near from far at every scale: the logarithm of the distance, from 0 to about -1."""

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:  # noqa: ARG002 - as learners ask
        """Of tips and goals (..., 3) [m]."""
        away = np.linalg.norm(np.asarray(achieved) - np.asarray(desired), axis=-1)
        return -np.log1p(away / NEAR) / np.log1p(FAR / NEAR)

    def step(self, action: Any) -> Any:
        """As the environment, but for the reward."""
        seen, _, terminated, truncated, info = self.env.step(action)
        reward = float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info))
        return seen, reward, terminated, truncated, info


def distances(policy: Any, episodes: int, seed: int, **setting: Any) -> np.ndarray:
    """From the goal at the end of each episode, when the policy does what it thinks best (episodes,) [m]."""
    many = gymnasium.make_vec(ENVIRONMENT, num_envs=episodes, vectorization_mode="vector_entry_point", **setting)
    seen, _ = many.reset(seed=seed)
    over = np.zeros(episodes, bool)
    while not over.all():
        seen, _, _, over, _ = many.step(policy.predict(seen, deterministic=True)[0])
    return np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"], axis=1)


def said(away: np.ndarray) -> Sequence[str]:
    """Part within 1 mm, median and 90th percentile [mm]."""
    return f"{np.mean(away <= NEAR):.3f}", *(f"{1e3 * np.percentile(away, part):.3f}" for part in (50, 90))


class Curve(BaseCallback):
    """A line of the curve from time to time; the best policy so far is kept; training ends by the clock."""

    def __init__(self, path: Path, minutes: float) -> None:
        super().__init__()
        self._path, self._end, self._next, self._best = path, 60.0 * minutes, EVERY, np.inf
        self._begin = time.monotonic()

    def _on_step(self) -> bool:
        now = time.monotonic() - self._begin
        if now >= self._next:
            self._next = now + EVERY
            away = distances(self.model, EPISODES, seed=10_000)
            if (score := -np.mean(away <= NEAR) + 1e-3 * np.median(away)) < self._best:
                self._best = score
                self.model.save(self._path.with_suffix(".zip"))
            with self._path.with_suffix(".csv").open("a", newline="") as file:
                row = f"{now:.0f}", f"{time.process_time():.0f}", self.num_timesteps, *said(away)
                csv.writer(file).writerow(row)
            sys.stdout.write(f"{', '.join(map(str, row))}\n")
            sys.stdout.flush()
        return now < self._end


def train(path: Path, minutes: float, seed: int) -> None:
    """Learn; from the policy at `path` on, if there is one."""
    many = make_vec_env(ENVIRONMENT, ROWS, seed, wrapper_class=Nearer)
    begin = 200 * ROWS  # by then every row has an episode to learn from
    if path.with_suffix(".zip").exists():
        model = SAC.load(path, many)
        model.learning_starts = model.num_timesteps + begin
    else:
        model = SAC(
            "MultiInputPolicy",
            many,
            replay_buffer_class=HerReplayBuffer,
            replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
            policy_kwargs={"features_extractor_class": Ways, "net_arch": [256, 256]},
            gamma=0.95,  # an action tells within two seconds
            learning_rate=7e-4,
            train_freq=1,
            gradient_steps=GRADIENTS,
            learning_starts=begin,
            seed=seed,
        )
        with path.with_suffix(".csv").open("w", newline="") as file:
            csv.writer(file).writerow(("time_s", "processor_s", "steps", "within_1_mm", "median_mm", "p90_mm"))
    model.learn(10**9, Curve(path, minutes), reset_num_timesteps=False)


def test(path: Path, episodes: int) -> None:
    """Goals that it has not seen, under the load that it has learned with, more, and with the exact rod."""
    policy = SAC.load(path, gymnasium.make(ENVIRONMENT))  # HER wants one, if only to look at
    for words, setting in (
        ("as learned", {}),
        ("without load", {"load": 0.0}),
        ("up to 0.5 N", {"load": 0.5}),
        ("tubes off by up to 5 %", {"tube_error": 0.05}),
        ("the exact rod", {"exact": True}),
    ):
        within, median, p90 = said(distances(policy, episodes, seed=20_000, **setting))
        sys.stdout.write(f"{words}: {within} within 1 mm, median {median} mm, 90 % within {p90} mm\n")


def main() -> None:
    """Train or test."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("path", type=Path, help="of the policy, without .zip")
    options.add_argument("--minutes", type=float, default=60.0, help="to train (60)")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--test", type=int, metavar="EPISODES", help="do not train, but test")
    parsed = options.parse_args()
    torch.set_num_threads(1)
    if parsed.test:
        test(parsed.path, parsed.test)
    else:
        train(parsed.path, parsed.minutes, parsed.seed)


if __name__ == "__main__":
    main()
