"""A simulated Aurora tracker at wire level: it exchanges bytes at the baud rate of its line and measures the true tip.

The tracker starts at 9600 8N1, checks CRCs, and accepts commands with and without CRC. It answers each command with a
delay after the command's last byte. Content and timing of the bytes are therefore those of a serial port, over any
transport.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.devices.aurora.protocol import POWER_UP_BAUD, framed
from station.devices.aurora.tracker import TrackerMounting
from station.devices.links.link import Link, LinkError
from station.lab.aurora_coil import GENERATOR_POSE, Coil
from station.lab.aurora_commands import (
    MAX_COMMAND_BYTES,
    AuroraRefusal,
    PortHandles,
    bx_reply,
    number,
    parse_command,
    parse_rate,
    requests_beyond_volume,
    tx_reply,
)
from station.lab.config import TrackerConfig
from station.lab.wires import BUFFER_BYTES, SerialDeviceEnd

#: Time from the last byte of a command to the first of its reply (unconfirmed) [s].
REPLY_DELAYS_S = {"INIT": 0.02, "PINIT": 0.05, "PENA": 0.02, "TSTART": 0.02, "TSTOP": 0.02}
USUAL_REPLY_DELAY_S = 0.0005
TARGET_SERIAL = "3A5C1D01"  #: serial number of the coil on a moving target, if the lab has a target
RESET_TIME_S = 0.5  #: time from a break to RESET (unconfirmed) [s]
MAX_PENDING_COMMANDS = 64  #: largest number of waiting commands, and of waiting replies; excess ones are lost


@dataclass
class AuroraFaults:
    """Faults of the simulated tracker and its line; they may change at any time."""

    drop: float = 0.0  #: probability that a byte is lost, in both directions
    flip: float = 0.0  #: probability that one bit of a byte is inverted, in both directions
    mute: bool = False  #: the unit neither receives nor sends
    delay: float = 0.0  #: additional delay of each reply [s]
    tool_lost: bool = False  #: the coil is not visible
    target_lost: bool = False  #: the target's coil is not visible
    jump: float = 0.0  #: offset of the coil's position along the world's x [m]
    noise: float = 0.0  #: standard deviation of additional noise of the coil's position on each axis [m]
    freeze: bool = False  #: no new frame is measured


class PendingReply(NamedTuple):
    """A reply in transmission."""

    start: float  #: time at which the first remaining character starts [s]
    character: float  #: duration of a character [s]
    baud: int
    remaining: bytes


class SimulatedAurora:
    """A simulated Aurora with a five-degree-of-freedom coil at the tip and, if desired, a second one on a target."""

    def __init__(
        self,
        config: TrackerConfig,
        rng: np.random.Generator,
        serial: str = "3A5C1D00",
        firmware: str = "AURORA Rev 009",
        mount: TrackerMounting = GENERATOR_POSE,
        lacks: tuple[str, ...] = (),
        target: str = "",
        unprogrammed: bool = False,
        dual: bool = False,
    ) -> None:
        """`lacks` are commands that this firmware does not support; `target` is the serial number of a second coil.

        With `unprogrammed`, a tool without a memory is plugged in, too. With `dual`, both coils are in one plug.
        """
        self.faults = AuroraFaults()
        self.baud = POWER_UP_BAUD
        self.tracking = False
        self.executed: deque[str] = deque(maxlen=1000)  #: executed commands, without CRC
        self.refused = 0  #: commands answered with an error
        self.handles = PortHandles(serial, target, unprogrammed, dual)
        self._coil = Coil(config, rng, mount)
        self._line_noise = rng.spawn(1)[0]
        self._target = Coil(config, rng.spawn(1)[0], mount, self._coil.distortion) if target else None
        self._fault_noise = rng.spawn(1)[0]
        self._firmware, self._lacks = firmware, lacks
        self._initialised = False
        self._character = 10  # number of bits of a character on the line
        self.last_poll = 0.0  #: time at which the line was read last [s]
        self.due = math.inf  #: time of the next reply or command [s]
        self._line = bytearray()
        self._received_until = 0.0
        self._received: deque[tuple[float, bytes]] = deque()
        self._busy_until = 0.0
        self._replies: deque[PendingReply] = deque()
        self._rate_after: tuple[int, int] | None = None  # baud rate and bits per character after the reply OKAY

    # -- measurement of the coils -----------------------------------------------------------------

    def measures_by(self, now: float) -> bool:
        """Return whether a coil measures a frame until `now` [s]; if not, `advance` has nothing to do."""
        return self._coil.due <= now + 1e-9 or (self._target is not None and self._target.due <= now + 1e-9)

    def advance(
        self, start: float, end: float, tip_start: Array, tip_end: Array, direction: Array | None = None,
        target: tuple[Array, Array] | None = None,
    ) -> None:  # fmt: skip
        """Measure the coil while it moves from `tip_start` to `tip_end`, world frame [m], with its axis `direction`.

        `target` has the first and the last position of the target's coil.
        """
        if self._target is not None and target is not None and not self.faults.freeze:
            self._target.advance(start, end, *target, None, self.faults.target_lost)
        if self._coil.due <= end + 1e-9 and not self.faults.freeze:
            offset = np.array([self.faults.jump, 0.0, 0.0])
            if self.faults.noise:
                offset += self.faults.noise * self._fault_noise.standard_normal(3)
            if offset.any():
                tip_start, tip_end = tip_start + offset, tip_end + offset
            self._coil.advance(start, end, tip_start, tip_end, direction, self.faults.tool_lost)

    def unplug(self) -> None:
        """Pull the tool's plug."""
        self.handles.unplug()

    def plug(self) -> None:
        """Plug the tool in again; it gets a new handle."""
        self.handles.plug()

    def restart(self, now: float) -> None:
        """Restart the tracker as after power-up or a break: 9600 baud, no tool initialised."""
        self.baud, self._character, self._rate_after = POWER_UP_BAUD, 10, None
        self.tracking = self._initialised = False
        self._restart_count()
        self.handles.restart()
        self._line.clear()
        self._received.clear()
        self._replies.clear()
        self._received_until = self._busy_until = now
        self._send(framed("RESET"), now + RESET_TIME_S)
        self._plan()

    # -- the line -----------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float, host_baud: int | None = None) -> None:
        """Receive the bytes that the host has written since the last call.

        `host_baud` is the host's baud rate; None if the link does not know it.
        """
        start, self.last_poll = self.last_poll, now
        if not data or self.faults.mute:
            return
        if host_baud not in (None, self.baud):
            data = self._garbage(len(data))
        time = max(start, self._received_until)
        backlog = math.ceil((time - start) * self.baud / self._character)
        data = data[: max(0, BUFFER_BYTES - backlog)]
        for byte in self._with_faults(data):
            time += self._character / self.baud
            if byte == 0x0D:
                if len(self._received) < MAX_PENDING_COMMANDS:
                    self._received.append((time, bytes(self._line)))
                self._line.clear()
            elif byte != 0x0A and len(self._line) <= MAX_COMMAND_BYTES:
                self._line.append(byte)
        self._received_until = time
        self._plan()

    def transmit(self, now: float, host_baud: int | None = None) -> bytes:
        """Return the bytes that the line transmits to the host until `now` [s]."""
        while self._received and self._received[0][0] <= now:
            self._execute(*self._received.popleft())
        out = b""
        while self._replies and self._replies[0].start < now:
            reply = self._replies.popleft()
            count = min(len(reply.remaining), int((now - reply.start) / reply.character + 1e-6))
            sent, remaining = reply.remaining[:count], reply.remaining[count:]
            out += sent if host_baud in (None, reply.baud) else self._garbage(count)
            if remaining:
                start = reply.start + count * reply.character
                self._replies.appendleft(reply._replace(start=start, remaining=remaining))
                break
            if self._rate_after and not self._replies:
                (self.baud, self._character), self._rate_after = self._rate_after, None
        self._plan()
        return b"" if self.faults.mute else self._with_faults(out)

    def _plan(self) -> None:
        """Set the time of the next event. A reply is due with its last character; earlier polls return a part of it."""
        self.due = self._received[0][0] if self._received else math.inf
        if self._replies:
            start, character, _, remaining = self._replies[0]
            self.due = min(self.due, start + len(remaining) * character)

    def _send(self, data: bytes, start: float) -> None:
        if len(self._replies) >= MAX_PENDING_COMMANDS:
            return
        character = self._character / self.baud
        start = max(start, self._busy_until)
        self._busy_until = start + len(data) * character
        self._replies.append(PendingReply(start, character, self.baud, data))

    def _with_faults(self, data: bytes) -> bytes:
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

    def _execute(self, time: float, line: bytes) -> None:
        """Execute and answer one command that was complete at `time` [s]."""
        if not line:
            return
        name = ""
        try:
            name, parameters = parse_command(line)
            reply = self._answer(name, parameters, time)
            self.executed.append(f"{name}:{parameters}")
        except AuroraRefusal as refused:
            self.refused += 1
            reply = framed(f"ERROR{refused.code:02X}")
        if reply:
            self._send(reply, time + REPLY_DELAYS_S.get(name, USUAL_REPLY_DELAY_S) + self.faults.delay)

    def _answer(self, name: str, parameters: str, time: float) -> bytes:
        if name in self._lacks:
            raise AuroraRefusal(0x01)
        if name in ("INIT", "TSTOP") and parameters not in ("", "0"):
            raise AuroraRefusal(0x07)
        if name in ("BX", "TX"):
            return self._frame_reply(name, parameters, time)
        if name in ("PINIT", "PENA", "PHF"):
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
        return framed(self._text_reply(name, parameters))

    def _start_or_stop(self, name: str, parameters: str) -> None:
        if not self._initialised:
            raise AuroraRefusal(0x10)
        if self.tracking == (name == "TSTART"):
            raise AuroraRefusal(0x0C)
        if parameters:
            raise AuroraRefusal(0x23)
        self.tracking = not self.tracking

    def _restart_count(self) -> None:
        for coil in (self._coil, self._target):
            if coil is not None:
                coil.restart_count()

    def _text_reply(self, name: str, parameters: str) -> str:
        """Return the answer to a command whose reply is text."""
        match name:
            case "VER":
                if not (len(parameters) <= 2 and parameters.isdigit()):
                    raise AuroraRefusal(0x07)
                return (
                    "NDI Aurora SCU (simulated)\nNDI S/N: A0-00000\nCharacterization Date: 01/01/20\n"
                    f"Freeze Tag: {self._firmware}\nFreeze Date: 01/01/20\n(C) simulated unit\n"
                )
            case "PHSR":
                return self.handles.search(parameters)
            case "PHINF":
                return self.handles.information(parameters)
            case _:
                raise AuroraRefusal(0x01)

    def _frame_reply(self, name: str, parameters: str, time: float) -> bytes:
        options = number(parameters or "0001", 4)
        if not self.tracking:
            raise AuroraRefusal(0x0C)
        beyond = requests_beyond_volume(options)
        reply = bx_reply if name == "BX" else tx_reply
        tools = [
            (port, coil.newest(time))
            for port in self.handles.enabled()
            if (coil := self._target if port.target else self._coil) is not None
        ]
        return reply(tools, beyond, self.handles.changed)


def pump(link: Link, unit: SimulatedAurora, now: float) -> None:
    """Transmit bytes between the device's end of any link and the tracker; if the link fails the tracker continues.

    Only a line in memory transmits a break. `now` [s] is virtual or real time, the same as that of `advance`.
    """
    if isinstance(link, SerialDeviceEnd) and link.broken:
        link.broken = False
        unit.restart(now)
    try:
        data = link.read()
        if not data and unit.due > now:
            unit.last_poll = now
            return
        host_baud: int | None = getattr(link, "host_baud", None)  # most links do not have it
        unit.receive(data, now, host_baud)
        data = unit.transmit(now, host_baud)
        if data:
            link.write(data)
    except LinkError:
        return
