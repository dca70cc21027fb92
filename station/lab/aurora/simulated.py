"""A simulated Aurora at wire level: bytes in, bytes out, at the pace of its line, fed by the true tip.

It wakes at 9600 8N1, checks CRCs, takes both forms of a command, and answers each some time
after its last byte has arrived. Times on the line, and not only what is said, are therefore those
of a serial port, whatever carries the bytes.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.devices.aurora.protocol import POWER_UP_BAUD, framed
from station.devices.aurora.tracker import Registration
from station.lab.aurora.coil import MOUNT, Coil
from station.lab.aurora.commands import LONGEST_COMMAND, Refused, number, parse_command, parse_rate
from station.lab.aurora.frames import bx_reply, tx_reply, wants_beyond_volume
from station.lab.aurora.ports import PortHandles
from station.lab.config import TrackerConfig

#: From the last byte of a command to the first of its reply (unconfirmed) [s].
TURN_ROUND = {"INIT": 0.02, "PINIT": 0.05, "PENA": 0.02, "TSTART": 0.02, "TSTOP": 0.02}
USUAL_TURN_ROUND = 0.0005
TARGET_SERIAL = "3A5C1D01"  #: of the target's coil, where there is one
RESET_TIME = 0.5  #: from a break to RESET (unconfirmed) [s]
MOST_HEARD = 64  #: commands, and replies, that wait; more are lost


@dataclass
class AuroraFaults:
    """What is wrong with the unit or its line; may be changed at any time."""

    drop: float = 0.0  #: part of the bytes that are lost, either way
    flip: float = 0.0  #: part of the bytes with a wrong bit, either way
    mute: bool = False  #: hears nothing, says nothing
    delay: float = 0.0  #: of each reply on top of the usual [s]
    tool_lost: bool = False  #: the coil is not seen
    target_lost: bool = False  #: the target's coil is not seen
    jump: float = 0.0  #: the coil seems to be so far off along the world's x [m]
    freeze: bool = False  #: no new frame is measured


class Saying(NamedTuple):
    """A reply on its way."""

    begin: float  #: of the first character that is left [s]
    character: float  #: time that one takes [s]
    baud: int
    left: bytes


class SimulatedAurora:
    """One unit with a five-degree-of-freedom coil at the tip, and perhaps another on a target."""

    def __init__(
        self,
        config: TrackerConfig,
        rng: np.random.Generator,
        serial: str = "3A5C1D00",
        firmware: str = "AURORA Rev 009",
        mount: Registration = MOUNT,
        lacks: tuple[str, ...] = (),
        target: str = "",
    ) -> None:
        """`lacks` are commands that this firmware does not know; `target` is the serial number of a second coil."""
        self.faults = AuroraFaults()
        self.baud = POWER_UP_BAUD
        self.tracking = False
        self.executed: deque[str] = deque(maxlen=1000)  #: commands that were carried out, without CRC
        self.refused = 0  #: commands answered with an error
        self.handles = PortHandles(serial, target)
        self._coil = Coil(config, rng, mount)
        self._line_noise = rng.spawn(1)[0]
        self._target = Coil(config, rng.spawn(1)[0], mount, self._coil.distortion) if target else None
        self._firmware, self._lacks = firmware, lacks
        self._initialised = False
        self._character = 10  # bits
        self.looked = 0.0  #: when the line was looked at last [s]
        self.due = math.inf  #: when there is something to say, or to do, next [s]
        self._line = bytearray()
        self._heard_until = 0.0
        self._heard: deque[tuple[float, bytes]] = deque()
        self._busy_until = 0.0
        self._saying: deque[Saying] = deque()
        self._rate_after: tuple[int, int] | None = None  # baud and bits once OKAY is out

    # -- the world about it -----------------------------------------------------------------------

    def advance(
        self, begin: float, end: float, tip_begin: Array, tip_end: Array, direction: Array | None = None,
        target: tuple[Array, Array] | None = None,
    ) -> None:  # fmt: skip
        """See the true tip go from `tip_begin` to `tip_end`, world frame [m], the coil along `direction`.

        `target` are begin and end of the way of the target's coil.
        """
        if self._target is not None and target is not None and not self.faults.freeze:
            self._target.advance(begin, end, *target, None, self.faults.target_lost)
        if self._coil.due <= end + 1e-9 and not self.faults.freeze:
            if self.faults.jump:
                off = np.array([self.faults.jump, 0.0, 0.0])
                tip_begin, tip_end = tip_begin + off, tip_end + off
            self._coil.advance(begin, end, tip_begin, tip_end, direction, self.faults.tool_lost)

    def unplug(self) -> None:
        """Pull the tool's plug."""
        self.handles.unplug()

    def plug(self) -> None:
        """Put it back: it gets another handle."""
        self.handles.plug()

    def restart(self, now: float) -> None:
        """Power up, or answer a break: 9600 baud, nothing initialised."""
        self.baud, self._character, self._rate_after = POWER_UP_BAUD, 10, None
        self.tracking = self._initialised = False
        self._count_anew()
        self.handles.restart()
        self._line.clear()
        self._heard.clear()
        self._saying.clear()
        self._heard_until = self._busy_until = now
        self._say(framed("RESET"), now + RESET_TIME)
        self._plan()

    # -- the line -----------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float, host_baud: int | None = None) -> None:
        """Hear what the host has written since the last look; `host_baud` where the link can tell it."""
        begin, self.looked = self.looked, now
        if not data or self.faults.mute:
            return
        if host_baud not in (None, self.baud):
            data = self._garbage(len(data))
        time = max(begin, self._heard_until)
        for byte in self._disturbed(data):
            time += self._character / self.baud
            if byte == 0x0D:
                if len(self._heard) < MOST_HEARD:
                    self._heard.append((time, bytes(self._line)))
                self._line.clear()
            elif byte != 0x0A and len(self._line) <= LONGEST_COMMAND:
                self._line.append(byte)
        self._heard_until = time
        self._plan()

    def transmit(self, now: float, host_baud: int | None = None) -> bytes:
        """What the line carries to the host by `now` [s]."""
        while self._heard and self._heard[0][0] <= now:
            self._carry_out(*self._heard.popleft())
        out = b""
        while self._saying and self._saying[0].begin < now:
            saying = self._saying.popleft()
            count = min(len(saying.left), int((now - saying.begin) / saying.character + 1e-6))
            said, left = saying.left[:count], saying.left[count:]
            out += said if host_baud in (None, saying.baud) else self._garbage(count)
            if left:
                self._saying.appendleft(saying._replace(begin=saying.begin + count * saying.character, left=left))
                break
            if self._rate_after and not self._saying:
                (self.baud, self._character), self._rate_after = self._rate_after, None
        self._plan()
        return b"" if self.faults.mute else self._disturbed(out)

    def _plan(self) -> None:
        """A reply is due with its last character: looking more often brings it in parts, but not earlier."""
        self.due = self._heard[0][0] if self._heard else math.inf
        if self._saying:
            begin, character, _, left = self._saying[0]
            self.due = min(self.due, begin + len(left) * character)

    def _say(self, data: bytes, begin: float) -> None:
        if len(self._saying) >= MOST_HEARD:
            return
        character = self._character / self.baud
        begin = max(begin, self._busy_until)
        self._busy_until = begin + len(data) * character
        self._saying.append(Saying(begin, character, self.baud, data))

    def _disturbed(self, data: bytes) -> bytes:
        faults = self.faults
        if not (data and (faults.drop or faults.flip)):
            return data
        random = self._line_noise
        kept = bytearray(byte for byte in data if random.random() >= faults.drop)
        for i in range(len(kept)):
            if random.random() < faults.flip:
                kept[i] ^= 1 << int(random.integers(8))
        return bytes(kept)

    def _garbage(self, count: int) -> bytes:
        return self._line_noise.bytes(count)

    # -- commands -----------------------------------------------------------------------------------

    def _carry_out(self, time: float, line: bytes) -> None:
        """Answer one command that was complete at `time` [s]."""
        if not line:
            return
        name = ""
        try:
            name, parameters = parse_command(line)
            reply = self._answer(name, parameters, time)
            self.executed.append(f"{name}:{parameters}")
        except Refused as refused:
            self.refused += 1
            reply = framed(f"ERROR{refused.code:02X}")
        if reply:
            self._say(reply, time + TURN_ROUND.get(name, USUAL_TURN_ROUND) + self.faults.delay)

    def _answer(self, name: str, parameters: str, time: float) -> bytes:
        if name in self._lacks:
            raise Refused(0x01)
        if name in ("INIT", "TSTOP", "APIREV", "RESET") and parameters not in ("", "0"):
            raise Refused(0x07)
        if name in ("BX", "TX"):
            return self._frame_reply(name, parameters, time)
        if name == "RESET":
            self.restart(time)
            return b""
        if name in ("PINIT", "PENA", "PDIS", "PHF"):
            self.handles.change(name, parameters, self.tracking)
            return framed("OKAY")
        if name == "COMM":
            self._rate_after = parse_rate(parameters)
            return framed("OKAY")
        if name == "INIT":
            self._initialised, self.tracking = True, False
            self.handles.forget()
            return framed("OKAY")
        if name in ("TSTART", "TSTOP"):
            self._start_or_stop(name, parameters)
            return framed("OKAY")
        return framed(self._tell(name, parameters))

    def _start_or_stop(self, name: str, parameters: str) -> None:
        if not self._initialised:
            raise Refused(0x10)
        if self.tracking == (name == "TSTART"):
            raise Refused(0x0C)
        if parameters not in ("", "40", "80"):
            raise Refused(0x23)
        self.tracking = not self.tracking
        if parameters == "80":
            self._count_anew()

    def _count_anew(self) -> None:
        for coil in (self._coil, self._target):
            if coil is not None:
                coil.count_anew()

    def _tell(self, name: str, parameters: str) -> str:
        """Answers in words."""
        if name in ("VER", "BEEP", "SFLIST") and not (len(parameters) <= 2 and parameters.isdigit()):
            raise Refused(0x07)
        match name:
            case "VER":
                return (
                    "NDI Aurora SCU (simulated)\nNDI S/N: A0-00000\nCharacterization Date: 01/01/20\n"
                    f"Freeze Tag: {self._firmware}\nFreeze Date: 01/01/20\n(C) simulated unit\n"
                )
            case "APIREV":
                return "D.001.007"
            case "SFLIST":
                return "00000001" if parameters == "00" else "1"
            case "BEEP":
                return "1"
            case "GETINFO":
                if not parameters.startswith("Features"):
                    raise Refused(0x23)
                return f"{parameters}={self._firmware};1;0;0;;Firmware version"
            case "PHSR":
                return self.handles.search(parameters)
            case "PHINF":
                return self.handles.information(parameters)
            case "PHRQ":
                raise Refused(0x32)
            case _:
                raise Refused(0x01)

    def _frame_reply(self, name: str, parameters: str, time: float) -> bytes:
        options = number(parameters or "0001", 4)
        if not self.tracking:
            raise Refused(0x0C)
        beyond = wants_beyond_volume(options)
        reply = bx_reply if name == "BX" else tx_reply
        tools = [
            (port, coil.newest(time))
            for port in self.handles.enabled()
            if (coil := self._target if port.target else self._coil) is not None
        ]
        return reply(tools, beyond, self.handles.changed)
