"""Example: a trained policy in the virtual lab with a hidden load, compared with the default controller of `run`.

    python reach_in_lab.py reach --trials 10

The example runs in virtual time, on simulated devices with their delays and noise. The plant (the simulated real robot)
differs from the model on which the policy was trained. The policy receives the measured tip and joints every 0.1 s and
sends joint velocities as a jog. The controller streams the tip to the same goal. Policy and controller have the same
start, load and time.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import SAC  # pyright: ignore[reportMissingImports]

from core.control.setpoint_request import MotionBounds, SetpointRequest
from station.config.controllers import PERIOD_S
from station.config.loads import TrapezoidLoad
from station.config.robots import load_robot
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import MotionTask, Phase, StreamLimits, StreamRequest
from station.experiments.experiment import load_experiment
from station.gym.bodies import EpisodeSettings
from station.gym.reach import Reach
from station.lab.config import load_lab
from station.lab.virtual_bench import virtual_bench

#: Rise time of the load, time between its onset and the motion to the goal, and time for this motion [s].
LOAD_RISE_S, WAIT_S, REACH_TIME_S = 1.0, 3.0, 15.0
#: Bounds of the setpoint while the controller moves the tip to the goal.
MOTION_BOUNDS = MotionBounds(max_speed=0.02, max_acceleration=0.1, rate=20.0, braking=0.8)
NAMES = "policy", "controller"


class Trial:
    """Trial with one goal and one load, in a separate virtual lab."""

    def __init__(self, seed: int, load: float, lab: str) -> None:
        self.setting, self.task = EpisodeSettings(load=load), Reach(1, EpisodeSettings(load=load))
        self.task.reset(0, np.random.default_rng(seed))
        bodies = self.task.bodies
        self.start, self.goal, self.force = bodies.joints[0].copy(), self.task.goals[0], bodies.wrenches[0, :3]
        robot = load_robot(self.setting.robot)
        self.lab, devices = virtual_bench(robot, load_lab(lab, robot), seed, self.start)
        self.controller = load_experiment("fig10").cases[1].controller  # the default controller of a live station
        self.loop = ControlLoop(self.controller, devices)
        self.loop.connect(0.0)
        self._tick, self.row, self.tip = 0, np.empty(0), np.zeros(3)

    @property
    def now(self) -> float:
        """Time of the next tick [s]."""
        return self._tick * PERIOD_S

    def advance(self, request: StreamRequest | None = None) -> None:
        """Run one tick of the lab and of the control loop, which receives `request`."""
        truth = self.lab.advance(self.now)
        row = self.loop.tick(self.now, truth, request)
        self.tip, self._tick = truth.tip, self._tick + 1
        self.row = self.row if row is None else row

    def until(self, condition: Callable[[], bool]) -> None:
        """Run ticks until `condition` returns True, for at most one simulated minute."""
        end = self.now + 60.0
        while not condition():
            self.advance()
            if self.now > end or self.loop.cause:
                raise RuntimeError(self.loop.cause or "the bench did not become READY")

    def pull(self) -> None:
        """Apply the load of this trial to the tip."""
        size = float(np.linalg.norm(self.force))
        direction = tuple((self.force / size).tolist())
        self.lab.apply_load(TrapezoidLoad(magnitude=size, rise=LOAD_RISE_S, direction=direction), self.now)

    @property
    def away(self) -> float:
        """Distance of the true tip from the goal [m]."""
        return float(np.linalg.norm(self.tip - self.goal))


def by_policy(trial: Trial, policy: Any) -> None:
    """Jog the joints as the policy decides; the policy decides again after each period of the environment."""
    trial.until(lambda: trial.loop.state is State.READY)
    settled = trial.now + 2.0
    trial.until(lambda: trial.now >= settled)  # wait until the sensors have been tared
    trial.pull()
    start = trial.now + WAIT_S
    trial.until(lambda: trial.now >= start)
    bodies, channels, velocity, due = trial.task.bodies, trial.loop.channels, np.zeros(3), trial.now
    while trial.now < start + REACH_TIME_S and not trial.loop.cause:
        if trial.now >= due:
            bodies.joints[0] = channels.of(trial.row, "joints")
            bodies.tips[0] = channels.of(trial.row, "tip_measured")
            action, _ = policy.predict(trial.task.observe(), deterministic=True)
            velocity = action[0] * bodies.stride / trial.setting.period
            due += trial.setting.period
        trial.loop.jog(trial.now, "joints", velocity)
        trial.advance()


def by_controller(trial: Trial) -> None:
    """Stream the setpoint of the tip: its start position while the load rises, then the goal."""
    trial.until(lambda: trial.loop.state is State.READY)
    trial.loop.start(MotionTask(trial.controller, StreamLimits(MOTION_BOUNDS), 1000.0))
    trial.until(lambda: trial.loop.phase is Phase.MOVING)
    start, offset = trial.now + WAIT_S, trial.goal - trial.loop.channels.of(trial.row, "tip_desired")
    trial.pull()
    while trial.now < start + REACH_TIME_S and not trial.loop.cause:
        setpoint = offset if trial.now >= start else np.zeros(3)
        trial.advance(StreamRequest(0, SetpointRequest(setpoint, np.zeros(3), trial.now, 0.0)))


def main() -> None:
    """Run all trials and print the results."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("path", type=Path, help="path of the policy, without .zip")
    options.add_argument("--trials", type=int, default=10)
    options.add_argument("--load", type=float, default=0.2, help="largest hidden force [N]")
    options.add_argument("--lab", default="gentle")
    parsed = options.parse_args()
    policy = SAC.load(parsed.path, gymnasium.make("station.gym:CtrReach-v0"))  # HER needs an environment
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
