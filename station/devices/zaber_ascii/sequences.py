"""Connects and homes Zaber ASCII stages by requests, one at a time; the caller runs these sequences."""

import math
from collections.abc import Generator, Mapping, Sequence
from typing import Any, NamedTuple

from station.devices.stages_on_line import AxisFault
from station.devices.zaber.sequences import Homing, HomingStep
from station.devices.zaber_ascii.chain import (
    DEADLINE_S,
    Answer,
    AsciiChain,
    FlagChanged,
    Rejected,
    Request,
    UnexpectedMotion,
)
from station.devices.zaber_ascii.protocol import (
    EXPECTED,
    FAULTS,
    MICROSTEP_RESOLUTION,
    NOT_HOMED,
    ZaberAsciiError,
    flag_text,
    reason_text,
)
from station.devices.zaber_ascii.setup import AsciiSetup

MAX_ATTEMPTS = 5  #: largest number of times that a request without a reply is sent
STOP_TIMEOUT_S = 5.0  #: time in which every axis must confirm a stop [s]
#: Flags of an axis whose motor gets current again by `driver enable`.
WITHOUT_CURRENT = frozenset({"FO", "FD", "FH", "FV"})

Script = Generator[Request | float, Answer | None, None]


class Identity(NamedTuple):
    """Identity that a device reports."""

    device_id: str
    firmware: str
    serial: str


