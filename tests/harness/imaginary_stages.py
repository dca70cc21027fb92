"""A sixth protocol of stages that no maker sells, with its driver and simulator: the shortest driver on the kernel.

A command is `>A NN TEXT*CC`: the address of an axis (0: all), the number of the command, and the sum of the bytes
before the asterisk. Its answer is `<A NN S M F DATA*CC`: `+` or `-` (refused), `M` (moves) or `R` (rests), `H` (homed)
or `U`. An axis that receives no command for 0.2 s brakes.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from core.errors import CtrError
from station.config.controllers import StagesLatency
from station.config.robots import JointFile, RobotFile
from station.config.strict import Name, Strict
from station.devices.kernel.answered import Answer, AnsweringAxis, AnsweringLine, FlagChanged, Message, Rejected
from station.devices.kernel.axis import CountedJoint, joint_setups
from station.devices.kernel.conversation import Conversation
from station.devices.kernel.driver import on_ports
from station.devices.kernel.emergency import stop_answering
from station.devices.kernel.estimate import AxisEstimate
from station.devices.kernel.line import Unread, no_answer
from station.devices.kernel.setting import Setting
from station.devices.kernel.stages import AxisFault, LineStages, Port
from station.devices.kernel.startup import Axes, Script, Value
from station.devices.zaber.setup import StageSetup
from station.lab.motor import Motor
from station.lab.simulated_line import PacedLine, SimulatedLine
from station.lab.simulated_stages import StagesInLab, on_line

BAUD, BYTE_TIME_S = 115_200, 10.0 / 115_200
BRAKES_S = 0.2  #: silence after which an axis brakes [s]
UNFINISHED = 999_999_999  #: upper limit of an axis whose homing has not been completed [counts]
SETTINGS = {
    "accel": Setting("accel", "acceleration [counts/s^2]"),
    "low": Setting("low", "lower end of the travel"),
    "high": Setting("high", "upper end of the travel, and mark of an unfinished homing"),
}
LINE = re.compile(rb"([<>])(\d) (\d\d) ([ -)+-~]*)\*([0-9A-F]{2})")
ANSWER = re.compile(r"([+-]) ([MR]) ([HU]) (-?\d{1,10}|refused)")


def line(start: str, axis: int, number: int, text: str) -> bytes:
    """Return a command or an answer."""
    body = f"{start}{axis} {number:02} {text}".encode("ascii")
    return b"%s*%02X\n" % (body, sum(body) & 0xFF)


class Lines:
    """Extracts the lines with the given start and a right sum from a stream of bytes."""

    def __init__(self, start: bytes) -> None:
        self._start, self._rest, self.dropped = start, b"", Unread()

    @property
    def unread(self) -> bytes:
        """The newest bytes that are no such line."""
        return self.dropped.last + (b"" if self._rest.startswith(self._start) else self._rest)

    def feed(self, data: bytes) -> Iterator[tuple[int, int, str]]:
        """Return axis, number and text of the lines that `data` completes."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-200:]
        for each in lines:
            found = LINE.fullmatch(each[max(0, each.rfind(self._start)) :])
            if found and found[1] == self._start and int(found[5], 16) == sum(found[0][:-3]) & 0xFF:
                yield int(found[2]), int(found[3]), found[4].decode("ascii")
            elif each:
                self.dropped.add(each)


class ImaginaryError(CtrError):
    """An axis is not the expected one, or does not execute its command."""


class AxisFile(Strict):
    """One axis."""

    address: int
    serial: int | None = None
    home_at: float = 0.0


class File(Strict):
    """Imaginary stages on one line."""

    port: str
    joints: Mapping[Name, AxisFile] = {}
    deadline: float = 0.030


@dataclass(frozen=True)
class AxisSetup(CountedJoint):
    """One axis; a datum of a velocity command is a count per second."""

    address: int
    serial: int | None = None

    @classmethod
    def of(cls, joint: JointFile, file: AxisFile) -> "AxisSetup":
        """Return the setup of a joint."""
        home_at = file.home_at or (0.0 if joint.motion == "rotation" else joint.lower)
        return cls(joint, home_at, 0.25 * joint.speed, file.address, file.serial)

    @property
    def top(self) -> int:
        """Largest speed that the host sends [counts/s]."""
        return round(self.joint.speed / self.joint.microstep)

    @property
    def home_data(self) -> int:
        """Speed of homing [counts/s]."""
        return round(self.home_speed / self.joint.microstep)

    @property
    def acceleration(self) -> int:
        """Acceleration [counts/s^2]."""
        return math.ceil(self.joint.acceleration / self.joint.microstep)


