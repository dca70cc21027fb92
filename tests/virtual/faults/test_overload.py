"""A motion ends in HOLD when the force on the tip exceeds its bound, and a jog then takes the force off."""

import numpy as np
import pytest

from station.config.controllers import default_controller
from station.config.loads import Load, WallLoad
from station.config.motions import HoldMotion, Orders
from station.control.monitors import OVERLOAD_TIME_S
from station.control.states import RefusedError, State
from station.control.task import MotionTask
from tests.harness.virtual_station import VirtualStation, usual_case

STIFFNESS_N_M = 2000.0
#: Fraction of the change of the wall's force that one tick applies. It must be below 1 / (stiffness of the wall *
#: compliance of the tip), otherwise force and tip oscillate.
SHARE_A_TICK = 0.01


class Wall:
    """Wall with a stiffness of 2000 N/m that moves 8 mm toward the tip in 8 s."""

    contact = np.inf

    def __init__(self, station: VirtualStation) -> None:
        self._station, self._face, self._force = station, station.lab.truth.tip[0], 0.0

    def force(self, time: float) -> np.ndarray:
        depth = self._face + 1e-3 * min(time, 8.0) - self._station.lab.truth.tip[0]
        # The tip yields by some 30 mm/N. If a tick applied the whole change, force and tip would oscillate.
        self._force += SHARE_A_TICK * (STIFFNESS_N_M * max(0.0, depth) - self._force)
        return np.array([self._force, 0.0, 0.0])


def test_motion_against_a_stiff_wall_ends_in_hold_before_a_force_sensor_saturates(virtual: VirtualStation) -> None:
    virtual.moving(duration=30.0)
    bound = virtual.case.controller.limits.overload
    assert bound is not None
    wall: Load = Wall(virtual)  # type: ignore[assignment]
    virtual.lab.apply_load(wall, virtual.now)
    virtual.until(lambda: virtual.state is not State.RUNNING, 12.0)

    assert virtual.state is State.HOLD
    assert f"is above {bound.newton:.2g} N ({bound.reason})" in virtual.loop.cause
    assert "saturated" not in virtual.loop.cause
    forces = np.linalg.norm(virtual.of("force"), axis=1)
    # More than the single samples that noise raises; the bound also applies to what the estimate cannot know.
    assert np.count_nonzero(forces > 0.85 * bound.newton) >= 0.3 * OVERLOAD_TIME_S / 0.002
    virtual.seconds(0.4)
    assert virtual.rests()


@pytest.mark.parametrize(
    ("at", "without", "max_force"),
    [
        *((at, (), None) for at in ("tubes", "robot", "inner")),
        *(("tubes", without, None) for without in (("tracker",), ("sensors",))),
        ("tubes", (), 0.5),
    ],
)
def test_the_first_jog_away_from_an_overload_takes_the_force_off(at, without, max_force) -> None:
    case = usual_case()
    robot = case.robot.model_copy(update={"max_force": max_force}).sensed_at(at, "at")
    lab = case.lab.leaving_out(without).model_copy(update={"sensors": case.lab.sensors.model_copy(update={"at": at})})
    controller = default_controller(lab.present).controller(robot, lab.present)
    station = VirtualStation(case._replace(robot=robot, lab=lab, controller=controller)).ready()
    station.seconds(2.0)
    station.lab.apply_load(WallLoad(direction=(-1.0, 0.0, 0.0), distance=0.002, stiffness=1000.0), station.now)
    while station.state is not State.HOLD:
        station.loop.jog(station.now, "tip", np.array([0.004, 0.0, 0.0]))
        station.seconds(0.1)
    station.seconds(0.3)
    overload = np.linalg.norm(station.lab.truth.force)
    station.loop.reset(station.now)
    with pytest.raises(RefusedError, match="the force on the tip"):
        station.loop.start(MotionTask(controller, Orders(HoldMotion(), robot.robot()), 1.0))
    while (force := np.linalg.norm(station.lab.truth.force)) > 0.02:
        assert force < overload + 0.02
        station.loop.jog(station.now, "tip", np.array([-0.002, 0.0, 0.0]))  # is refused after another HOLD
        station.seconds(0.1)