class AsciiStagesState:
    """State of all stages; identities and homing states persist when the port is opened again."""

    def __init__(self, setups: Sequence[AsciiSetup], deadline: float = DEADLINE_S) -> None:
        """`deadline` is the longest time from sending a command to its reply [s]."""
        self.setups, self._deadline = tuple(setups), deadline
        self.reset()
        self.identities: list[Identity | None] = [None for _ in setups]
        self.homed = [False for _ in setups]
        self.home_again: set[int] = set()  #: stages that must be homed even if their axes report to be homed
        self.homing: Homing | None = None  #: progress of the latest homing
        self.now = -math.inf  #: time [s], set by the caller that runs a sequence
        self._homing_start: dict[int, int] = {}  # position at which an unfinished homing started [microsteps]

    def reset(self) -> None:
        """Start a new session on the chain."""
        self.line = AsciiChain([setup.on_chain() for setup in self.setups], self._deadline)

    def name(self, i: int) -> str:
        """Return the name of a stage, for messages."""
        return f"the stage {self.setups[i].joint.name}"

    def count(self, i: int) -> float:
        """Return the estimated position of a stage [microsteps]."""
        return self.line.estimates[i].position + self.setups[i].minimum

    def fault(self, event: object, connected: bool) -> AxisFault | None:
        """Return the fault that an event of the chain means; `connected`: no sequence is running."""
        match event:
            case UnexpectedMotion(i):
                return AxisFault(i, "does not move as commanded; was it reset, or moved by another program?", True)
            case Rejected(i, reason):
                return AxisFault(i, f"rejects its velocity: {reason_text(reason)}")
            case FlagChanged(i, flag) if connected and flag in FAULTS:
                return AxisFault(i, f"reports: {flag_text(flag)}")
            case FlagChanged(i, flag) if connected and flag in NOT_HOMED and self.homed[i]:
                return AxisFault(i, "has lost its position; was it switched off and on? Home it again", True)
        return None

    def warning(self, i: int) -> str:
        """Return the meaning of an unexpected warning flag; empty without one."""
        flag = self.line.flags[i]
        return flag_text(flag) if flag and flag not in EXPECTED and flag not in NOT_HOMED else ""

    def address(self, i: int) -> str:
        """Return device and axis number of a stage, for the details of messages."""
        return f"device {self.setups[i].device} axis {self.setups[i].axis}"

    def details(self, i: int) -> Mapping[str, Any]:
        """Return identity, flag and counters of a stage."""
        setup, identity = self.setups[i], self.identities[i]
        return {
            "device": setup.device,
            "axis": setup.axis,
            "identity": None if identity is None else identity._asdict(),
            "flag": self.line.flags[i],
            **vars(self.line.counts[i]),
            "lost_bytes": self.line.reader.dropped,
        }

    def connect(self) -> Script:
        """Identify and set up every stage, then wait for the positions of all homed stages."""
        self.line.reader.checked = False
        with_checksum = True
        for i in range(len(self.setups)):
            with_checksum &= yield from self._identify(i)
        self.line.reader.checked = with_checksum
        for i, setup in enumerate(self.setups):
            yield from self._need(i, "warnings clear")
            if self.line.flags[i] in WITHOUT_CURRENT:
                yield from self._request(i, "driver enable")
            resolution = yield from self._need(i, "get resolution")
            if resolution != str(MICROSTEP_RESOLUTION):
                raise ZaberAsciiError(
                    f"{self.name(i)} has {resolution} microsteps per step; {MICROSTEP_RESOLUTION} is expected, for "
                    "which the robot's file gives the size of a microstep: set the resolution with Zaber's program"
                )
            for setting, value in (
                ("accel", setup.acceleration),
                ("maxspeed", setup.home_data),
                ("limit.approach.maxspeed", setup.home_data),
                ("limit.min", setup.minimum),
                ("limit.max", setup.maximum),
            ):
                yield from self._set(i, setting, value)
            flag = yield from self._flag(i)
            self.homed[i] = flag not in NOT_HOMED and i not in self.home_again
            self.line.estimates[i].forget()
        self.line.polling = True
        yield from self._settle()

    def home(self) -> Script:
        """Home the translations first, then one rotation after the other."""
        give_up = self.now + STOP_TIMEOUT_S
        while self.line.stopping:
            if self.now > give_up:
                raise ZaberAsciiError(f"{self.name(min(self.line.stopping))} has not confirmed its stop")
            yield 0.02
        order = sorted(range(len(self.setups)), key=lambda i: self.setups[i].joint.motion != "translation")
        self.homing = Homing([self._homing_step(i) for i in order])
        for number, i in enumerate(order):
            self.homing.start(number, self.now)
            yield from self._home_one(i)
        yield from self._settle()

    def _identify(self, i: int) -> Generator[Request | float, Answer | None, bool]:
        """Check the identity of a device, and return whether it sends checksums."""
        setup, name = self.setups[i], self.name(i)
        first = yield from self._request(i, "get deviceid", whole_device=True)
        if first == Answer():
            raise ZaberAsciiError(f"{name} does not answer; is it powered, plugged in and numbered {setup.device}?")
        firmware = yield from self._need(i, "get version", whole_device=True)
        serial = yield from self._need(i, "get system.serial", whole_device=True)
        if firmware.split(".")[0] not in ("6", "7"):
            raise ZaberAsciiError(f"{name} has firmware {firmware}; 6 and 7 are supported")
        found, before = Identity(first.data, firmware, serial), self.identities[i]
        expected = before.serial if before is not None else None if setup.serial is None else str(setup.serial)
        if expected is not None and serial != expected:
            raise ZaberAsciiError(f"{name} has serial number {serial}; {expected} is expected: is it another device?")
        self.identities[i] = found
        yield from self._request(i, "set knob.enable 0", whole_device=True)  # rejected by devices without a knob
        return (yield from self._request(i, "set comm.checksum 1", whole_device=True)).accepted

    def _home_one(self, i: int) -> Script:
        setup, name, estimate = self.setups[i], self.name(i), self.line.estimates[i]
        self.homed[i] = False
        estimate.forget(adrift=True)
        start = self._homing_start.setdefault(i, int((yield from self._need(i, "get pos"))))
        reach = max((setup.maximum - setup.minimum) * setup.joint.microstep, 2.0 * math.pi) / setup.home_speed
        last = yield from self._motion(i, "home", self.now + 2.0 * reach + 10.0)
        flag = yield from self._flag(i)
        if flag in NOT_HOMED:
            raise ZaberAsciiError(f"{name} stopped without reaching its home sensor; is it free to move?")
        if setup.joint.motion == "rotation" and start - last > 0.5 * setup.turn:
            yield from self._turn_back(i)
        del self._homing_start[i]
        estimate.forget()
        self.homed[i] = True
        self.home_again.discard(i)

    def _turn_back(self, i: int) -> Script:
        """Turn a rotation stage that homed one turn too low up by one turn to its zero, at the homing speed.

        A rotation stage passes its home sensor once per turn while it moves down. If the stage started within half a
        turn of its zero and moved more than half a turn to the sensor, it started below zero.
        """
        setup = self.setups[i]
        yield from self._set(i, "limit.max", max(setup.turn, setup.maximum))
        seconds = 2.0 * math.pi / setup.home_speed
        yield from self._motion(i, f"move abs {setup.turn}", self.now + 2.0 * seconds + 10.0)
        position = yield from self._need(i, "get pos")
        if position != str(setup.turn):
            raise ZaberAsciiError(f"{self.name(i)} is at {position} microsteps after a turn of {setup.turn}")
        yield from self._need(i, "set pos 0")
        yield from self._set(i, "limit.max", setup.maximum)

    def _motion(self, i: int, text: str, give_up: float) -> Generator[Request | float, Answer | None, int]:
        """Start a motion, wait for its end, and return the last position before the end [microsteps]."""
        started, last = self.now, 0
        yield from self._need(i, text)
        while True:
            yield 0.05
            answer = yield from self._request(i, "get pos")
            if answer.flag in FAULTS:
                raise ZaberAsciiError(f"{self.name(i)}: {flag_text(answer.flag)}")
            if answer.accepted and not answer.busy:
                return last
            last = int(answer.data) if answer.accepted else last
            if self.now > give_up:
                raise ZaberAsciiError(f"{self.name(i)} has been moving for more than {give_up - started:.0f} s")

    def _homing_step(self, i: int) -> HomingStep:
        setup, turn = self.setups[i], 2.0 * math.pi
        turns, step = setup.joint.motion == "rotation", setup.joint.microstep
        exact = self.homed[i] and self.line.estimates[i].known
        above = self.count(i) * step if exact else turn if turns else (setup.maximum - setup.minimum) * step
        way = above if above >= 0.0 or not turns else 2.0 * turn + above
        return HomingStep(setup.joint.name, "rad" if turns else "m", abs(way), exact, setup.home_speed)

    def _settle(self) -> Script:
        """Wait for confirmed positions of all homed stages; a position out of range makes its stage not homed."""
        give_up = self.now + 2.0
        estimates = self.line.estimates
        while moving := [i for i, homed in enumerate(self.homed) if homed and not estimates[i].known]:
            if self.now > give_up:
                raise ZaberAsciiError(f"{self.name(moving[0])} does not stop: its position changes")
            yield 0.02
        for i, setup in enumerate(self.setups):
            if self.homed[i] and not setup.minimum <= self.count(i) <= setup.maximum:
                self.homed[i] = False  # another program has homed the stage and set another position

    def _flag(self, i: int) -> Generator[Request | float, Answer | None, str]:
        """Return the most severe present warning flag of a stage; raise its fault."""
        answer = yield from self._request(i, "get pos")
        if answer.flag in FAULTS:
            raise ZaberAsciiError(f"{self.name(i)}: {flag_text(answer.flag)}")
        return answer.flag

    def _set(self, i: int, setting: str, value: int) -> Script:
        """Write a setting, unless it has this value already: settings are kept in a memory that wears out."""
        present = yield from self._need(i, f"get {setting}")
        if present != str(value):
            yield from self._need(i, f"set {setting} {value}")

    def _need(self, i: int, text: str, whole_device: bool = False) -> Generator[Request | float, Answer | None, str]:
        """Return the data of an accepted request."""
        answer = yield from self._request(i, text, whole_device)
        if answer == Answer():
            raise ZaberAsciiError(f"{self.name(i)} does not answer '{text}'")
        if not answer.accepted:
            raise ZaberAsciiError(f"{self.name(i)} rejects '{text}': {reason_text(answer.data)}")
        return answer.data

    def _request(
        self, i: int, text: str, whole_device: bool = False
    ) -> Generator[Request | float, Answer | None, Answer]:
        """Return the answer to a request, which is sent again if its reply is lost."""
        answer: Answer | None = None
        for _ in range(MAX_ATTEMPTS):
            answer = yield Request(i, text, whole_device)
            if answer is not None and answer != Answer():
                return answer
        return Answer()