class ImaginaryWire:
    """Commands and messages of the axes."""

    byte_time, max_number, stop, position, serial_number = BYTE_TIME_S, 99, "s", "p", "r serial"

    def __init__(self, setups: Sequence[AxisSetup]) -> None:
        self._addresses, self.lines = [setup.address for setup in setups], Lines(b"<")

    def velocity(self, data: int) -> str:
        return f"v {data}"

    def speed(self, data: int) -> float:
        return float(data)

    def encode(self, axis: int | None, text: str, number: int, *, whole_device: bool = False) -> bytes:
        return line(">", 0 if axis is None else self._addresses[axis], number, text)

    def read(self, data: bytes) -> Iterator[Message]:
        for address, number, text in self.lines.feed(data):
            if address in self._addresses and (found := ANSWER.fullmatch(text)):
                accepted, moves, flag, value = found.groups()
                answer = Answer(accepted == "+", value, moves == "M", flag)
                yield Message([self._addresses.index(address)], number, answer)


class Identity(NamedTuple):
    """Identity that an axis reports."""

    serial: int


class ImaginaryProtocol:
    """Imaginary stages on one line."""

    line: AnsweringLine

    def __init__(self, setups: Sequence[AxisSetup], deadline: float) -> None:
        self.axes, self._deadline = Axes(setups), deadline
        self._requests = Conversation(self.axes, ImaginaryError, str, lambda _: "")
        self._homing_start: dict[int, int] = {}

    def session(self, ports: Sequence[Port], *, again: bool) -> Sequence[AnsweringLine]:
        axes = [
            AnsweringAxis(s.top, s.minimum, AxisEstimate(s.top, s.acceleration, s.maximum - s.minimum))
            for s in self.axes.setups
        ]
        self._wire = ImaginaryWire(self.axes.setups)
        self.line = AnsweringLine(self._wire, axes, self._deadline)
        self.line.stop()
        return (self.line,)

    def happened(self, i: int, event: Any, connected: bool) -> AxisFault | None:
        match event:
            case Rejected(_, reason):
                return AxisFault(f"rejects its velocity: {reason}")
            case FlagChanged(_, "U") if connected and self.axes.homed[i]:
                return AxisFault("has lost its position; was it switched off and on? Home it again", True)
        return None

    def warning(self, i: int) -> str:
        return ""

    def address(self, i: int) -> str:
        return f"axis {self.axes.setups[i].address}"

    def details(self, i: int) -> Mapping[str, Any]:
        return {"axis": self.axes.setups[i].address}

    def connect(self) -> Script:
        for i, setup in enumerate(self.axes.setups):
            name, self._wire.lines.dropped.last = self.axes.name(i), b""
            found = yield from self.axes.first_answer(name, lambda i=i: self._requests.once(i, "r serial"))
            if found is None:
                check = f"is it powered, and its address {setup.address}?"
                raise ImaginaryError(no_answer(name, self._wire.lines.unread, "lines that start with '<'", check))
            self.axes.identify(i, Identity(int(found.data)), {"serial": setup.serial})
            finished = (yield from self._requests.need(i, "r high")) != str(UNFINISHED)
            high = setup.maximum if finished else UNFINISHED
            for name, value in (("accel", setup.acceleration), ("low", setup.minimum), ("high", high)):
                before = yield from self._requests.need(i, f"r {name}")
                yield from self._requests.need(i, f"w {name} {value}")
                self.axes.record(i, SETTINGS[name], before, value)
            self.axes.homed[i] = finished and self.line.flags[i] == "H" and i not in self.axes.home_again
            self.axes.estimates[i].forget()
        self.line.polling = True
        yield from self.axes.settle()

    def home(self) -> Script:
        yield from self.axes.home_at_rest(self, lambda: self.line.axes.stopping)

    def mark(self, i: int, *, finished: bool) -> Script:
        yield from self._requests.need(i, f"w high {self.axes.setups[i].maximum if finished else UNFINISHED}")
        if finished:
            self._homing_start.pop(i, None)

    def seek(self, i: int, give_up: float) -> Value[float]:
        start = self._homing_start.setdefault(i, int((yield from self._requests.need(i, "p"))))
        last = yield from self._requests.motion(i, f"h {self.axes.setups[i].home_data}", "p", give_up)
        if (yield from self._requests.request(i, "p")).flag != "H":
            raise ImaginaryError(f"{self.axes.name(i)} stopped without reaching its home sensor")
        return (start - last) * self.axes.setups[i].joint.microstep

    def turn_back(self, i: int, give_up: float) -> Script:
        setup = self.axes.setups[i]
        yield from self._requests.motion(i, f"g {setup.turn} {setup.home_data}", "p", give_up)
        yield from self._requests.need(i, "z 0")


