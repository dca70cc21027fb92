"""A worked example: a trained policy in the virtual lab with a hidden load, beside the controller that `run` has.

    python station/gym/worked/reach_in_lab.py reach --trials 10

In virtual time, on simulated devices with their delays and noise, and on a plant that is not the model the policy has
learned on. The policy sees the measured tip and the joints every 0.1 s and says joint velocities, as a jog does; the
controller is led to the same goal. Both have the same time from the same start under the same load.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import SAC  # pyright: ignore[reportMissingImports]

from core.control.leading import Wish
from core.control.pursuit import Pursuit
from station.config.controllers import PERIOD
from station.config.robots import load_robot
from station.control.led import Asked, Lead
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import Phase, Task
from station.experiments.experiment import load_experiment
from station.gym.bodies import Setting
from station.gym.reach import Reach
from station.lab.config import load_lab
from station.lab.loads import TrapezoidLoad
from station.lab.virtual_bench import virtual_bench

#: The load comes within a time, and after another the tip is to go to its goal, which takes a third [s].
RISE, WAIT, TIME = 1.0, 3.0, 15.0
#: The controller's way to the goal.
BOUNDS = Pursuit(max_speed=0.02, max_acceleration=0.1, rate=20.0, braking=0.8)
NAMES = "policy", "controller"


class Trial:
    """One goal under one load, in a virtual lab of its own."""

    def __init__(self, seed: int, load: float, lab: str) -> None:
        self.setting, self.seen = Setting(load=load), Reach(1, Setting(load=load))
        self.seen.reset(0, np.random.default_rng(seed))
        bodies = self.seen.bodies
        self.start, self.goal, self.force = bodies.joints[0].copy(), self.seen.goals[0], bodies.wrenches[0, :3]
        robot = load_robot(self.setting.robot)
        self.lab, devices = virtual_bench(robot, load_lab(lab, robot), seed, self.start)
        self.controller = load_experiment("fig10").cases[1].controller  # the live default
        self.loop = ControlLoop(self.controller, devices)
        self.loop.connect(0.0)
        self._tick, self.row, self.tip = 0, np.empty(0), np.zeros(3)

    @property
    def now(self) -> float:
        """Time of the next tick [s]."""
        return self._tick * PERIOD

    def go_on(self, asked: Asked | None = None) -> None:
        """A tick."""
        truth = self.lab.advance(self.now)
        row = self.loop.tick(self.now, truth, asked)
        self.tip, self._tick = truth.tip, self._tick + 1
        self.row = self.row if row is None else row

    def until(self, what: Callable[[], bool]) -> None:
        """Ticks; a minute at most."""
        end = self.now + 60.0
        while not what():
            self.go_on()
            if self.now > end or self.loop.cause:
                raise RuntimeError(self.loop.cause or "the bench did not come up")

    def pull(self) -> None:
        """Let the load come."""
        size = float(np.linalg.norm(self.force))
        direction = tuple((self.force / size).tolist())
        self.lab.apply_load(TrapezoidLoad(magnitude=size, rise=RISE, direction=direction), self.now)

    @property
    def away(self) -> float:
        """Of the true tip from the goal [m]."""
        return float(np.linalg.norm(self.tip - self.goal))


def by_policy(trial: Trial, policy: Any) -> None:
    """A jog of the joints, renewed at every period of the environment."""
    trial.until(lambda: trial.loop.state is State.READY)
    settled = trial.now + 2.0
    trial.until(lambda: trial.now >= settled)  # the sensors are tared
    trial.pull()
    begin = trial.now + WAIT
    trial.until(lambda: trial.now >= begin)
    bodies, channels, velocity, due = trial.seen.bodies, trial.loop.channels, np.zeros(3), trial.now
    while trial.now < begin + TIME and not trial.loop.cause:
        if trial.now >= due:
            bodies.joints[0] = channels.of(trial.row, "joints")
            bodies.tips[0] = channels.of(trial.row, "tip_measured")
            action, _ = policy.predict(trial.seen.observe(), deterministic=True)
            velocity = action[0] * bodies.stride / trial.setting.period
            due += trial.setting.period
        trial.loop.jog(trial.now, "joints", velocity)
        trial.go_on()


def by_controller(trial: Trial) -> None:
    """A tip that is led: held while the load comes, then to the goal."""
    trial.until(lambda: trial.loop.state is State.READY)
    trial.loop.start(Task(trial.controller, Lead(BOUNDS), 1000.0))
    trial.until(lambda: trial.loop.phase is Phase.MOVING)
    begin, way = trial.now + WAIT, trial.goal - trial.loop.channels.of(trial.row, "tip_desired")
    trial.pull()
    while trial.now < begin + TIME and not trial.loop.cause:
        place = way if trial.now >= begin else np.zeros(3)
        trial.go_on(Asked(0, Wish(place, np.zeros(3), trial.now, 0.0)))


def main() -> None:
    """All trials, and what came of them."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("path", type=Path, help="of the policy, without .zip")
    options.add_argument("--trials", type=int, default=10)
    options.add_argument("--load", type=float, default=0.2, help="largest hidden force [N]")
    options.add_argument("--lab", default="gentle")
    parsed = options.parse_args()
    policy = SAC.load(parsed.path, gymnasium.make("station.gym:CtrReach-v0"))  # HER wants one, if only to look at
    found = np.full((parsed.trials, 2), np.nan)
    for number in range(parsed.trials):
        for column, carry_out in enumerate((lambda trial: by_policy(trial, policy), by_controller)):
            trial = Trial(30_000 + number, parsed.load, parsed.lab)
            carry_out(trial)
            found[number, column] = trial.away
            size = float(np.linalg.norm(trial.force))
            why = f" ({trial.loop.cause})" if trial.loop.cause else ""
            sys.stdout.write(f"{number}, {size:.2f} N, {NAMES[column]}: {1e3 * trial.away:.2f} mm{why}\n")
            sys.stdout.flush()
    for name, away in zip(NAMES, found.T, strict=True):
        within = f"{(away <= 1e-3).sum()} of {parsed.trials} within 1 mm"
        sys.stdout.write(f"{name}: {within}, median {1e3 * np.median(away):.2f} mm (true tip, simulated)\n")


if __name__ == "__main__":
    main()
