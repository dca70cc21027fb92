"""An inner loop that compensates only a share of the deflection, to compare with the built-in loops.

It is eq. (21) with a weight: J(q, w) q' = U_int - share C w'. Importing this module registers `firm`.
"""

from dataclasses import dataclass

from core.control.controllers import INNER_LOOPS, LoopInputs
from core.control.velocity_ik import VelocityTask
from core.robot.robot import Array


@dataclass(frozen=True)
class FirmLoop:
    """Inner loop that compensates `share` of the velocity that the changing load causes."""

    share: float = 0.5  #: 0: no compensation; 1: all of it

    def __call__(self, u_int: Array, view: LoopInputs, /) -> VelocityTask:
        """Return the equation (3, n), (3,) that the joint velocities must solve."""
        return VelocityTask(view.loaded.jacobian[:3], u_int - self.share * view.load_rate)


INNER_LOOPS["firm"] = FirmLoop()
