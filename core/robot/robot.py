"""Description of a concentric-tube robot: tubes from the innermost outward, and the joints that move them.

Conventions: the world's origin is at the front plate, +z points along the straight tubes, and the arc length is 0 at
the plate. `beta` of a tube is the position of its proximal end along z (never positive). A rigid guide keeps the tubes
straight behind the plate. A precurvature (1/r, 0) at rotation 0 bends the free tube toward -y.

The tip is always the distal end of the innermost tube, which carries the tracker's coil, even if this tube is retracted
into outer tubes. The tip therefore never jumps when tube ends pass each other. The load acts at the tip.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.compiled import Shapes, compiled, part
from core.errors import DescriptionError, PoseError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

#: Largest number of tubes, largest number of sections per tube, and largest length of a tube [m]. Real robots are
#: smaller. The bounds reveal a wrong length unit, with which a solve would take hours.
MAX_TUBES, MAX_SECTIONS, MAX_LENGTH_M = 8, 50, 5.0
#: Largest distance at which a tube's end counts as flush with another one or with the plate [m]: it covers rounding in
#: sums of lengths and positions.
FLUSH_TOLERANCE_M = 1e-9


@dataclass(frozen=True)
class Section:
    """A part of a tube whose unloaded shape is a circular arc or straight."""

    length: float  #: length of the section [m]
    curvature: tuple[float, float] = (0.0, 0.0)  #: curvature about x and y of the tube's frame [1/m]


@dataclass(frozen=True)
class Tube:
    """One elastic tube; its sections are ordered from the proximal end."""

    name: str
    sections: tuple[Section, ...]
    bending_stiffness: float  #: bending stiffness EI [N m^2], equal in both directions
    poisson_ratio: float = 0.30  #: Poisson's ratio nu, which sets the torsional stiffness GJ = EI / (1 + nu)
    outer_diameter: float = 2e-3  #: outer diameter [m], for drawings and for checking that tubes fit into each other
    inner_diameter: float = 1e-3  #: inner diameter [m]
    torsional_stiffness: float | None = None  #: torsional stiffness GJ [N m^2]; None: from poisson_ratio
    rotation: float = 0.0  #: rotation of a tube without rotation joint [rad]
    translation: float = 0.0  #: proximal end of a tube without translation joint [m]
    weight: float = 0.0  #: own weight [N/m], for calibration only: the control model ignores it
    max_strain: float = 0.08  #: largest strain from which the material recovers its shape; 0.08: superelastic nitinol

    def __post_init__(self) -> None:
        positive(f"tube '{self.name}': bending_stiffness", self.bending_stiffness, "N m^2")
        if self.torsional_stiffness is not None:
            positive(f"tube '{self.name}': torsional_stiffness", self.torsional_stiffness, "N m^2")
        if not math.isfinite(self.rotation):
            raise DescriptionError(f"tube '{self.name}': rotation {self.rotation} rad is not finite")
        if not -math.inf < self.translation <= 0.0:
            raise DescriptionError(
                f"tube '{self.name}': translation {1e3 * self.translation:g} mm must be finite and not in front"
                " of the plate at 0 mm"
            )
        if not -1.0 < self.poisson_ratio <= 0.5:
            raise DescriptionError(f"tube '{self.name}': poisson_ratio {self.poisson_ratio:g} is outside -1 ... 0.5")
        if not self.sections:
            raise DescriptionError(f"tube '{self.name}' has no sections; it needs at least one")
        for number, section in enumerate(self.sections, 1):
            positive(f"tube '{self.name}': length of section {number}", section.length, "m")
            if not all(math.isfinite(u) for u in section.curvature):
                raise DescriptionError(f"tube '{self.name}': curvature of section {number} is not finite")
        if len(self.sections) > MAX_SECTIONS:
            raise DescriptionError(f"tube '{self.name}' has {len(self.sections)} sections; at most {MAX_SECTIONS}")
        if self.length > MAX_LENGTH_M:
            raise DescriptionError(
                f"tube '{self.name}': length {self.length:g} m is beyond {MAX_LENGTH_M:g} m; lengths are in metres"
            )
        positive(f"tube '{self.name}': outer_diameter", self.outer_diameter, "m")
        if not 0.0 <= self.inner_diameter < self.outer_diameter:
            raise DescriptionError(
                f"tube '{self.name}': inner_diameter {1e3 * self.inner_diameter:g} mm is outside"
                f" 0 ... {1e3 * self.outer_diameter:g} mm (its outer diameter)"
            )
        if not 0.0 <= self.weight < math.inf:
            raise DescriptionError(f"tube '{self.name}': weight {self.weight:g} N/m must be finite and not negative")
        positive(f"tube '{self.name}': max_strain", self.max_strain, "")

    @property
    def length(self) -> float:
        """Total length of all sections, straight and curved [m]."""
        return sum(section.length for section in self.sections)

    @property
    def stiffness_ratio(self) -> float:
        """Ratio of bending to torsional stiffness, EI / GJ."""
        if self.torsional_stiffness is None:
            return 1.0 + self.poisson_ratio
        return self.bending_stiffness / self.torsional_stiffness


@dataclass(frozen=True)
class Joint:
    """One motor: it turns or slides one tube at its proximal end."""

    name: str
    tube: int  #: index of the tube; 0 is the innermost
    motion: Literal["rotation", "translation"]

    @property
    def unit(self) -> str:
        """Unit of the joint's position."""
        return "rad" if self.motion == "rotation" else "m"


