"""A motion ends in HOLD when the force on the tip exceeds the strength of the tubes or of the base sensors."""

import numpy as np

from station.config.loads import Load
from station.control.monitors import OVERLOAD_TIME_S
from station.control.states import State
from tests.harness.virtual_station import VirtualStation

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
