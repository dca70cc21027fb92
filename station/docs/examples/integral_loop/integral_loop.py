"""An outer loop with integral action: U_int = K1 (X_des - X) + KI * integral of (X_des - X).

Without the integral, eq. (30) leaves a constant error under a constant disturbance of the tip's velocity.
"""

from dataclasses import dataclass, field

import numpy as np

from core.control.controllers import PositionMode
from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.config.plugins import Setup


@dataclass
class IntegralLoop:
    """Outer loop with a state: the integral of the tip's error, bounded so that it cannot grow at a joint's limit."""

    mode: PositionMode  #: eq. (30)
    gain: float  #: KI [1/s^2]
    most: float  #: largest velocity of the integral part along each axis [m/s]
    dt: float  #: time between two calls [s]
    part: Array = field(default_factory=lambda: np.zeros(3))  #: integral part of the velocity (3,) [m/s]

    def reset(self) -> None:
        """Forget the integral; called before each motion."""
        self.part = np.zeros(3)

    def tip_velocity(self, setpoint: Setpoint, tip: Array) -> Array:
        """Return U_int (3,) [m/s]."""
        error = setpoint.position - tip
        self.part = np.clip(self.part + self.dt * self.gain * error, -self.most, self.most)
        return self.mode.tip_velocity(setpoint, tip) + self.part


def make(setup: Setup) -> IntegralLoop:
    """Return the loop; its keys in the file are `ki` [1/s^2] and `most` [m/s]."""
    keys = {"ki": 1.0, "most": 0.005} | dict(setup.options)
    if unknown := keys.keys() - {"ki", "most"}:
        raise ValueError(f"{sorted(unknown)[0]} is unknown; the keys are ki and most")
    if not (0.0 <= keys["ki"] <= 10.0 and 0.0 < keys["most"] <= 0.05):
        raise ValueError(f"ki = {keys['ki']}, most = {keys['most']}: expected ki 0 ... 10 1/s^2, most 0 ... 0.05 m/s")
    return IntegralLoop(setup.gains, float(keys["ki"]), float(keys["most"]), setup.dt)