@dataclass(frozen=True)
class Base:
    """Pose of the front plate in the world: x_world = R(rotation_vector) x_plate + position."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: position of the plate's origin [m]
    rotation_vector: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: rotation of the plate, axis times angle [rad]

    def __post_init__(self) -> None:
        for name, vector in (("position", self.position), ("rotation_vector", self.rotation_vector)):
            if len(vector) != 3 or not all(math.isfinite(number) for number in vector):
                raise DescriptionError(f"base: {name} {vector} must be three finite numbers")

    @property
    def rotation(self) -> Array:
        """Rotation matrix of the plate (3, 3), by Rodrigues' formula."""
        x, y, z = self.rotation_vector
        angle = math.sqrt(x * x + y * y + z * z)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        if angle == 0.0:
            return np.eye(3)
        half = math.sin(0.5 * angle) / angle
        return np.eye(3) + math.sin(angle) / angle * cross + 2.0 * half * half * cross @ cross


class Layout(NamedTuple):
    """The robot in arrays for compiled code; q tubes, n joints, at most k sections per tube."""

    ends: Array  #: (q, k) arc offset of each section's end from the tube's proximal end [m]
    curvatures: Array  #: (q, k, 2) curvature of each section [1/m]
    counts: Indices  #: (q,) number of sections of each tube
    stiffness: Array  #: (q, 2) bending stiffness EI [N m^2], and ratio EI / GJ
    joint_tube: Indices  #: (n,) index of the tube that each joint moves
    joint_slides: Indices  #: (n,) 1 for a translation, 0 for a rotation
    rest: Array  #: (q, 2) rotation [rad] and translation [m] of each tube, used where no joint sets the value
    base: Array  #: (12,) rotation of the plate by rows, then its position [m]
    carried: Indices  #: (s,) index of the tube that each force sensor carries; -1: it carries the whole robot


