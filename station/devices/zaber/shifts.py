"""What Zaber units could read out of our own messages, once bytes are lost or one too many has come.

A unit that has lost the frame takes any six bytes in a row for a message until the line is silent for 10 ms, and
Reset, Home and Renumber act whatever data follows. So nothing is sent in a stream that reads as one of them:

* a question, a stop and a speed of 0 (which is sent as a stop) carry -1: after it all bytes are 255, for nobody;
* each unit gets an alias whose number is no command, so that a speed's last 0 and the next message's first byte
  are no command for all;
* the low byte of a speed is no such command, in case the byte before it is lost, and not the number of a unit
  where the byte after it is such a command.

What remains is forward speeds: their last bytes are 0 0, a Reset for all, for a unit that has lost three or four
bytes since the last silence. It stops the motor and costs the position, which is noticed. A pause after each
forward speed (`Line.pause`) excludes that, too, at the price of half the velocities.
"""

from collections.abc import Collection

from station.devices.zaber.protocol import Command

#: They act whatever their data is; Restore, with 0.
ACTING = frozenset({int(Command.RESET), int(Command.HOME), int(Command.RENUMBER), int(Command.RESTORE)})
FIRST_ALIAS = 192  #: from here on numbers are no commands
IGNORED = -1  #: data where the unit ignores it


def alias(place: int) -> int:
    """Second number of the unit at a place of its chain, counted from 0."""
    return FIRST_ALIAS + place


def sayable(speed: int, listeners: Collection[int]) -> int:
    """The nearest speed that is not read as something else by units of these numbers; 0 stands for a stop."""
    if speed == 0:
        return 0
    for away in range(256):
        for near in (speed - away, speed + away) if speed > 0 else (speed + away, speed - away):
            low, high = near & 0xFF, near >> 8 & 0xFF
            if near == 0 or (low not in ACTING and not (low in listeners and high in ACTING)):
                return near
    raise AssertionError("fewer than 256 low bytes are taken")
