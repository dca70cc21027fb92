"""Scripts that set up and home the axes of a G-code board; `kernel/stages.py` runs them."""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

from station.devices.gcode.board import UNUSABLE, Answer, GcodeBoard, Request
from station.devices.gcode.protocol import LASTING_ALARMS, LETTERS, Dialect, GcodeError, Position, alarm_text, setting
from station.devices.gcode.setup import AxisSetup
from station.devices.kernel.line import no_answer
from station.devices.kernel.quality import quoted
from station.devices.kernel.setting import Setting
from station.devices.kernel.stages import AxisFault, Port
from station.devices.kernel.startup import STOP_TIMEOUT_S, Axes, Script, Value

#: Offset that marks a homed board: tool length (GRBL) or work offset (Marlin). It vanishes when the board restarts, and
#: is removed before the first motion of a homing.
MARK = 7.77
STEPS = "change the setting of the board, or `microstep` or `units`"
ENDSTOPS = "the firmware's soft endstops stay on (M211), and cut targets off; build it without them"
#: Required values of GRBL settings, computed from the present values; settings that a board lacks are left out.
GRBL_VALUES: Mapping[int, Callable[[float], float]] = {
    1: lambda _: 255.0,
    10: lambda now: float(int(now) | 1),
    13: lambda _: 0.0,
}
#: Settings of GRBL: first those of the board, then (`GRBL_AXIS_SETTINGS`) those of its first axis.
GRBL_SETTINGS: Mapping[int, Setting] = {
    1: Setting("$1", "the motors lose their current {} ms after a motion (255: never)"),
    10: Setting("$10", "content of reports (bit 0: machine positions)"),
    13: Setting("$13", "unit of reports (1: inches)"),
    20: Setting("$20", "soft limits (1: on) refuse targets beyond the travel", "soft limits keep"),
    40: Setting("$40", "grblHAL's limits of jogs (1: on) cut targets off silently", "limits of jogs keep"),
    22: Setting("$22", "homing (1: enabled)"),
    23: Setting("$23", "axes that home towards lower coordinates, as bits"),
    27: Setting("$27", "distance from the switch after homing"),
}
GRBL_AXIS_SETTINGS: Mapping[int, Setting] = {
    100: Setting("$100", "steps per unit", STEPS),
    110: Setting("$110", "largest speed [unit/min]"),
    120: Setting("$120", "acceleration [unit/s^2]"),
    130: Setting("$130", "travel, for soft limits and the coordinate after homing"),
}
#: Numbers that this module gives to settings that only FluidNC has, for the first axis.
HOME_COORDINATE, SOFT_LIMITS, HOMES_UP = 900, 910, 920
FLAGS = {"true": 1.0, "false": 0.0}
#: FluidNC has settings by name, of the board and of each axis (`$/axes/x/...`), instead of GRBL's numbers.
FLUIDNC_SETTINGS: Mapping[int, str] = {1: "$/stepping/idle_ms"}
FLUIDNC_AXIS_SETTINGS: Mapping[int, str] = {
    100: "steps_per_mm",
    110: "max_rate_mm_per_min",
    120: "acceleration_mm_per_sec2",
    130: "max_travel_mm",
    HOME_COORDINATE: "homing/mpos_mm",
    SOFT_LIMITS: "soft_limits",
    HOMES_UP: "homing/positive_direction",
}
MARLIN_SETTINGS: Mapping[str, Setting] = {
    "M92": Setting("M92", "steps per unit", STEPS),
    "G21": Setting("G21", "millimetres"),
    "G90": Setting("G90", "absolute targets"),
    "M203": Setting("M203", "largest speeds [unit/s]"),
    "M201": Setting("M201", "accelerations [unit/s^2]"),
    "M204": Setting("M204", "acceleration of all axes together [unit/s^2]"),
    "M205": Setting("M205", "smallest time of a segment, which would slow short segments down"),
    "M220": Setting("M220", "speed in percent"),
    "M211": Setting("M211", "soft endstops cut targets off silently", ENDSTOPS),
    "M85": Setting("M85", "time without motions after which the board halts itself (S0: never)"),
    "M154": Setting("M154", "automatic position reports, which contain the end of the queue"),
    "M420": Setting("M420", "levelling moves Z with X and Y"),
    "M425": Setting("M425", "backlash compensation adds steps"),
    "M593": Setting("M593", "input shaping delays motions"),
    "M852": Setting("M852", "skew compensation mixes the axes"),
    "M84": Setting("M84", "time after which resting motors lose their current, and position (S0: never)"),
}
#: Commands that switch off functions of Marlin that change motions or positions; a board may lack the optional ones.
WITHOUT = ("M85 S0", "M154 S0", "M420 S0", "M425 F0", "M593 F0", "M852 I0 J0 K0")
OPTIONAL = frozenset(("M154", "M420", "M425", "M593", "M852"))
UNKNOWN = "echo:Unknown command"
QUIET_S = 0.06  #: silence after which no reply is outstanding [s]
MAX_ATTEMPTS = 4  #: largest number of times that a request without a reply is sent


