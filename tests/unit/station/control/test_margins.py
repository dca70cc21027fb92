"""A snap is a sudden change of the difference between tracker and model; drift of the sensors is not a snap."""

import numpy as np
import pytest

from core.control.estimation import Estimate
from core.control.force_fusion import FusedLoad
from core.control.step import ControllerState, Tick
from core.control.trajectories import Setpoint
from core.model.solution import pure_force
from core.model.statics import Statics
from station.config.robots import load_robot
from station.control.margins import CONFIRMING_FRAMES, Margins, SnapMonitor
from station.devices.interfaces import DeviceFault, Severity

HOUR = 3600


@pytest.fixture(scope="module")
def statics() -> Statics:
    return Statics(load_robot("paper").robot())


class Drifting:
    """Robot at rest whose force sensors drift: the tip of the model moves with the drift, the tracked tip stays."""

    def __init__(self, statics: Statics, rate: float) -> None:
        joints = np.array([0.0, 1.5708, -0.1])
        free = statics.solve(joints, np.zeros(6))
        loaded = statics.solve(joints, pure_force(np.array([0.1, 0.0, 0.0])), free)
        nothing = np.zeros(3)
        self._free, self._bent, self._rate = free.tip, loaded.tip, rate
        memory = ControllerState(Estimate(loaded, free, np.zeros(1)), free.tip, free.tip)
        self._tick = Tick(
            nothing, FusedLoad(nothing, nothing), nothing, Setpoint(nothing, nothing), nothing, nothing, nothing, memory
        )
        self.monitor = SnapMonitor(Margins())

    def frame(self, now: float, jump: float = 0.0) -> DeviceFault | None:
        """Check a tracker frame at `now` [s] whose tip has jumped by `jump` along z [m].

        The drift is applied to the tracked tip with the opposite sign; only the difference to the model counts.
        """
        tip = self._free - np.array([self._rate * now, 0.0, -jump])
        return self.monitor.check(self._tick._replace(memory=self._tick.memory._replace(tip=tip)), True, now)


def test_eight_hours_of_sensor_drift_do_not_count_as_a_snap(statics: Statics) -> None:
    # Two sensors drift by 5 mN a minute on three axes. With 42 mm/N that is 0.5 mm a minute, and 250 mm at the end.
    robot = Drifting(statics, 0.5e-3 / 60.0)

    assert not any(robot.frame(float(now)) for now in range(8 * HOUR))


def test_snap_after_an_hour_of_sensor_drift_causes_stop(statics: Statics) -> None:
    robot = Drifting(statics, 0.5e-3 / 60.0)
    for now in range(HOUR):
        assert robot.frame(float(now)) is None

    found = [robot.frame(HOUR + 0.025 * frame, jump=0.035) for frame in range(CONFIRMING_FRAMES)]

    assert found[:-1] == [None] * (CONFIRMING_FRAMES - 1)
    assert found[-1] is not None
    assert found[-1].severity is Severity.STOP
    assert "tracker and model has changed by 35 mm" in found[-1].text


def test_lasting_tip_jump_does_not_become_the_reference_of_the_snap_monitor(statics: Statics) -> None:
    robot = Drifting(statics, 0.0)
    robot.frame(0.0)

    found = [robot.frame(float(now), jump=0.035) for now in range(1, 200)]

    assert all(found[CONFIRMING_FRAMES - 1 :])
