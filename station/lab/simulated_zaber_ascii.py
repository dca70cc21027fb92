"""Simulated Zaber X-series devices on one chain, at wire level, with the ASCII protocol at 115200 baud.

Each device has one axis with an encoder, so it detects a stall. The line carries the bytes with their transmission
times, because a pty or a socket does not limit the baud rate.
Source: the manufacturer's ASCII Protocol Manual for firmware 7.
"""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

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
from station.lab.simulated_line import PacedLine, SimulatedLine, free_buffer

FIRST_SERIAL_NUMBER = 2000  #: a simulated device has this serial number plus its address
ROTARY_ID, LINEAR_ID = 50952, 50105  #: device IDs of the simulated devices
RESTART_TIME_S = 0.5  #: time after switching on in which a device ignores commands [s]
PROCESSING_S = 0.0005  #: time from the end of a command to the start of its reply; assumed [s]
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
    "motion.accelonly": (0, 32767),
    "motion.decelonly": (0, 32767),
    "motion.accel.ramptime": (0, 10_000),
}


class AsciiCommand(NamedTuple):
    """A command of the host."""

    device: int  #: address of the device; 0: all
    axis: int  #: number of the axis; 0: all
    identity: str  #: message ID; empty: no ID; `--`: the device shall not answer
    text: str


class AsciiUnit:
    """One simulated device with one axis."""

    def __init__(self, setup: StageSetup, true_position: float, homed: bool) -> None:
        """Create the device of a stage at `true_position` from the home sensor's zero [microsteps].

        Unless `homed`, the device has just been switched on.
        """
        linear = setup.joint.motion == "translation"
        self.number, self.deaf_until = setup.device, -math.inf
        travel, turn = setup.maximum if linear else None, round(2.0 * math.pi / setup.joint.microstep)
        self.motor = Motor(true_position, true_position if homed else 0.0, travel, turn)
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
            "motion.accelonly": 206,
            "motion.decelonly": 206,
            "motion.accel.ramptime": 0,
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
        self._ramp("motion.accelonly")

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
        self.motor.switch_off_and_on()
        self.flags, self._homing, self.deaf_until = {"WR"}, False, self.motor.time + RESTART_TIME_S

    def advance(self, until: float) -> list[tuple[float, str]]:
        """Run the motor until the time `until` [s], and return alerts with their times."""
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
            return [(until, f"!{self.number:02} 1 {self.status} {self.flag}")]
        return []

    def receive(self, command: AsciiCommand, now: float, slot: int) -> list[str]:  # noqa: ARG002
        """Execute a command to this device that arrives at `now` [s], and return the reply."""
        device, axis, identity, text = command
        if device not in (0, self.number) or now < self.deaf_until:
            return []
        accepted, data = self.execute(text) if axis in (0, 1) else (False, "BADAXIS")
        if identity == "--":
            return []
        named = f" {int(identity):02}" if identity else ""
        return [f"@{self.number:02} {axis}{named} {'OK' if accepted else 'RJ'} {self.status} {self.flag} {data}"]

    @property
    def status(self) -> str:
        """Status of the axis in replies."""
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
                self._ramp("motion.decelonly")
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
            self.settings["motion.accelonly"] = self.settings["motion.decelonly"] = int(value)
        return True, "0"

    def _ramp(self, name: str) -> None:
        self.motor.acceleration = (self.settings[name] or WRITABLE[name][1]) / ACCELERATION_FACTOR

    def _move(self, words: Sequence[str]) -> tuple[bool, str]:
        motor, settings = self.motor, self.settings
        self._ramp("motion.accelonly")
        lower, upper = settings["limit.min"], settings["limit.max"]
        if "FO" in self.flags:
            return False, "DRIVERDISABLED"
        match words:
            case ["home"]:
                self.flags.discard("FS")
                self._homing = True
                speed = settings["limit.approach.maxspeed"] / SPEED_FACTOR
                motor.move(motor.position - (motor.true_position - motor.zero_behind()), speed)
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


class AsciiWire:
    """The line of Zaber ASCII devices: lines of text with an optional checksum."""

    processing = PROCESSING_S

    def __init__(self) -> None:
        self.out = PacedLine(BYTE_TIME_S)
        self._part, self._free = b"", -math.inf

    def read(self, data: bytes, now: float) -> Iterator[tuple[float, AsciiCommand]]:
        """Return the commands that bytes of the host complete, with the arrival time of their last byte."""
        time = max(self._free, now)
        data = data[: free_buffer(time - now, BYTE_TIME_S)]
        self._free = time + len(data) * BYTE_TIME_S
        *lines, rest = (self._part + data).replace(b"\r", b"\n").split(b"\n")
        sent = time - len(self._part) * BYTE_TIME_S
        self._part = rest[-MAX_LINE_BYTES:]
        for line in lines:
            sent += (len(line) + 1) * BYTE_TIME_S
            start = line.rfind(b"/")
            body, colon, check = line[start + 1 :].partition(b":")
            if start >= 0 and (not colon or check.strip() == b"%02X" % checksum(body)):
                yield sent, _command(body.decode("ascii", "replace").split())

    def encode(self, axis: AsciiUnit, answer: str, at: float) -> tuple[float, bytes]:
        """Return the time and the bytes of a reply or an alert."""
        line = answer.encode("ascii")
        if axis.settings["comm.checksum"]:
            line += b":%02X" % checksum(line[1:])
        return at, line + b"\r\n"


def _command(words: list[str]) -> AsciiCommand:
    # Up to three numbers precede the command: device, axis, message ID.
    numbers: list[str] = []
    while words and len(numbers) < 3 and (words[0].isdecimal() or words[0] == "--"):
        numbers.append(words.pop(0))
    device, axis = (int(number) if number != "--" else 0 for number in [*numbers[:2], "0", "0"][:2])
    return AsciiCommand(device, axis, numbers[2] if len(numbers) > 2 else "", " ".join(words))


def simulated_ascii_chain(units: Sequence[AsciiUnit], seed: int = 0) -> SimulatedLine[AsciiUnit]:
    """Return devices on one line, the nearest to the computer first."""
    return SimulatedLine(AsciiWire(), units, seed)


def _is_integer(text: str) -> bool:
    return text.removeprefix("-").isdecimal() and text.isascii()
