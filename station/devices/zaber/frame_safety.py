"""Prevents Zaber units from misreading the host's messages after bytes were lost or added.

A unit that has lost the message boundaries interprets any six bytes in a row as a message, until the line is silent for
10 ms. The units execute Reset, Home and Renumber with any data. So the host avoids byte sequences that a unit could
misread as one of these commands:

* A query and a stop carry the data -1. Its four bytes are 255, which is neither a command nor the number of a unit. A
  speed of 0 is sent as a stop.
* Each unit gets an alias whose number is no command. The last byte of a forward speed is 0, which addresses all units;
  the following byte is such an alias, and therefore no command.
* The low byte of a speed is none of these commands, because a unit reads this byte as a command if the byte before it
  is lost. If the second byte of a speed is such a command, the low byte is not the number of a unit.

One case remains: a forward speed ends with the bytes 0 0, which mean a Reset of all units. A unit that has lost three
or four bytes since the last silence can read these bytes as a Reset. The Reset stops the motor and loses the position,
which the driver detects. A pause after each forward speed (`LineSettings.pause`) prevents this case, too, but halves
the rate of velocities.
"""

from collections.abc import Collection

from station.devices.zaber.protocol import ZaberCommand

#: Commands that units execute with any data, and Restore, which units execute with data 0.
UNCONDITIONAL_COMMANDS = frozenset(
    {int(ZaberCommand.RESET), int(ZaberCommand.HOME), int(ZaberCommand.RENUMBER), int(ZaberCommand.RESTORE)}
)
FIRST_ALIAS = 192  #: alias of the first unit; no command has this number or one of the next numbers
NO_DATA = -1  #: data of commands whose data the unit ignores


def alias_number(index: int) -> int:
    """Return the alias of the unit at `index` of its chain, counted from 0."""
    return FIRST_ALIAS + index


def safe_speed(speed: int, listeners: Collection[int]) -> int:
    """Return the nearest speed that units with the numbers `listeners` cannot misread as a dangerous command."""
    if speed == 0:
        return 0
    for away in range(256):
        for near in (speed - away, speed + away) if speed > 0 else (speed + away, speed - away):
            low, high = near & 0xFF, near >> 8 & 0xFF
            if near == 0 or (
                low not in UNCONDITIONAL_COMMANDS and not (low in listeners and high in UNCONDITIONAL_COMMANDS)
            ):
                return near
    raise AssertionError("fewer than 256 low bytes are taken")
