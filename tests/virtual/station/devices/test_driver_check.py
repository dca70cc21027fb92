"""The check of drivers on simulated stages in virtual time: good drivers pass, and each defect is reported."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from station.config.robots import RobotFile
from station.devices.driver_check import Finding, check_stages
from station.devices.interfaces import Condition, JointReading, Stages
from station.lab.config import StagesKind
from station.lab.simulated_stages import STAGES
from tests.harness.stages_bench import StagesBench

NEAR_HOME = (0.05, 0.3, -0.125)


class LabClock:
    """Clock in whose time the simulated stages run."""

    def __init__(self, bench: StagesBench) -> None:
        self._bench = bench

    def now(self) -> float:
        return self._bench.now

    def sleep(self, seconds: float) -> None:
        self._bench.let_pass(seconds)


def findings(
    paper: RobotFile, kind: StagesKind, change: Callable[[Stages], Any] = lambda stages: stages, moves: bool = True
) -> dict[str, Finding]:
    """Return the findings of a check, by their subjects; `change` makes the driver defective."""
    bench = StagesBench(paper, kind, NEAR_HOME, homed=False)
    clock = LabClock(bench)

    def opens() -> Stages:
        bench.host.reopen()
        return change(STAGES[kind].driver(bench.setups, bench.host))

    def stop(_: object) -> str:
        bench.host.reopen()
        bench.stages = STAGES[kind].driver(bench.setups, bench.host)
        bench.stages.connect(bench.now)
        bench.stages.stop(bench.now)
        bench.run(0.5)
        return "stopped"

    return {finding.subject: finding for finding in check_stages(opens, paper.joints, clock, stop, moves)}


class Changed:
    """A driver with some other attributes."""

    def __init__(self, stages: Stages, **others: Any) -> None:
        self._stages, self._others = stages, others

    def __getattr__(self, name: str) -> Any:
        return self._others[name] if name in self._others else getattr(self._stages, name)


@pytest.mark.parametrize("kind", list(STAGES))
def test_built_in_drivers_pass_every_check(paper, kind):
    found = findings(paper, kind)
    assert {"homing", "speed", "stop", "velocity nan", "speed limit", "emergency stop", "reopening"} <= set(found)
    assert [finding for finding in found.values() if not finding.good] == []


def test_stages_are_not_moved_without_permission(paper):
    found = findings(paper, "zaber_ascii", moves=False)
    assert "motions" in found
    assert "homing" not in found


def test_stop_without_effect_is_reported(paper):
    found = findings(paper, "cia402", lambda stages: Changed(stages, stop=lambda now: None))
    assert not found["stop"].good


def test_position_before_the_first_answer_is_reported(paper):
    def poll(stages: Stages) -> Callable[[float], JointReading]:
        return lambda now: stages.poll(now)._replace(positions=np.zeros(3))

    assert not findings(paper, "cia402", lambda stages: Changed(stages, poll=poll(stages)))["before connecting"].good


def test_stages_that_cannot_be_connected_end_the_check(paper):
    found = findings(paper, "cia402", lambda stages: Changed(stages, condition=Condition.FAULT))
    assert not found["session"].good
    assert "not connected" in found["session"].text


def test_driver_without_emergency_stop_is_reported(paper):
    bench = StagesBench(paper, "zaber_ascii", NEAR_HOME)

    def opens() -> Stages:
        bench.host.reopen()
        return STAGES["zaber_ascii"].driver(bench.setups, bench.host)

    found = {finding.subject: finding for finding in check_stages(opens, paper.joints, LabClock(bench), None, True)}
    assert not found["emergency stop"].good
