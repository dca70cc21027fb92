"""Prevents Zaber units from misreading the host's messages after bytes were lost or added.

A unit that has lost the frame interprets any six bytes in a row as a message, until the line is silent for 10 ms.
Reset, Home and Renumber act with any data. So no stream is sent that can be read as one of them:

* A query, a stop and a speed of 0 (which is sent as a stop) carry -1: all following bytes are 255, an unused number.
* Each unit gets an alias whose number is no command. Then a speed's last 0 and the next message's first byte
  are no command to all units.
* The low byte of a speed is no such command, in case the byte before it is lost. It is not the number of a unit
  if the byte after it is such a command.

Forward speeds remain: their last bytes are 0 0, a Reset of all units, for a unit that has lost three or four
bytes since the last silence. The Reset stops the motor and loses the position, which is detected. A pause after each
forward speed (`LineSettings.pause`) prevents this, too, but halves the rate of velocities.
"""

from collections.abc import Collection

from station.devices.zaber.protocol import ZaberCommand

#: Commands that act with any data; Restore acts with data 0.
UNCONDITIONAL_COMMANDS = frozenset(
    {int(ZaberCommand.RESET), int(ZaberCommand.HOME), int(ZaberCommand.RENUMBER), int(ZaberCommand.RESTORE)}
)
FIRST_ALIAS = 192  #: from this number on no command exists
NO_DATA = -1  #: data of commands for which the unit ignores it


def alias_number(index: int) -> int:
    """Return the alias of the unit at `index` of its chain, counted from 0."""
    return FIRST_ALIAS + index


def safe_speed(speed: int, listeners: Collection[int]) -> int:
    """Return the nearest speed that units of these numbers cannot misread as another command; 0 is a stop."""
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
