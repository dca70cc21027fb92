"""Simulated Zaber X-series devices on one chain, at wire level, with the ASCII protocol at 115200 baud.

Each device has one axis with an encoder, so it detects a stall. The line carries the bytes with their transmission
times, because a pty or a socket does not limit the baud rate.
Source: the manufacturer's ASCII Protocol Manual for firmware 7.
"""

import math
from collections import deque
from collections.abc import Sequence

from station.devices.zaber.setup import StageSetup
from station.devices.zaber_ascii.protocol import (
    ACCELERATION_FACTOR,
    BYTE_TIME_S,
    FLAGS,
    MAX_LINE_BYTES,
    NO_FLAG,
    SPEED_FACTOR,
    checksum,
)
from station.lab.motor import Motor
from station.lab.simulated_zaber import Faults, LineNoise, PacedLine, free_buffer

FIRST_SERIAL_NUMBER = 2000  #: a simulated device has this serial number plus its address
ROTARY_ID, LINEAR_ID = 50952, 50105  #: device IDs of the simulated devices
RESTART_TIME_S = 0.5  #: time after switching on in which a device ignores commands [s]
PROCESSING_S = 0.0005  #: time from the end of a command to the start of its reply; assumed [s]
STOPS = 2000.0  #: distance of the hard stops from both ends of the travel [microsteps]
#: Ranges of the settings that a command may write.
WRITABLE = {
    "accel": (0, 32767),
    "comm.checksum": (0, 1),
    "comm.alert": (0, 1),
    "knob.enable": (0, 1),
    "limit.approach.maxspeed": (1, 16384 * 64),
    "limit.max": (-1_000_000_000, 1_000_000_000),
    "limit.min": (-1_000_000_000, 1_000_000_000),
    "maxspeed": (1, 16384 * 64),
}


