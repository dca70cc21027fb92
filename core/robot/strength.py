"""The largest tip force that the tubes and their base sensors can bear.

A force F across a robot that reaches L beyond the plate bends the robot with a moment of at most F L. The largest force
is the smallest of three bounds:

* a base sensor's force:  F = 0.6 force range
* a base sensor's moment: F = 0.6 moment range  sum(EI) / (max(EI) L): tubes share the moment in proportion to EI
* the innermost tube alone: F = EI (strain limit / radius - curvature imposed by the tubes) / L

The rest of each sensor range is reserved for the forces and moments between the tubes, which the sensors also measure.
In the paper's robot the moments between the tubes take 90 N mm of the range of 250 N mm.
"""

import math
from collections.abc import Sequence

from core.robot.limits import ForceBound, JointLimit
from core.robot.robot import Robot

#: Largest fraction of a base sensor's range that the load may use.
LOAD_PART = 0.6
#: Largest strain at a tube's surface (no unit): with a reserve, nitinol and nylon still recover their shape from it.
MAX_STRAIN = 0.03
#: Ranges of the ATI Nano43 SI-18-0.25, the sensor of the paper's bench: force [N] and moment [N m].
NANO43_RANGES = (18.0, 0.25)


def force_bound(robot: Robot, joints: Sequence[JointLimit], ranges: tuple[float, float] = NANO43_RANGES) -> ForceBound:
    """Return the largest tip force [N] that tubes and sensors can bear; `ranges` are those of a sensor [N, N m]."""
    slide = next((k for k, joint in enumerate(robot.joints) if (joint.tube, joint.motion) == (0, "translation")), None)
    inner = robot.tubes[0]
    reach = inner.length + (inner.translation if slide is None else joints[slide].upper)
    stiffness = [tube.bending_stiffness for tube in robot.tubes]
    curved = [max(math.hypot(*section.curvature) for section in tube.sections) for tube in robot.tubes]
    reserve = MAX_STRAIN / (0.5 * inner.outer_diameter) - curved[0] - max(curved[1:], default=0.0)
    force, moment = (LOAD_PART * each for each in ranges)
    bounds = (
        ForceBound(force, "the force range of a base sensor"),
        ForceBound(moment * sum(stiffness) / (max(stiffness) * reach), "the moment range of a base sensor"),
        ForceBound(inner.bending_stiffness * reserve / reach, f"the strain of tube '{inner.name}'"),
    )
    return min((bound for bound in bounds if bound.newton > 0.0), key=lambda bound: bound.newton)
