"""Object dictionaries of CANopen drives as their makers publish them: size and limits of each object.

* `epos4`: maxon EPOS4 50/15, as its program exports it: `epos4_50_15_can_ec90flat_gp52c_mile800_node1_hm.dcf` in
  https://github.com/Roboprotos/maxon_epos4_ros1 (folder maxon_epos4_ros_canopen/config).
* `faulhaber`: MCS 3242 BX4 ET, by the registers of the plugin FaulhaberMCS in
  https://github.com/itom-project/plugins. The plugin does not use all objects, so only those listed are judged.
"""

from typing import NamedTuple

from station.devices.cia402.makes import Make


class Entry(NamedTuple):
    """One object of a dictionary."""

    size: int  #: [bytes]
    least: int = -(1 << 31)  #: smallest value
    most: int = (1 << 32) - 1  #: largest value
    writable: bool = True


READ = {"writable": False}
COUNT, MAPPED = Entry(1, 0, 12), Entry(4)
EPOS4 = {
    (0x1000, 0): Entry(4, **READ), **{(0x1018, sub): Entry(4, **READ) for sub in range(1, 5)},
    (0x1016, 1): Entry(4), (0x1400, 1): Entry(4), (0x1400, 2): Entry(1), (0x1800, 1): Entry(4), (0x1800, 2): Entry(1),
    **{(index, sub): MAPPED if sub else COUNT for index in (0x1600, 0x1A00) for sub in range(13)},
    (0x6007, 0): Entry(2), (0x603F, 0): Entry(2, **READ), (0x6040, 0): Entry(2), (0x6041, 0): Entry(2, **READ),
    (0x605A, 0): Entry(2), (0x6060, 0): Entry(1), (0x6064, 0): Entry(4, **READ), (0x607A, 0): Entry(4),
    (0x607D, 1): Entry(4), (0x607D, 2): Entry(4), (0x607F, 0): Entry(4, 1), (0x6080, 0): Entry(4, 1),
    (0x6081, 0): Entry(4, 1), (0x6083, 0): Entry(4, 1), (0x6084, 0): Entry(4, 1), (0x6085, 0): Entry(4, 1),
    (0x6086, 0): Entry(2), (0x6098, 0): Entry(1, -4, 37), (0x6099, 1): Entry(4, 1), (0x6099, 2): Entry(4, 1),
    (0x609A, 0): Entry(4, 1), (0x60A8, 0): Entry(4, 0x00B50000, 0x00B50000), (0x60A9, 0): Entry(4),
    (0x60AA, 0): Entry(4, 0x00C00300, 0x00C00300), (0x60C5, 0): Entry(4, 1), (0x60FF, 0): Entry(4),
}  # fmt: skip
FAULHABER = {
    **{(0x1018, sub): Entry(4, **READ) for sub in range(1, 5)},
    (0x6040, 0): Entry(2), (0x6041, 0): Entry(2, **READ), (0x6060, 0): Entry(1), (0x6064, 0): Entry(4, **READ),
    (0x607A, 0): Entry(4), (0x607C, 0): Entry(4), (0x607D, 1): Entry(4), (0x607D, 2): Entry(4),
    (0x6080, 0): Entry(4, 1, 32767), (0x6081, 0): Entry(4, 1, 32767), (0x6083, 0): Entry(4, 1, 30000),
    (0x6084, 0): Entry(4, 1, 30000), (0x6085, 0): Entry(4, 1, 32750), (0x6086, 0): Entry(2, 0, 1),
    (0x6098, 0): Entry(1, -4, 37), (0x6099, 1): Entry(4), (0x6099, 2): Entry(4), (0x609A, 0): Entry(4, 1),
}  # fmt: skip
#: Objects of each make, and whether an object that is not listed does not exist.
DICTIONARIES: dict[Make, tuple[dict[tuple[int, int], Entry], bool]] = {
    "epos4": (EPOS4, True), "faulhaber": (FAULHABER, False),
}  # fmt: skip
