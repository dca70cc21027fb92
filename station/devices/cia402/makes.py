"""Makes of CANopen drives: how the object dictionary of each make differs from CiA 402.

Sources: the dictionary of an EPOS4 50/15 as its program exports it (maxon_epos4_ros_canopen/config/*.dcf in
github.com/Roboprotos/maxon_epos4_ros1); for Faulhaber motion controllers of generation 3 the plugin FaulhaberMCS of
itom (github.com/itom-project/plugins), which was written for a MCS 3242 BX4 ET.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

Entry = tuple[int, int]  #: index and subindex of an object
Make = Literal["generic", "epos4", "faulhaber"]
#: Objects that contain the units of position, velocity and acceleration, and the values of units that are used.
POSITION_UNIT, VELOCITY_UNIT, ACCELERATION_UNIT = (0x60A8, 0), (0x60A9, 0), (0x60AA, 0)
COUNTS, COUNTS_PER_S, MILLI_RPM, RPM_PER_S = 0x00B50000, 0x00B50300, 0xFDB44700, 0x00C00300


@dataclass(frozen=True)
class MakeFacts:
    """Properties by which a make of drives differs from CiA 402."""

    units: Mapping[Entry, int]  #: required values of the objects that contain units
    rotation_method: int  #: default homing method of a rotation: to the home switch in negative direction
    #: One motor turn/s and one motor turn/s^2 in the drive's units; None: these units are counts/s and counts/s^2.
    velocities_per_turn: float | None = None
    accelerations_per_turn: float | None = None
    settable: frozenset[Entry] = frozenset()  #: objects of `units` that the driver writes
    homing_methods: frozenset[int] | None = None  #: supported methods; None: all of CiA 402
    speed_limit: Entry | None = None  #: object that limits all velocities, in the unit of velocities


MAKES: Mapping[Make, MakeFacts] = {
    "generic": MakeFacts({POSITION_UNIT: COUNTS, VELOCITY_UNIT: COUNTS_PER_S}, 21),
    # Accelerations are in turns per minute and second, whatever the unit of velocities is.
    "epos4": MakeFacts(
        {POSITION_UNIT: COUNTS, VELOCITY_UNIT: MILLI_RPM, ACCELERATION_UNIT: RPM_PER_S}, 27, 60_000.0, 60.0,
        settable=frozenset((VELOCITY_UNIT,)),
        homing_methods=frozenset((-4, -3, -2, -1, 1, 2, 7, 11, 17, 18, 23, 27, 33, 34, 37)),
        speed_limit=(0x6080, 0),
    ),
    # Velocities are in turns per minute, but accelerations in turns per second squared.
    "faulhaber": MakeFacts(
        {}, 21, 60.0, 1.0, homing_methods=frozenset((*range(-4, 0), *range(1, 35), 37)), speed_limit=(0x6080, 0)
    ),
}  # fmt: skip
