"""A worked example: Stable-Baselines3's SAC with HER on `CtrReach-v0`. Nothing of the station imports it.

Needs, in an environment of its own: pip install 'ctr-station[gym]' torch stable-baselines3

    python station/gym/worked/train_reach.py reach --minutes 60    # reach.zip and reach.csv, the curve
    python station/gym/worked/train_reach.py reach --test 1000     # what it is worth, also on the exact rod
"""

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

import station.gym

ENVIRONMENT = "CtrReach-v0"
#: Distances that the policy sees its way to the goal in: a network cannot tell 1 mm in 300 [m].
SCALES = (0.1, 0.01, 0.001)
#: Episodes side by side, gradient steps after each of their steps, and between two evaluations [s].
ROWS, GRADIENTS, EVERY = 16, 4, 60.0


class Ways(BaseFeaturesExtractor):
    """Joints, tip, and the way to the goal at several scales; nothing in it is learned."""

    def __init__(self, space: gymnasium.spaces.Dict) -> None:
        super().__init__(space, space["observation"].shape[0] + 3 * len(SCALES))

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (k, m) of observations (k, ...)."""
        joints, tip = seen["observation"][:, :-3], seen["observation"][:, -3:]
        way = seen["desired_goal"] - seen["achieved_goal"]
        return torch.cat((joints, tip / SCALES[0], *(torch.tanh(way / scale) for scale in SCALES)), dim=1)


def distances(policy: Any, episodes: int, seed: int, **setting: Any) -> np.ndarray:
    """From the goal at the end of each episode, when the policy does what it thinks best (episodes,) [m]."""
    many = gymnasium.make_vec(ENVIRONMENT, num_envs=episodes, vectorization_mode="vector_entry_point", **setting)
    seen, _ = many.reset(seed=seed)
    over = np.zeros(episodes, bool)
    while not over.all():
        seen, _, _, over, _ = many.step(policy.predict(seen, deterministic=True)[0])
    return np.linalg.norm(seen["achieved_goal"] - seen["desired_goal"], axis=1)


class Evaluation(BaseCallback):
    """A line of the curve from time to time; the best policy so far is kept; training ends by the clock."""

    def __init__(self, path: Path, minutes: float) -> None:
        super().__init__()
        self._path, self._end, self._next, self._best = path, 60.0 * minutes, 0.0, -1.0
        self._begin = time.monotonic()

    def _on_step(self) -> bool:
        now = time.monotonic() - self._begin
        if now >= self._next:
            self._next = now + EVERY
            away = distances(self.model, 200, seed=10_000)
            within = float((away <= 1e-3).mean())
            if within >= self._best:
                self._best = within
                self.model.save(self._path.with_suffix(".zip"))
            with self._path.with_suffix(".csv").open("a", newline="") as file:
                row = (
                    f"{now:.0f}",
                    self.num_timesteps,
                    within,
                    *(f"{1e3 * np.percentile(away, p):.3f}" for p in (50, 90)),
                )
                csv.writer(file).writerow(row)
            sys.stdout.write(
                f"{now:6.0f} s, {self.num_timesteps} steps: {100 * within:.1f} % within 1 mm, median {row[3]} mm\n"
            )
            sys.stdout.flush()
        return now < self._end


def train(
    path: Path, minutes: float, seed: int, gamma: float, rows: int, gradients: int, batch: int, lr: float, reward: str
) -> None:
    """Learn."""
    station.gym.register()
    many = make_vec_env(ENVIRONMENT, rows, seed, env_kwargs={"reward": reward})
    model = SAC(
        "MultiInputPolicy",
        many,
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
        policy_kwargs={"features_extractor_class": Ways, "net_arch": [256, 256, 256]},
        gamma=gamma,
        batch_size=batch,
        learning_rate=lr,
        train_freq=1,
        gradient_steps=gradients,
        learning_starts=100 * rows + 1000,
        seed=seed,
    )
    with path.with_suffix(".csv").open("w", newline="") as file:
        csv.writer(file).writerow(("time_s", "steps", "within_1_mm", "median_mm", "p90_mm"))
    model.learn(10**9, Evaluation(path, minutes))


def main() -> None:
    """Train or test."""
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("path", type=Path, help="of the policy, without .zip")
    options.add_argument("--minutes", type=float, default=60.0, help="to train (60)")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--gamma", type=float, default=0.95)
    options.add_argument("--rows", type=int, default=16)
    options.add_argument("--gradients", type=int, default=4)
    options.add_argument("--batch", type=int, default=512)
    options.add_argument("--lr", type=float, default=7e-4)
    options.add_argument("--reward", default="sparse")
    parsed = options.parse_args()
    torch.set_num_threads(1)
    train(
        parsed.path,
        parsed.minutes,
        parsed.seed,
        parsed.gamma,
        parsed.rows,
        parsed.gradients,
        parsed.batch,
        parsed.lr,
        parsed.reward,
    )


if __name__ == "__main__":
    main()
