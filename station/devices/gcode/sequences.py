"""Connects and homes the axes of a G-code board by requests, one at a time; the caller runs these sequences."""

import math
import re
from collections.abc import Generator, Mapping, Sequence
from typing import Any, Literal

from station.devices.gcode.board import Answer, GcodeBoard, Request
from station.devices.gcode.protocol import Dialect, GcodeError
from station.devices.gcode.setup import AxisSetup
from station.devices.stages_on_line import AxisFault
from station.devices.zaber.sequences import Homing, HomingStep

#: Offset that marks a homed board: tool length (GRBL) or work offset (Marlin). It vanishes when the board restarts.
MARK = 7.77
STOP_TIMEOUT_S = 5.0  #: time in which the board must confirm a stop [s]
SILENT = "the board does not answer; is it powered and plugged in, and is its baud rate right?"
QUIET_S = 0.06  #: silence after which no reply is outstanding [s]
MAX_ATTEMPTS = 4  #: largest number of times that a request without a reply is sent

Script = Generator[Request | float, Answer | None, None]
Lines = Generator[Request | float, Answer | None, tuple[str, ...]]


class GcodeState:
    """State of the axes; homing states persist when the port is opened again."""

    def __init__(
        self,
        setups: Sequence[AxisSetup],
        dialect: Dialect,
        baud: int,
        deadline: float,
        homing: Literal["firmware", "here"] = "firmware",
    ) -> None:
        self.setups = tuple(setups)
        self.dialect: Dialect = dialect
        self._baud, self._deadline, self._here = baud, deadline, homing == "here"
        self.homed = [False for _ in setups]
        self.home_again: set[int] = set()
        self.homing: Homing | None = None
        self.now = -math.inf
        self._firmware, self._warning = "", ""
        self._origin = [0.0 for _ in setups]
        self.reset()

    def reset(self) -> None:
        """Start a new session."""
        self.line = GcodeBoard(self.setups, self.dialect, self._baud, self._deadline)
        self.line.origin = list(self._origin)

    def fault(self, event: object, connected: bool) -> AxisFault | None:  # noqa: ARG002 - the same in every condition
        """Return the fault that an event of the board means."""
        return None

    def warning(self, i: int) -> str:
        """Return a warning about the firmware; empty without one."""
        return self._warning if i == 0 else ""

    def address(self, i: int) -> str:
        """Return the letter of an axis, for the details of messages."""
        return f"axis {self.setups[i].letter}"

    def details(self, i: int) -> Mapping[str, Any]:
        """Return firmware, state and counters of an axis."""
        return {
            "letter": self.setups[i].letter,
            "firmware": self._firmware,
            "state": self.line.state,
            **vars(self.line.counts[i]),
            "lost_bytes": self.line.reader.dropped,
        }

    def connect(self) -> Script:
        """Stop the board, check and set its parameters, and wait for its positions.

        Some boards restart when the port is opened; then the setup starts again.
        """
        line, marked = self.line, False
        line.starting = line.restarted = True
        for _ in range(MAX_ATTEMPTS):
            yield from self._stopped()
            if line.state == "Alarm":
                line.reset_board()
                yield from self._quiet()
            line.restarted = False
            marked = yield from (self._set_up_grbl() if self.dialect == "grbl" else self._set_up_marlin())
            if not line.restarted:
                break
        else:
            raise GcodeError("the board restarts again and again; is its power supply sufficient?")
        line.starting = False
        self.homed = [
            ((marked and not self._here) or (self._here and self.homed[i])) and i not in self.home_again
            for i in range(len(self.setups))
        ]
        yield from self._settle()

    def home(self) -> Script:
        """Home the translations first, then one rotation after the other."""
        yield from self._stopped()
        order = sorted(range(len(self.setups)), key=lambda i: self.setups[i].joint.motion != "translation")
        self.homing = Homing([self._homing_step(i) for i in order])
        for number, i in enumerate(order):
            self.homing.start(number, self.now)
            yield from self._home_one(i)
        letters = [setup.letter for setup in self.setups]
        if self.dialect == "grbl":
            yield from self._need(f"G43.1Z{MARK}")
        else:
            yield from self._mark_marlin(letters)
        yield from self._settle()

    def _stopped(self) -> Script:
        give_up = self.now + STOP_TIMEOUT_S
        while self.line.stopping:
            if self.now > give_up:
                if self.line.reading is None:
                    self.line.give_up()
                    raise GcodeError(SILENT)
                raise GcodeError("the board has not confirmed its stop")
            yield 0.02
        yield from self._quiet()

    def _quiet(self) -> Script:
        """Wait until the board has sent every reply to earlier lines, which would be taken for later replies."""
        self.line.polling = False
        start = self.now
        while self.now - max(self.line.received_at, start) < QUIET_S:
            if self.now - start > STOP_TIMEOUT_S:
                raise GcodeError("the board sends without a pause; is its baud rate right?")
            yield 0.01
        self.line.cancel()

    def _set_up_grbl(self) -> Generator[Request | float, Answer | None, bool]:
        missing = ["$$"]
        for _ in range(MAX_ATTEMPTS):
            found = (re.fullmatch(r"\$(\d+)=(-?[\d.]+)", line) for line in (yield from self._need("$$")))
            missing = self._missing_settings({int(match[1]): float(match[2]) for match in found if match})
            if not missing:
                break
            for text in missing:  # GRBL has no checksums, so the settings are read again
                yield from self._need(text)
        else:
            raise GcodeError(f"the board does not accept its settings {', '.join(missing)}")
        offsets = yield from self._need("$#")
        return f"[TLO:{MARK:.3f}]" in offsets

    def _missing_settings(self, settings: Mapping[int, float]) -> list[str]:
        """Return the settings of GRBL to write; raises GcodeError for those that only the operator may change."""
        values = {10: 1.0}
        for setup in self.setups:
            k = "XYZABC".index(setup.letter)
            self._check_steps(setup, settings.get(100 + k), f"${100 + k}")
            values[110 + k] = 60.0 * setup.joint.speed * setup.units
            values[120 + k] = setup.joint_acceleration * setup.units
        return [f"${k}={v:.3f}" for k, v in values.items() if abs(settings.get(k, 0.0) - v) > 1e-3 * v]

    def _set_up_marlin(self) -> Generator[Request | float, Answer | None, bool]:
        yield from self._need("M110 N0")
        report = yield from self._need("M115")
        self._firmware = next((line for line in report if line.startswith("FIRMWARE_NAME")), "")
        self._warning = (
            ""
            if "Cap:EMERGENCY_PARSER:1" in report
            else "the firmware has no EMERGENCY_PARSER, so a stop waits for earlier lines: build it with this option"
        )
        words = " ".join((yield from self._need("M92")))
        for setup in self.setups:
            match = re.search(rf"\b{setup.letter}(\d+\.?\d*)", words)
            self._check_steps(setup, float(match[1]) if match else None, f"M92 {setup.letter}")
        speeds = " ".join(f"{s.letter}{s.joint.speed * s.units:.3f}" for s in self.setups)
        ramps = " ".join(f"{s.letter}{s.joint_acceleration * s.units:.3f}" for s in self.setups)
        most = 10.0 * max(s.joint_acceleration * s.units for s in self.setups)
        # The smallest segment time would slow the short segments down; idle motors would lose their position.
        for text in ("G21", "G90", f"M203 {speeds}", f"M201 {ramps}", f"M204 P{most:.3f} T{most:.3f}", "M205 B0"):
            yield from self._need(text)
        yield from self._need("M84 S0")
        yield from self._read_offsets()
        return all(abs(offset - MARK) < 0.02 for offset in self.line.offset)

    def _check_steps(self, setup: AxisSetup, steps: float | None, name: str) -> None:
        expected = 1.0 / setup.unit
        if steps is None:
            raise GcodeError(f"the board has no axis {setup.letter}, which moves {setup.joint.name}")
        if abs(steps - expected) > 1e-3 * expected:
            raise GcodeError(
                f"{name} of {setup.joint.name} is {steps:g} steps per unit; the robot's microstep means {expected:.3f}:"
                f" change the setting of the board, or `microstep` or `units`"
            )

    def _read_offsets(self) -> Script:
        """Read Marlin's work offsets at rest, by two equal replies."""
        line = self.line
        line.polling, line.checking, line.reading = True, False, None
        give_up, first = self.now + 1.0, line.reading
        while first is None or line.reading is first or line.reading != first:
            if self.now > give_up:
                raise GcodeError("the board does not report its position")
            first = line.reading
            yield 0.03
        reading, line.checking = first, True
        pairs = zip(reading.logical, reading.values, self.setups, strict=True)
        self.line.offset = [logical - steps * setup.unit for logical, steps, setup in pairs]
        if all(abs(offset - MARK) < 0.02 for offset in self.line.offset):
            self.line.offset = [MARK for _ in self.setups]

    def _mark_marlin(self, letters: Sequence[str]) -> Script:
        yield from self._read_offsets()
        values = () if self.line.reading is None else self.line.reading.values
        pairs = zip(letters, values, self.setups, strict=True)
        yield from self._need("G92 " + " ".join(f"{c}{steps * s.unit + MARK:.4f}" for c, steps, s in pairs))
        yield from self._read_offsets()
        if any(offset != MARK for offset in self.line.offset):
            raise GcodeError("the firmware has no work offsets: build it without NO_WORKSPACE_OFFSETS")

    def _home_one(self, i: int) -> Script:
        setup, estimate = self.setups[i], self.line.estimates[i]
        self.homed[i] = False
        if self._here and self.line.reading is not None:
            if self.line.state == "Alarm":
                yield from self._need("$X")
            self.line.origin[i] = self._origin[i] = self.line.raw(self.line.reading)[i]
        else:
            estimate.forget(adrift=True)
            reach = max((setup.maximum - setup.minimum) * setup.joint.microstep, 2.0 * math.pi) / setup.home_speed
            text = f"$H{setup.letter}" if self.dialect == "grbl" else f"G28 {setup.letter}"
            yield from self._need(text, 2.0 * reach + 10.0, True)
            self.line.origin[i] = self._origin[i] = 0.0
        estimate.forget()
        self.homed[i] = True
        self.home_again.discard(i)

    def _homing_step(self, i: int) -> HomingStep:
        setup = self.setups[i]
        turns = setup.joint.motion == "rotation"
        way = 2.0 * math.pi if turns else (setup.maximum - setup.minimum) * setup.joint.microstep
        return HomingStep(setup.joint.name, "rad" if turns else "m", way, False, setup.home_speed)

    def _settle(self) -> Script:
        """Wait for two equal positions of every axis."""
        self.line.polling = True
        give_up = self.now + 2.0
        for estimate in self.line.estimates:
            estimate.forget()
        while not all(estimate.known for estimate in self.line.estimates):
            if self.now > give_up:
                raise GcodeError("the board does not report its position, or its axes move")
            yield 0.02
        for i, (setup, estimate) in enumerate(zip(self.setups, self.line.estimates, strict=True)):
            if self.homed[i] and not -1.0 <= estimate.position <= setup.maximum - setup.minimum + 1.0:
                self.homed[i] = False

    def _need(self, text: str, timeout: float = 1.0, homing: bool = False) -> Lines:
        """Return the lines that answer an accepted request; it is sent again if it or its reply was damaged."""
        problem = ""
        for _ in range(1 if homing else MAX_ATTEMPTS):
            answer = yield Request(text, timeout, homing)
            if answer is None or answer.missing:
                problem = f"the board does not answer '{text}'; is it powered, and is its baud rate right?"
            elif answer.accepted:
                return answer.lines
            else:
                problem = f"the board rejects '{text}': {answer.error}"
        raise GcodeError(problem)
