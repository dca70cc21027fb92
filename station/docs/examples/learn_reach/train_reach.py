"""Example: train a policy for `CtrReach-v0` with SAC and HER of Stable-Baselines3. The station does not import it.

Needs a separate Python environment: pip install 'ctr-station[gym]' torch stable-baselines3

    python train_reach.py reach --minutes 60  # reach.zip, the best policy; reach.csv, the curve
    python train_reach.py reach --test 1000   # test it, also on the exact rod
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
#: Scales of the vector to the goal in the observation [m], because a network cannot resolve 1 mm in 300 mm.
SCALES = (0.1, 0.01, 0.001)
#: Distance of the tip at which the goal counts as reached, and distance at which the reward is -1 [m].
GOAL_RADIUS_M, MAX_DISTANCE_M = 0.001, 0.1
#: Number of parallel episodes, gradient steps after each of their steps, time between evaluations [s], and number of
#: episodes of an evaluation.
PARALLEL_EPISODES, GRADIENT_STEPS, EVALUATION_INTERVAL_S, EVALUATION_EPISODES = 16, 8, 60.0, 200


class GoalFeatures(BaseFeaturesExtractor):
    """Features of an observation: joints, tip, and vector to the goal at several scales, with no learned parameters."""

    def __init__(self, space: gymnasium.spaces.Dict) -> None:
        super().__init__(space, len(space["observation"].sample()) + 3 * len(SCALES))

    def forward(self, observed: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return the features (k, m) of observations (k, ...)."""
        joints, tip = observed["observation"][:, :-3], observed["observation"][:, -3:]
        offset = observed["desired_goal"] - observed["achieved_goal"]
        return torch.cat((joints, tip / SCALES[0], *(torch.tanh(offset / scale) for scale in SCALES)), dim=1)


class ReachedReward(gymnasium.Wrapper):
    """Reward that distinguishes distances at every scale: the logarithm of the distance, from 0 to about -1."""

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        """Return the rewards for tips and goals (..., 3) [m]."""
        away = np.linalg.norm(np.asarray(achieved) - np.asarray(desired), axis=-1)
        return -np.log1p(away / GOAL_RADIUS_M) / np.log1p(MAX_DISTANCE_M / GOAL_RADIUS_M)

    def step(self, action: Any) -> Any:
        """Carry out a step of the environment and replace its reward by the logarithmic one."""
        observed, _, terminated, truncated, info = self.env.step(action)
        reward = float(self.compute_reward(observed["achieved_goal"], observed["desired_goal"], info))
        return observed, reward, terminated, truncated, info


def distances(policy: Any, episodes: int, seed: int, **setting: Any) -> np.ndarray:
    """Return the distance of the tip from the goal at the end of each episode, without exploration (episodes,) [m]."""
    many = gymnasium.make_vec(ENVIRONMENT, num_envs=episodes, vectorization_mode="vector_entry_point", **setting)
    observed, _ = many.reset(seed=seed)
    over = np.zeros(episodes, bool)
    while not over.all():
        observed, _, _, over, _ = many.step(policy.predict(observed, deterministic=True)[0])
    return np.linalg.norm(observed["achieved_goal"] - observed["desired_goal"], axis=1)


def result_line(away: np.ndarray) -> Sequence[str]:
    """Return texts: fraction of the distances within 1 mm, and their median and 90th percentile [mm]."""
    return f"{np.mean(away <= GOAL_RADIUS_M):.3f}", *(f"{1e3 * np.percentile(away, part):.3f}" for part in (50, 90))


class LearningCurve(BaseCallback):
    """Writes lines of the learning curve at intervals, saves the best policy, and ends the training after its time."""

    def __init__(self, path: Path, minutes: float) -> None:
        super().__init__()
        self._path, self._end, self._next, self._best = path, 60.0 * minutes, EVALUATION_INTERVAL_S, np.inf
        self._start = time.monotonic()

    def _on_step(self) -> bool:
        now = time.monotonic() - self._start
        if now >= self._next:
            self._next = now + EVALUATION_INTERVAL_S
            away = distances(self.model, EVALUATION_EPISODES, seed=10_000)
            if (score := -np.mean(away <= GOAL_RADIUS_M) + 1e-3 * np.median(away)) < self._best:
                self._best = score
                self.model.save(self._path.with_suffix(".zip"))
            with self._path.with_suffix(".csv").open("a", newline="") as file:
                row = f"{now:.0f}", f"{time.process_time():.0f}", self.num_timesteps, *result_line(away)
                csv.writer(file).writerow(row)
            sys.stdout.write(f"{', '.join(map(str, row))}\n")
            sys.stdout.flush()
        return now < self._end


def train(path: Path, minutes: float, seed: int) -> None:
    """Train a policy; if `path` exists, continue with the policy in it."""
    many = make_vec_env(ENVIRONMENT, PARALLEL_EPISODES, seed, wrapper_class=ReachedReward)
    start = 200 * PARALLEL_EPISODES  # by then every parallel episode has ended, which HER needs for learning
    if path.with_suffix(".zip").exists():
        model = SAC.load(path, many)
        model.learning_starts = model.num_timesteps + start
    else:
        model = SAC(
            "MultiInputPolicy",
            many,
            replay_buffer_class=HerReplayBuffer,
            replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "future"},
            policy_kwargs={"features_extractor_class": GoalFeatures, "net_arch": [256, 256]},
            gamma=0.95,  # discount factor: the effect of an action is visible within two seconds
            learning_rate=7e-4,
            train_freq=1,
            gradient_steps=GRADIENT_STEPS,
            learning_starts=start,
            seed=seed,
        )
        with path.with_suffix(".csv").open("w", newline="") as file:
            csv.writer(file).writerow(("time_s", "processor_s", "steps", "within_1_mm", "median_mm", "p90_mm"))
    model.learn(10**9, LearningCurve(path, minutes), reset_num_timesteps=False)


def test(path: Path, episodes: int) -> None:
    """Test the policy with new goals: under the training load, other loads, tube errors, and on the exact rod."""
    policy = SAC.load(path, gymnasium.make(ENVIRONMENT))  # HER needs an environment
    for name, setting in (
        ("as learned", {}),
        ("without load", {"load": 0.0}),
        ("up to 0.5 N", {"load": 0.5}),
        ("tubes off by up to 5 %", {"tube_error": 0.05}),
        ("the exact rod", {"exact": True}),
    ):
        within, median, p90 = result_line(distances(policy, episodes, seed=20_000, **setting))
        sys.stdout.write(f"{name}: {within} within 1 mm, median {median} mm, 90 % within {p90} mm\n")


def main() -> None:
    """Train or test a policy, as the command line requests."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("path", type=Path, help="path of the policy, without .zip")
    options.add_argument("--minutes", type=float, default=60.0, help="training time [min] (default: 60)")
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--test", type=int, metavar="EPISODES", help="test instead of training")
    parsed = options.parse_args()
    torch.set_num_threads(1)
    if parsed.test:
        test(parsed.path, parsed.test)
    else:
        train(parsed.path, parsed.minutes, parsed.seed)


if __name__ == "__main__":
    main()