@dataclass(frozen=True)
class Robot:
    """Description of a robot: tubes from the innermost outward, and joints in the order of every joint vector."""

    name: str
    tubes: tuple[Tube, ...]
    joints: tuple[Joint, ...]
    base: Base = Base()
    #: "paper": the model uses the paper's integrator while it is accurate enough, see `statics.suitable_integrator`
    integrator: Literal["paper"] | None = None
    #: location of the force sensors: "tubes", one sensor at each tube; "robot", one sensor under the plate; or the name
    #: of the only tube with a sensor
    sensed: str = "tubes"

    def __post_init__(self) -> None:
        if not self.tubes:
            raise DescriptionError(f"robot '{self.name}' has no tubes; it needs at least one")
        if len(self.tubes) > MAX_TUBES:
            raise DescriptionError(
                f"robot '{self.name}' has {len(self.tubes)} tubes; at most {MAX_TUBES} are supported"
            )
        for inner, outer in zip(self.tubes, self.tubes[1:], strict=False):
            if inner.outer_diameter > outer.inner_diameter:
                raise DescriptionError(
                    f"tube '{inner.name}' of {1e3 * inner.outer_diameter:g} mm does not fit into"
                    f" tube '{outer.name}' of {1e3 * outer.inner_diameter:g} mm inner diameter"
                )
        seen: set[tuple[int, str]] = set()
        for joint in self.joints:
            if not 0 <= joint.tube < len(self.tubes):
                raise DescriptionError(
                    f"joint '{joint.name}': tube {joint.tube} is outside 0 ... {len(self.tubes) - 1}"
                )
            if joint.motion not in ("rotation", "translation"):
                raise DescriptionError(f"joint '{joint.name}': motion '{joint.motion}' must be rotation or translation")
            if (joint.tube, joint.motion) in seen:
                raise DescriptionError(f"joint '{joint.name}': {joint.motion} of tube {joint.tube} already has a joint")
            seen.add((joint.tube, joint.motion))
        if len({joint.name for joint in self.joints}) < len(self.joints):
            raise DescriptionError(f"robot '{self.name}': two joints have the same name")
        self._check_fixed_tubes({tube for tube, motion in seen if motion == "translation"})

    def _check_fixed_tubes(self, sliding: set[int]) -> None:
        """Reject fixed tubes (without translation joint) that collide with each other or end inside the guide."""
        fixed = [tube for i, tube in reversed(list(enumerate(self.tubes))) if i not in sliding]
        for tube in fixed:
            if (end := tube.translation + tube.length) < -FLUSH_TOLERANCE_M:
                raise DescriptionError(f"tube '{tube.name}' {_behind_plate(end)}")
        for outer, inner in pairwise(fixed):
            if inner.translation > outer.translation:
                raise DescriptionError(
                    f"tube '{inner.name}' starts at {1e3 * inner.translation:g} mm,"
                    f" in front of tube '{outer.name}' at {1e3 * outer.translation:g} mm"
                )

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Names of the parts that the force sensors carry: tubes, or `robot` for the whole robot."""
        return tuple(tube.name for tube in self.tubes) if self.sensed == "tubes" else (self.sensed,)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of every joint vector."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def layout(self) -> Layout:
        """Description of the robot as arrays for compiled functions."""
        q, k = len(self.tubes), max(len(tube.sections) for tube in self.tubes)
        at = {tube.name: i for i, tube in enumerate(self.tubes)}
        ends, curvatures = np.zeros((q, k)), np.zeros((q, k, 2))
        for i, tube in enumerate(self.tubes):
            ends[i, : len(tube.sections)] = np.cumsum([section.length for section in tube.sections])
            curvatures[i, : len(tube.sections)] = [section.curvature for section in tube.sections]
        return Layout(
            ends,
            curvatures,
            np.array([len(tube.sections) for tube in self.tubes], dtype=np.int64),
            np.array([[tube.bending_stiffness, tube.stiffness_ratio] for tube in self.tubes]),
            np.array([joint.tube for joint in self.joints], dtype=np.int64),
            np.array([joint.motion == "translation" for joint in self.joints], dtype=np.int64),
            np.array([[tube.rotation, tube.translation] for tube in self.tubes]),
            np.concatenate((self.base.rotation.ravel(), self.base.position)),
            np.array([at.get(name, -1) for name in self.sensor_names], dtype=np.int64),
        )

    @cached_property
    def packed(self) -> Array:
        """The layout in one array, because every array argument adds time to the call of a compiled function."""
        q, k = self.layout.ends.shape
        sizes = np.array([q, k, len(self.joints), len(self.sensor_names)], dtype=np.int64)
        return np.concatenate([np.ascontiguousarray(part).ravel().view(np.float64) for part in (sizes, *self.layout)])

    def tube_poses(self, joints: Array) -> tuple[Array, Array]:
        """Return rotation alpha (q,) [rad] and proximal end beta (q,) [m] of every tube at `joints` (n,)."""
        alpha, beta, _ = tube_poses(self.layout, joints)
        return alpha, beta

    def tube_ends(self, joints: Array) -> Array:
        """Return the arc length (q,) from the plate to every tube's distal end [m]; the first one is the tip's."""
        return self.tube_poses(joints)[1] + np.array([tube.length for tube in self.tubes])

    def is_valid_pose(self, joints: Array) -> bool:
        """Return whether the pose `joints` (n,) is valid; `check_pose` gives the reason if not."""
        return bool(tube_poses(self.layout, joints)[2])

    def check_pose(self, joints: Array) -> None:
        """Reject invalid joint positions.

        Raises:
            PoseError: a position is not finite; a proximal end is in front of the plate or of the next outer tube's
                proximal end; or a tube ends behind the plate. A tube may end at the plate, or inside another tube.

        """
        if joints.shape != (len(self.joints),):
            raise PoseError(f"joints have shape {joints.shape}; '{self.name}' needs ({len(self.joints)},)")
        for joint, value in zip(self.joints, joints, strict=True):
            if not math.isfinite(value):
                raise PoseError(f"{joint.name} is {value}; it must be a finite number of {joint.unit}")
        _, beta = self.tube_poses(joints)
        bound, around = 0.0, "the plate"
        for tube, start in zip(reversed(self.tubes), reversed(beta), strict=True):
            if start > bound:
                raise PoseError(
                    f"tube '{tube.name}' starts at {1e3 * start:g} mm, in front of {around} at {1e3 * bound:g} mm"
                )
            bound, around = start, f"tube '{tube.name}'"
        for tube, end in zip(self.tubes, self.tube_ends(joints).tolist(), strict=True):
            if end < -FLUSH_TOLERANCE_M:
                raise PoseError(f"tube '{tube.name}' {_behind_plate(end)}")

    def check_contact(self, joints: Array, contact: float | None) -> float:
        """Return the arc length of a contact from the plate [m]; inf for None (a contact at the tip).

        Raises:
            PoseError: the contact is behind the plate or beyond the last tube end.

        """
        if contact is None:
            return math.inf
        length = max(float(self.tube_ends(joints).max()), 0.0)
        if not 0.0 <= contact <= length:
            raise PoseError(f"contact at {1e3 * contact:g} mm is outside 0 ... {1e3 * length:g} mm (the last tube end)")
        return contact


@compiled
def _shapes(q: int, k: int, n: int, s: int) -> Shapes:
    """Return the shapes of the sizes q, k, n and s, and of each array of a `Layout`, in `Robot.packed`."""
    return (1, 4), (q, k), (q, 2 * k), (1, q), (q, 2), (1, n), (1, n), (q, 2), (1, 12), (1, s)


@compiled
def unpack(packed: Array) -> Layout:
    """Return the layout of `Robot.packed`; its arrays are views."""
    sizes = packed[:4].view(np.int64)
    q, k = sizes[0], sizes[1]
    shapes = _shapes(q, k, sizes[2], sizes[3])
    return Layout(
        part(packed, shapes, 1),
        part(packed, shapes, 2).reshape(q, k, 2),
        part(packed, shapes, 3)[0].view(np.int64),
        part(packed, shapes, 4),
        part(packed, shapes, 5)[0].view(np.int64),
        part(packed, shapes, 6)[0].view(np.int64),
        part(packed, shapes, 7),
        part(packed, shapes, 8)[0],
        part(packed, shapes, 9)[0].view(np.int64),
    )


def _behind_plate(end: float) -> str:
    return f"ends at {round(1e3 * end, 6):g} mm, but must not end behind the plate at 0 mm"


@compiled
def farthest_end(layout: Layout, beta: Array) -> float:
    """Return the arc length from the plate to the most distal end of any tube [m], at the proximal ends `beta` (q,)."""
    farthest = 0.0
    for i in range(beta.shape[0]):
        farthest = max(farthest, beta[i] + layout.ends[i, layout.counts[i] - 1])
    return farthest


@compiled
def tube_poses(layout: Layout, joints: Array) -> tuple[Array, Array, bool]:
    """Return rotation alpha (q,) [rad] and proximal end beta (q,) [m] of every tube, and whether `joints` is valid.

    `Robot.check_pose` gives the reason for an invalid pose.
    """
    q = layout.counts.shape[0]
    alpha, beta = layout.rest[:, 0].copy(), layout.rest[:, 1].copy()
    for j in range(joints.shape[0]):
        if layout.joint_slides[j]:
            beta[layout.joint_tube[j]] = joints[j]
        else:
            alpha[layout.joint_tube[j]] = joints[j]
    start, valid = 0.0, True
    for i in range(q - 1, -1, -1):
        end = beta[i] + layout.ends[i, layout.counts[i] - 1]
        valid = valid and beta[i] <= start and end >= -FLUSH_TOLERANCE_M and np.isfinite(alpha[i])
        start = beta[i]
    return alpha, beta, valid


@compiled
def sensor_poses(layout: Layout, joints: Array) -> tuple[Array, Array]:
    """Return rotation (s,) [rad] and position along z (s,) [m] of every force sensor in the plate's frame.

    A sensor that carries a tube moves with the tube's proximal end; a sensor of the whole robot is fixed to the plate.
    """
    alpha, beta, _ = tube_poses(layout, joints)
    turned, at = np.zeros(layout.carried.shape[0]), np.zeros(layout.carried.shape[0])
    for i in range(turned.shape[0]):
        if layout.carried[i] >= 0:
            turned[i], at[i] = alpha[layout.carried[i]], beta[layout.carried[i]]
    return turned, at


def positive(what: str, value: float, unit: str) -> None:
    """Raise DescriptionError for a `value` that is not finite and greater than 0; the text names `what`."""
    if not (math.isfinite(value) and value > 0.0):
        raise DescriptionError(f"{what} {value:g} {unit} must be finite and greater than 0")