class AsciiUnit:
    """One simulated device with one axis."""

    def __init__(self, setup: StageSetup, true_position: float, homed: bool) -> None:
        """Create the device of a stage at `true_position` from the home sensor's zero [microsteps].

        Unless `homed`, the device has just been switched on.
        """
        linear = setup.joint.motion == "translation"
        self.number, self.deaf_until = setup.device, -math.inf
        self._turn = None if linear else round(2.0 * math.pi / setup.joint.microstep)
        lower, upper = (-STOPS, setup.maximum + STOPS) if linear else (-math.inf, math.inf)
        self.motor = Motor(true_position, true_position if homed else 0.0, lower, upper)
        self.flags = set[str]() if homed else {"WR"}
        self.settings: dict[str, int] = {
            "accel": 206,
            "comm.alert": 0,
            "comm.checksum": 0,
            "knob.enable": 1,
            "limit.approach.maxspeed": 100_000,
            "limit.max": setup.maximum,
            "limit.min": 0,
            "maxspeed": 153_600,
            "resolution": 64,
        }
        self._identity = {
            "deviceid": str(LINEAR_ID if linear else ROTARY_ID),
            "version": "7.33",
            "system.serial": str(FIRST_SERIAL_NUMBER + setup.device),
            "system.axiscount": "1",
            "peripheralid": "0",
        }
        self._homing = False
        self.motor.acceleration = self.settings["accel"] / ACCELERATION_FACTOR

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [microsteps]."""
        return self.motor.true_position

    @property
    def flag(self) -> str:
        """Most severe active warning flag."""
        return next((flag for flag in FLAGS if flag in self.flags), NO_FLAG)

    def switch_off_and_on(self) -> None:
        """Simulate a power cycle: the axis is at rest without a reference position."""
        self.motor.halt()
        self.motor.set_count(0.0)
        self.flags, self._homing, self.deaf_until = {"WR"}, False, self.motor.time + RESTART_TIME_S

    def advance(self, until: float) -> list[str]:
        """Run the motor until the time `until` [s], and return alerts without address."""
        was_moving, flag = self.motor.moving, self.flag
        self.motor.advance(until)
        if was_moving and self.motor.stalled:  # the encoder has detected that the stage does not follow
            self.motor.halt()
            self.flags.add("FS")
            self._homing = False
        elif self._homing and not self.motor.moving:
            self._homing = False
            self.motor.set_count(0.0)
            self.flags -= {"WR", "WH"}
        ended = was_moving and not self.motor.moving
        if self.settings["comm.alert"] and (ended or flag != self.flag):
            return [f"1 {self.status} {self.flag}"]
        return []

    @property
    def status(self) -> str:
        """Status of the axis as replies carry it."""
        return "BUSY" if self.motor.moving else "IDLE"

    def execute(self, text: str) -> tuple[bool, str]:
        """Execute a command; return whether it is accepted, and its data or the reason of its rejection."""
        match text.split():
            case []:
                return True, "0"
            case ["get", "pos"]:
                return True, str(round(self.motor.position))
            case ["get", name] if name in self._identity:
                return True, self._identity[name]
            case ["get", name] if name in self.settings:
                return True, str(self.settings[name])
            case ["set", "pos", value] if _is_integer(value):
                self.motor.set_count(int(value))
                self.flags.discard("WR")
                return True, "0"
            case ["set", name, value] if name in WRITABLE:
                return self._set(name, value)
            case ["warnings"] | ["warnings", "clear"]:
                active = [flag for flag in FLAGS if flag in self.flags]
                if text.endswith("clear"):
                    self.flags &= {"WR", "WH", "FO"}
                return True, " ".join([f"{len(active):02}", *active])
            case ["driver", "enable"]:
                self.flags.discard("FO")
                return True, "0"
            case ["stop"] | ["estop"]:
                self._homing = False
                self.motor.stop()
                return True, "0"
            case ["home"] | ["move", _, _]:
                return self._move(text.split())
        return False, "BADCOMMAND"

    def _set(self, name: str, value: str) -> tuple[bool, str]:
        lower, upper = WRITABLE[name]
        if not _is_integer(value) or not lower <= int(value) <= upper:
            return False, "BADDATA"
        self.settings[name] = int(value)
        if name == "accel":
            self.motor.acceleration = (int(value) or WRITABLE["accel"][1]) / ACCELERATION_FACTOR
        return True, "0"

    def _move(self, words: Sequence[str]) -> tuple[bool, str]:
        motor, settings = self.motor, self.settings
        lower, upper = settings["limit.min"], settings["limit.max"]
        if "FO" in self.flags:
            return False, "DRIVERDISABLED"
        match words:
            case ["home"]:
                self.flags.discard("FS")
                self._homing = True
                motor.move(motor.position - (motor.true_position - self._zero), self._approach_speed)
                return True, "0"
            case ["move", "vel", value] if _is_integer(value) and abs(int(value)) <= 16384 * settings["resolution"]:
                motor.run(int(value) / SPEED_FACTOR, lower, upper)
            case ["move", "abs" | "rel" as kind, value] if _is_integer(value):
                goal = int(value) + (round(motor.position) if kind == "rel" else 0)
                if not lower <= goal <= upper or "WR" in self.flags:
                    return False, "BADDATA"
                motor.move(goal, settings["maxspeed"] / SPEED_FACTOR)
            case ["move", "vel" | "abs" | "rel", _]:
                return False, "BADDATA"
            case _:
                return False, "BADCOMMAND"
        self._homing = False
        self.flags.discard("FS")
        return True, "0"

    @property
    def _approach_speed(self) -> float:
        return self.settings["limit.approach.maxspeed"] / SPEED_FACTOR

    @property
    def _zero(self) -> float:
        """True position of the zero whose home sensor a backward motion reaches first [microsteps]."""
        return 0.0 if self._turn is None else math.floor(self.motor.true_position / self._turn) * self._turn


class SimulatedAsciiChain:
    """Devices on one line, the nearest to the computer first."""

    def __init__(self, units: Sequence[AsciiUnit], seed: int = 0) -> None:
        self.units = tuple(units)
        self.time = 0.0
        self._faults = Faults()
        self.noise = LineNoise(seed)
        self._incoming: deque[tuple[float, bytes]] = deque()  # complete lines with the arrival of their last byte
        self._part, self._free = b"", -math.inf
        self._out = PacedLine(BYTE_TIME_S)

    @property
    def faults(self) -> Faults:
        """Active faults of the chain."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        for slot, unit in enumerate(self.units, 1):
            unit.motor.stall(slot in faults.stalled)

    def power_cycle(self, slot: int) -> None:
        """Switch one device off and on."""
        self.units[slot - 1].switch_off_and_on()

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]; bytes beyond the host's buffer are lost."""
        if self._faults.cut == 1:
            return
        time = max(self._free, now)
        data = self.noise.damage(data, self._faults)[: free_buffer(time - now, BYTE_TIME_S)]
        self._free = time + len(data) * BYTE_TIME_S
        *lines, rest = (self._part + data).replace(b"\r", b"\n").split(b"\n")
        sent = time - len(self._part) * BYTE_TIME_S
        for line in lines:
            sent += (len(line) + 1) * BYTE_TIME_S
            self._incoming.append((sent, line))
        self._part = rest[-MAX_LINE_BYTES:]

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        while self._incoming and self._incoming[0][0] <= now + 1e-9:
            time, line = self._incoming.popleft()
            self._run(time)
            self._deliver(line, time)
        self._run(now)
        data = self._out.take(now)
        return data if self._faults.cut != 1 else b""

    def _run(self, until: float) -> None:
        for slot, unit in enumerate(self.units, 1):
            for alert in unit.advance(until):
                self._send(slot, f"!{unit.number:02} {alert}", until)
        self.time = until

    def _deliver(self, line: bytes, now: float) -> None:
        start = line.rfind(b"/")
        body, colon, sent = line[start + 1 :].partition(b":")
        if start < 0 or (colon and sent.strip() != b"%02X" % checksum(body)):
            return
        words = body.decode("ascii", "replace").split()
        # Up to three numbers precede the command: device, axis, message ID.
        numbers: list[str] = []
        while words and len(numbers) < 3 and (words[0].isdecimal() or words[0] == "--"):
            numbers.append(words.pop(0))
        device = int(numbers[0]) if numbers and numbers[0] != "--" else 0
        axis = int(numbers[1]) if len(numbers) > 1 and numbers[1] != "--" else 0
        identity = numbers[2] if len(numbers) > 2 else ""
        for slot, unit in enumerate(self.units, 1):
            if self._faults.cut is not None and slot >= self._faults.cut:
                return
            if device not in (0, unit.number) or now < unit.deaf_until:
                continue
            accepted, data = unit.execute(" ".join(words)) if axis in (0, 1) else (False, "BADAXIS")
            if identity != "--":
                named = f" {int(identity):02}" if identity else ""
                answer = f"{'OK' if accepted else 'RJ'} {unit.status} {unit.flag} {data}"
                self._send(slot, f"@{unit.number:02} {axis}{named} {answer}", now + PROCESSING_S)

    def _send(self, slot: int, text: str, now: float) -> None:
        faults = self._faults
        if slot in faults.mute or (faults.cut is not None and slot >= faults.cut):
            return
        line = text.encode("ascii")
        if self.units[slot - 1].settings["comm.checksum"]:
            line += b":%02X" % checksum(line[1:])
        self._out.put(self.noise.damage(line + b"\r\n", self._faults), now + faults.delay)


def _is_integer(text: str) -> bool:
    return text.removeprefix("-").isdecimal() and text.isascii()
