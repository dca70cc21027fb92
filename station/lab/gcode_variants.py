"""Variants of the simulated G-code boards: the differences between real boards of one dialect.

Sources: GRBL 1.1h (`config.h`, `limits.c`, wiki pages of the interface), grblHAL (`report.c`), Marlin 2.1 (`M211.cpp`);
issue reports about boards that restart when their port is opened (Marlin #12815, #14548), and about FluidNC's settings
(FluidNC #687, #1036).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

#: Default values of the GRBL settings that the driver has to change.
AS_DELIVERED = {1: 25.0, 10: 1.0, 13: 0.0, 22: 1.0, 23: 0.0, 27: 1.0}


@dataclass(frozen=True)
class BoardVariant:
    """Differences of a board from the usual one."""

    boot: float = 0.5  #: time after a restart in which the board ignores bytes [s]
    single_homing: bool = True  #: GRBL: whether `$HX` homes one axis (HOMING_SINGLE_AXIS_COMMANDS)
    zero_at_home: bool = True  #: GRBL: whether the coordinate is 0 after homing (HOMING_FORCE_SET_ORIGIN)
    order: str = "XYZABC"  #: GRBL: letters of the axes in positions and settings
    fluidnc: bool = False  #: GRBL: whether settings have FluidNC's names, and `$$` lists only `$10`
    refuses_single: str = "error:3"  #: GRBL: answer to `$HX` without `single_homing`
    names_axes: bool = False  #: GRBL: whether the answer to `$I` contains the letters of the axes
    all_lengths: bool = False  #: GRBL: whether the answer to `$#` contains the tool length of each axis
    settings: Mapping[int, float] = field(default_factory=dict[int, float])  #: GRBL: different settings
    inches: bool = False  #: GRBL: whether a start-up block (`$N0 = G20`) chooses inches
    soft_endstops: str = "switchable"  #: Marlin: `switchable`, or `fixed` if `M211 S0` has no effect


#: FluidNC's settings of an axis, and the GRBL settings with the same meaning; GRBL itself has no settings from 900 on.
FLUIDNC_AXIS = {
    "steps_per_mm": 100, "max_rate_mm_per_min": 110, "acceleration_mm_per_sec2": 120, "max_travel_mm": 130,
    "homing/mpos_mm": 900, "soft_limits": 910, "homing/positive_direction": 920,
}  # fmt: skip
VARIANTS: Mapping[str, BoardVariant] = {
    "usual": BoardVariant(),
    "starts_slowly": BoardVariant(boot=3.0),
    "as_delivered": BoardVariant(single_homing=False, zero_at_home=False),
    "homes_down": BoardVariant(single_homing=False, zero_at_home=False, settings={23: 7.0}),
    "work_positions": BoardVariant(settings={10: 0.0}),
    "reports_inches": BoardVariant(settings={13: 1.0}),
    "reads_inches": BoardVariant(inches=True),
    "grblhal": BoardVariant(names_axes=True, all_lengths=True, settings={10: 511.0}),
    "fluidnc": BoardVariant(
        fluidnc=True, zero_at_home=False, settings={900: 3.0, 901: 0.0, 902: -2.0, 910: 0.0, 911: 0.0, 912: 0.0}
    ),
}