def _setups(file: File, robot: RobotFile) -> list[AxisSetup]:
    address = ("address", lambda axis: axis.address)
    return joint_setups(robot, file.joints, lambda number: AxisFile(address=number), AxisSetup.of, address)


DRIVER = on_ports(
    File,
    _setups,
    lambda _: BAUD,
    lambda setups, ports, file: LineStages(ImaginaryProtocol(setups, file.deadline), ports, Answer, BRAKES_S),
    lambda setups, file: StagesLatency(BYTE_TIME_S * 20 * (len(setups) + 1), 0.003),
    lambda setups, file, clock: stop_answering(
        file.port, BAUD, ImaginaryWire(setups), [str(setup.address) for setup in setups], clock
    ),
)


class ImaginaryUnit:
    """One simulated axis."""

    def __init__(self, setup: StageSetup, true_position: float, homed: bool) -> None:
        travel = setup.maximum if setup.joint.motion == "translation" else None
        self.address, self.serial, self.homed = setup.device, 6000 + setup.device, homed
        turn = round(2.0 * math.pi / setup.joint.microstep)
        self.motor = Motor(true_position, true_position if homed else 0.0, travel, turn)
        self.settings = {"accel": 100_000, "low": 0, "high": setup.maximum}
        self._homing, self._heard, self._deaf_until = False, 0.0, -math.inf

    @property
    def true_position(self) -> float:
        return self.motor.true_position

    def switch_off_and_on(self) -> None:
        self.motor.switch_off_and_on()
        self.homed, self._homing, self._deaf_until = False, False, self.motor.time + 0.5

    def advance(self, until: float) -> list[tuple[float, tuple[int, str]]]:
        self.motor.advance(until)
        if self._homing and not self.motor.moving:
            self._homing, self.homed = False, True
            self.motor.set_count(0.0)
        if until - self._heard > BRAKES_S and self.motor.moving:
            self._homing = False
            self.motor.stop()
        return []

    def receive(self, command: tuple[int, int, str], now: float, slot: int) -> list[tuple[int, str]]:
        address, number, text = command
        if address not in (0, self.address) or now < self._deaf_until:
            return []
        self._heard = now
        data = self._execute(text.split())
        moves, flag = "M" if self.motor.moving else "R", "H" if self.homed else "U"
        return (
            [(number, f"- {moves} {flag} refused" if data is None else f"+ {moves} {flag} {data}")] if address else []
        )

    def _execute(self, words: Sequence[str]) -> object:
        """Execute a command, and return the data of its answer; None: it is refused."""
        motor, settings, value = self.motor, self.settings, 0
        if words and re.fullmatch(r"-?\d{1,9}", words[-1]):
            value = int(words[-1])
        motor.acceleration = float(settings["accel"])
        match words:
            case ["p"]:
                return round(motor.position)
            case ["r", "serial"]:
                return self.serial
            case ["r", name] if name in settings:
                return settings[name]
            case ["w", name, _] if name in settings:
                settings[name] = max(1, value) if name == "accel" else value
            case ["s"]:
                self._homing = False
                motor.stop()
            case ["v", _]:
                self._homing = False
                motor.run(float(value), settings["low"], settings["high"])
            case ["h", _] if value > 0:
                self._homing = True
                motor.move(motor.position - (motor.true_position - motor.zero_behind()), float(value))
            case ["g", goal, _] if value > 0 and re.fullmatch(r"\d{1,9}", goal):
                motor.move(float(goal), float(value))
            case ["z", _]:
                motor.set_count(float(value))
            case _:
                return None
        return 0


class SimulatedWire:
    """The line of simulated axes."""

    processing = 0.0005

    def __init__(self) -> None:
        self.out, self._lines, self._free = PacedLine(BYTE_TIME_S), Lines(b">"), -math.inf

    def read(self, data: bytes, now: float) -> Iterator[tuple[float, tuple[int, int, str]]]:
        self._free = max(self._free, now) + len(data) * BYTE_TIME_S
        for command in self._lines.feed(data):
            yield self._free, command

    def encode(self, axis: ImaginaryUnit, answer: tuple[int, str], at: float) -> tuple[float, bytes]:
        return at, line("<", axis.address, *answer)


IMAGINARY = StagesInLab(
    on_line(
        lambda setup, at, homed, _: ImaginaryUnit(setup, at, homed),
        lambda units, seed: SimulatedLine(SimulatedWire(), units, seed),
    ),
    "imaginary",
    DRIVER,
)