class GcodeProtocol:
    """The axes of one G-code board."""

    line: GcodeBoard

    def __init__(
        self,
        setups: Sequence[AxisSetup],
        dialect: Dialect,
        baud: int,
        deadline: float,
        homing: Literal["firmware", "here"] = "firmware",
    ) -> None:
        self.axes = Axes(setups)
        self.dialect: Dialect = dialect
        self._baud, self._deadline, self._here = baud, deadline, homing == "here"
        self._firmware = self._warning = ""
        self._origin = [0.0 for _ in setups]
        self._unmarked = False  # whether this homing has removed the board's mark
        self._homed_all = False  # whether GRBL has homed all axes at once
        self._settings: dict[int, float] = {}  # GRBL's settings by number, as read
        self._options = ""  # letters of the options with which GRBL was built
        self._by_name: Mapping[int, str] = {}  # names of FluidNC's settings, by the numbers of GRBL's settings

    def session(self, ports: Sequence[Port], *, again: bool) -> Sequence[GcodeBoard]:  # noqa: ARG002 - all axes stop
        """Start a new session: every axis stops."""
        self.line = GcodeBoard(self.axes.setups, self.dialect, self._baud, self._deadline)
        self.line.origin = list(self._origin)
        self.line.stop()
        return (self.line,)

    def happened(self, i: int, event: object, connected: bool) -> AxisFault | None:
        """Return None: a board has no events of single axes."""

    def warning(self, i: int) -> str:
        """Return a warning about the firmware; empty without one."""
        return self._warning if i == 0 else ""

    def address(self, i: int) -> str:
        """Return the letter of an axis, for the details of messages."""
        return f"axis {self.axes.setups[i].letter}"

    def details(self, i: int) -> Mapping[str, Any]:
        """Return the letter of an axis, and the firmware and state of its board."""
        letter, lost = self.axes.setups[i].letter, self.line.reader.dropped
        return {"letter": letter, "firmware": self._firmware, "state": self.line.state, "lost_bytes": lost}

    def connect(self) -> Script:
        """Stop the board, check and set its parameters, and wait for its positions.

        Some boards restart when the port is opened; then the setup starts again.
        """
        line, marked = self.line, False
        line.starting = line.restarted = True
        if (yield from self.axes.first_answer("the board", self._position)) is None:
            line.axes.give_up()
            raise GcodeError(self._silent("a position", "is it powered and plugged in"))
        for _ in range(MAX_ATTEMPTS):
            yield from self._stopped()
            if line.state == "Alarm" or line.state in UNUSABLE:
                line.reset_board()
                yield from self._quiet()
                yield from self._usable()
            line.restarted = False
            marked = yield from (self._set_up_grbl() if self.dialect == "grbl" else self._set_up_marlin())
            if not line.restarted:
                break
        else:
            raise GcodeError("the board restarts again and again; is its power supply sufficient?")
        line.starting = False
        for i, homed in enumerate(self.axes.homed):
            self.axes.homed[i] = (homed if self._here else marked) and i not in self.axes.home_again
        yield from self._settle()

    def home(self) -> Script:
        """Home every axis."""
        yield from self._stopped()
        self._unmarked = self._homed_all = False
        yield from self.axes.home(self)
        yield from self._settle()

    def mark(self, i: int, *, finished: bool) -> Script:
        """Mark the board as not homed before the first homing, and as homed after the last one."""
        if not finished and not self._unmarked:
            self._unmarked = True
            yield from self._set_mark(0.0)
        elif finished and all(homed or k == i for k, homed in enumerate(self.axes.homed)) and self._origin_is_known:
            yield from self._set_mark(MARK)

    def seek(self, i: int, give_up: float) -> Value[float]:
        """Home an axis by its switch, or count its present position as home; return 0: it needs no turn back."""
        setup = self.axes.setups[i]
        if self._here:
            if self.line.reading is None:
                raise GcodeError("the board does not report its position")
            if self.line.state == "Alarm":
                yield from self._need("$X")
            self.line.origin[i] = self._origin[i] = self.line.raw(self.line.reading)[i]
        else:
            yield from self._home_by_switch(setup.letter, give_up - self.axes.now)
            reading = yield from self._rest_position()
            self.line.origin[i] = self._origin[i] = self.line.raw(reading)[i]
        return 0.0

    def _home_by_switch(self, letter: str, longest: float) -> Script:
        """Home one axis, or all axes at once where GRBL was built without the homing of single axes."""
        if self._homed_all:
            return
        if self.dialect == "marlin":
            yield from self._need(f"G28 {letter}", longest, True)
            return
        answer = yield Request(f"$H{letter}", longest, True)
        # GRBL was built without the homing of single axes, or they are disabled in grblHAL (`$22`).
        if answer is not None and ("(error:3)" in answer.error or ("(error:5)" in answer.error and self._homes)):
            yield from self._need("$H", len(self.axes.setups) * longest, True)
            self._homed_all = True
        else:
            self._accepted(f"$H{letter}", answer)

    @property
    def _homes(self) -> bool:
        return bool(self._settings.get(22))

    def turn_back(self, i: int, give_up: float) -> Script:  # noqa: ARG002 - see `seek`
        """Do nothing: the firmware homes without a turn back."""
        yield from ()

    def _position(self) -> Value[Position | None]:
        """Return the last position, which the stop of a new session queries; None: there is none yet."""
        yield from ()
        return self.line.reading

    def _silent(self, expected: str, check: str, silent: str = "does not answer") -> str:
        """Return why an answer is missing: no byte came, or what the board sends instead."""
        other = "marlin" if self.dialect == "grbl" else "grbl"
        if self.line.reader.last:
            check = f'is its `dialect` "{self.dialect}" or "{other}"'
        check += ", and is its baud rate right?"
        return no_answer("the board", self.line.reader.last, f"{expected} of {self.dialect}", check, silent)

    def _stopped(self) -> Script:
        give_up = self.axes.now + STOP_TIMEOUT_S
        while self.line.axes.stopping:
            if self.axes.now > give_up:
                raise GcodeError("the board has not confirmed its stop")
            yield 0.02
        yield from self._quiet()

    def _quiet(self) -> Script:
        """Wait for all replies to earlier lines, so that none of them is mistaken for the reply to a later line."""
        self.line.polling = False
        start = self.axes.now
        while self.axes.now - max(self.line.received_at, start) < QUIET_S:
            if self.axes.now - start > STOP_TIMEOUT_S:
                raise GcodeError(
                    f"the board sends {quoted(self.line.reader.last)} without a pause; is its baud rate right?"
                )
            yield 0.01
        self.line.cancel()

    def _usable(self) -> Script:
        """Wait for the state after a reset; raises GcodeError if only the operator can end this state."""
        line, give_up = self.line, self.axes.now + 1.0
        line.polling, line.reading = True, None
        while line.reading is None and self.axes.now < give_up:
            yield 0.02
        line.polling = False
        if line.state in UNUSABLE:
            raise GcodeError(f"the board reports the state '{line.state}': {UNUSABLE[line.state]}")
        if line.state == "Alarm" and line.code in LASTING_ALARMS:
            raise GcodeError(f"the board reports: {alarm_text(line.code, line.fluidnc)}")

    def _set_up_grbl(self) -> Value[bool]:
        line, order = self.line, LETTERS
        for text in (yield from self._need("$I")):
            if match := re.fullmatch(r"\[AXS:\d+:([A-Z]+)\]", text):
                order = match[1]
            elif match := re.fullmatch(r"\[OPT:([^,\]]*).*\]", text):
                self._options = match[1]
            elif match := re.fullmatch(r"\[VER:(.*)\]", text):
                self._firmware = match[1]
        line.order = order
        self._by_name = {}
        line.fluidnc = "FluidNC" in self._firmware
        if line.fluidnc:
            letters = [(order.index(s.letter), s.letter.lower()) for s in self.axes.setups if s.letter in order]
            axes = {n + k: f"$/axes/{c}/{name}" for n, name in FLUIDNC_AXIS_SETTINGS.items() for k, c in letters}
            self._by_name = {**FLUIDNC_SETTINGS, **axes}
        missing = ["$$"]
        for attempt in range(MAX_ATTEMPTS):
            if self._by_name:
                yield from self._read_by_name()
            else:
                self._settings = dict(filter(None, map(setting, (yield from self._need("$$")))))
            missing = self._missing_settings(self._settings, record=not attempt)
            if not missing:
                break
            for text in missing:  # GRBL has no checksums, so the settings are read again
                yield from self._need(text)
        else:
            raise GcodeError(f"the board does not accept its settings {', '.join(missing)}")
        marked = yield from self._grbl_is_marked()
        if marked and not self._here:
            self.line.origin = self._origin = self._expected_origin()
        if line.state != "Alarm":
            yield from self._metric()
        return marked

    def _read_by_name(self) -> Script:
        """Read FluidNC's settings, which `$$` does not have."""
        self._settings = {}
        for number, name in self._by_name.items():
            lines = yield from self._need(name)
            value = next((line[len(name) + 1 :] for line in lines if line.startswith(f"{name}=")), "")
            if value in FLAGS:
                self._settings[number] = FLAGS[value]
            elif re.fullmatch(r"-?\d+(?:\.\d*)?", value):
                self._settings[number] = float(value)
            else:
                raise GcodeError(f"the board answered {list(lines)} to {name}; expected a number, true or false")
        self._settings[20] = max((v for k, v in self._settings.items() if SOFT_LIMITS <= k < HOMES_UP), default=0.0)

    def _metric(self) -> Script:
        """Switch GRBL to millimetres, because a start-up block such as `$N0 = G20` may have chosen inches."""
        if any("G20" in line.split() for line in (yield from self._need("$G"))):
            yield from self._need("G21")

    def _grbl_is_marked(self) -> Value[bool]:
        for line in (yield from self._need("$#")):
            if match := re.fullmatch(r"\[TLO:(-?[\d.]+(?:,-?[\d.]+)*)\]", line):  # grblHAL prints all axes
                return f"{MARK:.3f}" in match[1].split(",")
        return False

    def _missing_settings(self, settings: Mapping[int, float], record: bool) -> list[str]:
        """Return the settings of GRBL to write; raises GcodeError for those that only the operator may change."""
        values = {number: wanted(settings[number]) for number, wanted in GRBL_VALUES.items() if number in settings}
        for number, each in GRBL_SETTINGS.items() if record else ():
            self.axes.record(None, each, settings.get(number, "none"), values.get(number))
        for i, setup in enumerate(self.axes.setups):
            k = self.line.order.find(setup.letter)
            if k < 0:
                raise GcodeError(
                    f"the board has no axis {setup.letter}, which moves {setup.joint.name}; its axes are"
                    f" {', '.join(self.line.order)}: set the key `letter` of the joint"
                )
            self._check_steps(setup, settings.get(100 + k), f"${100 + k}")
            self._check_travel(setup, settings, k)
            values[110 + k] = 60.0 * setup.joint.speed * setup.units
            values[120 + k] = setup.joint_acceleration * setup.units
            for number, each in GRBL_AXIS_SETTINGS.items() if record else ():
                found = settings.get(number + k, "none")
                self.axes.record(i, each, found, values.get(number + k), f"${number + k}")
        return [
            f"{self._by_name.get(k, f'${k}')}={v:.3f}".rstrip("0").rstrip(".")
            for k, v in values.items()
            if abs(settings.get(k, -1.0) - v) > 1e-3 * v
        ]

    def _check_travel(self, setup: AxisSetup, settings: Mapping[int, float], k: int) -> None:
        """Raise GcodeError if GRBL's soft limits do not contain the joint's travel."""
        limited = next((number for number in (20, 40) if settings.get(number)), None)
        if limited is None or self._here:
            return
        home, travel = self._home_coordinate(k), settings.get(130 + k, 0.0)
        lower, upper = sorted(home + count * setup.unit for count in (setup.minimum, setup.maximum))
        upward = "Z" in self._options and int(settings.get(23, 0.0)) >> k & 1  # counts up from home
        least, most = (0.0, travel) if upward else (-travel, 0.0)
        if self._by_name:
            least, most = (home - travel, home) if settings.get(HOMES_UP + k) else (home, home + travel)
        if lower < least - setup.unit or upper > most + setup.unit:
            raise GcodeError(
                f"${limited} = 1: {GRBL_SETTINGS[limited].refused} {setup.letter} between {least:g} and {most:g}, but"
                f" {setup.joint.name} moves from {lower:g} to {upper:g}; set ${limited} = 0, or ${130 + k} and"
                " `home_at`"
            )

    def _home_coordinate(self, k: int) -> float:
        """Return the coordinate of GRBL's axis `k` after its homing (`limits_go_home` of GRBL 1.1) [unit]."""
        if "Z" in self._options:  # built with HOMING_FORCE_SET_ORIGIN
            return 0.0
        if self._by_name:
            return self._settings.get(HOME_COORDINATE + k, 0.0)
        pull_off, travel = self._settings.get(27, 0.0), self._settings.get(130 + k, 0.0)
        return pull_off - travel if int(self._settings.get(23, 0.0)) >> k & 1 else -pull_off

    @property
    def _origin_is_known(self) -> bool:
        """Whether a later session will know the coordinates of the home positions without a homing."""
        return all(abs(a - b) <= 1.0 for a, b in zip(self.line.origin, self._expected_origin(), strict=True))

    def _expected_origin(self) -> list[float]:
        """Return the board's counts at the home positions, as far as they are known without a homing."""
        if self.dialect == "marlin":
            return [0.0 for _ in self.axes.setups]
        if self._here:
            return list(self._origin)
        return [self._home_coordinate(self.line.order.index(s.letter)) / s.unit for s in self.axes.setups]

    def _set_up_marlin(self) -> Value[bool]:
        yield from self._need("M110 N0")
        report = yield from self._need("M115")
        self._firmware = next((line for line in report if line.startswith("FIRMWARE_NAME")), "")
        self._warning = (
            ""
            if "Cap:EMERGENCY_PARSER:1" in report
            else "the firmware has no EMERGENCY_PARSER, so a stop waits for earlier lines: build it with this option"
        )
        words = " ".join((yield from self._need("M92")))
        for i, setup in enumerate(self.axes.setups):
            match = re.search(rf"\b{setup.letter}(\d+\.?\d*)", words)
            self.axes.record(i, MARLIN_SETTINGS["M92"], float(match[1]) if match else "none")
            self._check_steps(setup, float(match[1]) if match else None, f"M92 {setup.letter}")
        speeds = " ".join(f"{s.letter}{s.joint.speed * s.units:.3f}" for s in self.axes.setups)
        ramps = " ".join(f"{s.letter}{s.joint_acceleration * s.units:.3f}" for s in self.axes.setups)
        most = 10.0 * max(s.joint_acceleration * s.units for s in self.axes.setups)
        ready = "G21", "G90", f"M203 {speeds}", f"M201 {ramps}", f"M204 P{most:.3f} T{most:.3f}", "M205 B0", "M220 S100"
        for text in (*ready, "M211 S0", "M84 S0", *WITHOUT):
            code, _, value = text.partition(" ")
            if code not in OPTIONAL:
                yield from self._need(text)
            elif not (yield from self._knows(text)):
                value = "none"
            self.axes.record(None, MARLIN_SETTINGS[code], None, value or "on")
        if any(re.search(r"M211 S1|endstops: *on", line, re.IGNORECASE) for line in (yield from self._need("M211"))):
            raise GcodeError(ENDSTOPS)
        yield from self._read_offsets()
        return all(offset == MARK for offset in self.line.offset)

    def _check_steps(self, setup: AxisSetup, steps: float | None, name: str) -> None:
        expected = 1.0 / setup.unit
        if steps is None:
            raise GcodeError(f"the board has no axis {setup.letter}, which moves {setup.joint.name}")
        if abs(steps - expected) > 1e-3 * expected:
            raise GcodeError(
                f"{name} of {setup.joint.name} is {steps:g} steps per unit; the robot's microstep needs {expected:.3f}:"
                f" {STEPS}"
            )

    def _rest_position(self) -> Value[Position]:
        """Return the position of the axes at rest, which two replies in a row report."""
        line = self.line
        line.polling, line.reading = True, None
        give_up, first = self.axes.now + 1.0, line.reading
        while first is None or line.reading is first or line.reading != first:
            if self.axes.now > give_up:
                raise GcodeError("the board does not report its position")
            first = line.reading
            yield 0.03
        return first

    def _read_offsets(self) -> Script:
        """Read Marlin's work offsets at rest."""
        line = self.line
        line.checking = False
        reading = yield from self._rest_position()
        line.checking = True
        pairs = zip(reading.logical, reading.values, self.axes.setups, strict=True)
        self.line.offset = [logical - steps * setup.unit for logical, steps, setup in pairs]
        for mark in (0.0, MARK):
            if all(abs(offset - mark) < 0.02 for offset in self.line.offset):
                self.line.offset = [mark for _ in self.axes.setups]

    def _set_mark(self, mark: float) -> Script:
        """Mark the board as homed, by `MARK`, or as not homed, by 0."""
        if self.dialect == "grbl":
            if mark:
                yield from self._metric()
            # GRBL rejects the command in an alarm. A board that has just started is in an alarm, but has no mark.
            if mark or (yield from self._grbl_is_marked()):
                yield from self._need(f"G43.1Z{mark:g}")
            return
        yield from self._read_offsets()
        values = () if self.line.reading is None else self.line.reading.values
        words = (f"{s.letter}{steps * s.unit + mark:.4f}" for steps, s in zip(values, self.axes.setups, strict=True))
        yield from self._need("G92 " + " ".join(words))
        yield from self._read_offsets()
        if any(offset != mark for offset in self.line.offset):
            raise GcodeError("the firmware has no work offsets: build it without NO_WORKSPACE_OFFSETS")

    def _settle(self) -> Script:
        """Wait for two equal positions of every homed axis; coordinates are rounded by up to one count."""
        self.line.polling = True
        for estimate in self.line.axes.estimates:
            estimate.forget()
        yield from self.axes.settle(slack=1.0)

    def _need(self, text: str, timeout: float = 1.0, homing: bool = False) -> Value[tuple[str, ...]]:
        """Send a request, again if it or its reply is damaged, and return the lines of its answer."""
        answer: Answer | None = None
        for _ in range(1 if homing else MAX_ATTEMPTS):
            answer = yield Request(text, timeout, homing)
            if answer is not None and answer.accepted:
                break
        return self._accepted(text, answer)

    def _knows(self, text: str) -> Value[bool]:
        """Send a request, and return whether the board knows its command."""
        answer: Answer | None = None
        for _ in range(MAX_ATTEMPTS):
            answer = yield Request(text)
            if answer is not None and (answer.accepted or answer.error.startswith(UNKNOWN)):
                return answer.accepted
        self._accepted(text, answer)
        return True

    def _accepted(self, text: str, answer: Answer | None) -> tuple[str, ...]:
        """Return the lines of an accepted request's answer; raises GcodeError for a rejection or without an answer."""
        if answer is None or answer.missing:
            raise GcodeError(self._silent(f"the answer to '{text}'", "is it powered", f"does not answer '{text}'"))
        if not answer.accepted:
            raise GcodeError(f"the board rejects '{text}': {answer.error}")
        return answer.lines
