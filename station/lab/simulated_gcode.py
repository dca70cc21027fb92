"""A simulated G-code board at wire level: GRBL 1.1 at 115200 baud or Marlin 2 at 250000 baud."""

import math
import re
from collections import deque
from collections.abc import Sequence

from station.devices.gcode.protocol import BAUDS, Dialect
from station.devices.gcode.setup import LETTERS, AxisSetup, GcodeAxisFile
from station.devices.zaber.setup import StageSetup
from station.lab.gcode_planner import Planner
from station.lab.gcode_variants import AS_DELIVERED, FLUIDNC_AXIS, VARIANTS, BoardVariant
from station.lab.simulated_line import Faults, LineNoise, PacedLine, free_buffer

BLOCKS: dict[Dialect, int] = {"grbl": 15, "marlin": 16}
BANNER = "Grbl 1.1h ['$' for help]"
PROCESSING_S = 0.0005  #: time from the end of a line to the start of its reply; assumed [s]
KEEPALIVE_S = 2.0  #: interval between Marlin's reports that it executes a long command [s]
WORK_OFFSET = 10.0  #: offset of the work coordinates of GRBL [unit]
HOME_PAUSE_S = 0.3  #: time for the slow second approach to a home switch [s]


class BoardAxis:
    """One axis: its steps, and the true position of its stage, which the board does not know."""

    def __init__(self, setup: AxisSetup, board: "SimulatedBoard", index: int, true_position: float) -> None:
        self.setup, self.shift = setup, true_position  # true position minus the board's count [microsteps]
        self._board, self._index = board, index
        self.stuck: float | None = None

    @property
    def true_position(self) -> float:
        """True position of the stage from the home switch [microsteps]."""
        if self.stuck is not None:
            return self.stuck
        return self._board.planner.position[self._index] / self.setup.unit + self.shift


class SimulatedBoard:
    """One simulated board that moves all stages."""

    def __init__(
        self,
        dialect: Dialect,
        setups: Sequence[StageSetup],
        true_positions: Sequence[float],
        homed: bool,
        seed: int = 0,
        variant: BoardVariant = VARIANTS["usual"],
    ) -> None:
        self.dialect, self.time, self.variant = dialect, 0.0, variant
        self.emergency_parser = self.realtime_position = True  # options of the Marlin firmware
        self.soft_endstops = True  #: whether Marlin moves to 0 if a target is below 0
        self.inches = variant.inches  #: whether GRBL reads coordinates in inches
        self.checking = False  #: whether GRBL accepts motions without executing them
        self.planner = Planner(len(setups), BLOCKS[dialect])
        self.letters = variant.order[: len(setups)]
        axes = [AxisSetup.of(s.joint, GcodeAxisFile(letter=c)) for s, c in zip(setups, LETTERS, strict=False)]
        self.units = tuple(
            BoardAxis(a, self, i, at) for i, (a, at) in enumerate(zip(axes, true_positions, strict=True))
        )
        self.mark = 7.77 if homed else 0.0
        self.offsets = [self.mark for _ in axes]
        if homed:
            for i, (axis, at) in enumerate(zip(axes, true_positions, strict=True)):
                self.planner.set_position(i, round(at) * axis.unit)
                self.units[i].shift = at - round(at)
        self.alarm, self.killed = False, False
        self._byte_time = 10.0 / BAUDS[dialect]
        self._faults, self.noise = Faults(), LineNoise(seed)
        self._incoming: deque[tuple[float, int]] = deque()  # times of arrival [s], and bytes
        self._lines: deque[bytes] = deque()
        self._part, self._free, self._deaf_until = b"", -math.inf, -math.inf
        self._out = PacedLine(self._byte_time)
        self._homing: tuple[tuple[int, ...], float] | None = None  # axes, and the end of their homing [s]
        self._next_busy = math.inf  # time of the next report of a long command [s]
        self._number = 0
        self.settings = {**AS_DELIVERED, **variant.settings}
        for k, axis in enumerate(axes):
            self.settings |= {100 + k: 1.0 / axis.unit, 110 + k: 500.0, 120 + k: 10.0, 130 + k: 200.0}
        if homed and dialect == "grbl":  # the coordinates count from the board's home coordinate
            for i, unit in enumerate(self.units):
                self.planner.set_position(i, self.planner.position[i] + self._home_coordinate(i))
                unit.shift -= self._home_coordinate(i) / unit.setup.unit

    @property
    def faults(self) -> Faults:
        """Active faults; if one slot is cut or mute, the whole board is."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        self.planner.clamp({slot - 1 for slot in faults.clamped})
        for slot, unit in enumerate(self.units, 1):
            if slot in faults.stalled and unit.stuck is None:
                unit.stuck = unit.true_position
            elif slot not in faults.stalled and unit.stuck is not None:
                true, unit.stuck = unit.stuck, None
                unit.shift += true - unit.true_position

    def power_cycle(self, slot: int) -> None:  # noqa: ARG002 - one board has all stages
        """Switch the board off and on."""
        self.start_for(self.variant.boot)

    def start_for(self, seconds: float) -> None:
        """Restart the board, which then ignores bytes for a time [s]."""
        self._restart()
        self._deaf_until = self.time + seconds
        self._send("start" if self.dialect == "marlin" else BANNER, self._deaf_until)

    def raise_alarm(self, number: int) -> None:
        """Stop without a ramp and lock the board (GRBL), or halt it (Marlin)."""
        self.planner.halt()
        self.alarm = True
        if self.dialect == "grbl":
            self._send(f"ALARM:{number}", self.time)
        else:
            self.killed = True
            self._send("Error:Printer halted. kill() called!", self.time)

    def _restart(self) -> None:
        for i, unit in enumerate(self.units):
            true = unit.true_position
            self.planner.set_position(i, 0.0)
            unit.shift = true
        self.mark, self.offsets = 0.0, [0.0 for _ in self.units]
        self.alarm, self.killed, self._homing, self._number = self.dialect == "grbl", False, None, 0
        self.soft_endstops, self.checking, self.inches = True, False, self.variant.inches
        self._lines.clear()
        self._incoming.clear()
        self._part = b""

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]; bytes beyond the host's buffer are lost."""
        if self._faults.cut is not None:
            return
        time = max(self._free, now)
        data = self.noise.damage(data, self._faults)[: free_buffer(time - now, self._byte_time)]
        for byte in data:
            time += self._byte_time
            self._incoming.append((time, byte))
        self._free = time

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        while self._incoming and self._incoming[0][0] <= now + 1e-9:
            time, byte = self._incoming.popleft()
            if time >= self._deaf_until:
                self._run(time)
                self._byte(byte)
        self._run(now)
        data = self._out.take(now)
        return b"" if self._faults.cut is not None or self._faults.mute else data

    def _run(self, until: float) -> None:
        if until > self.time:
            self.planner.advance(until)
            self.time = until
        if self._homing is not None and self.dialect == "marlin" and until >= self._next_busy:
            self._next_busy += KEEPALIVE_S
            self._send("echo:busy: processing", until)
        if self._homing is not None and until >= self._homing[1]:
            (axes, _), self._homing = self._homing, None
            for i in axes:
                at = self._home_coordinate(i)
                self.planner.set_position(i, at)
                self.units[i].shift = -at / self.units[i].setup.unit
                self.offsets[i] = 0.0
            self.alarm = False
            self._send("ok", until)
        while self._lines and self._homing is None and not self.planner.full:
            self._execute(self._lines.popleft())

    def _byte(self, byte: int) -> None:
        if self.dialect == "grbl":
            match byte:
                case 0x85 | 0x21:
                    self.planner.hold()
                    return
                case 0x3F:
                    if self._homing is None:
                        self._status()
                    return
                case 0x18:
                    moving = self.planner.moving or self._homing is not None
                    homing, self._homing = self._homing is not None, None
                    self.planner.halt()
                    self._lines.clear()
                    self._part, self.mark, self.checking = b"", 0.0, False
                    self._send(BANNER, self.time)
                    if moving:
                        self.alarm = True
                        self._send(f"ALARM:{6 if homing else 3}", self.time)
                    return
                case _ if byte == 0x7E or byte >= 0x80:
                    return
        if byte in b"\r\n":
            line, self._part = self._part, b""
            if self.dialect == "marlin" and self.emergency_parser and line in (b"M410", b"M112"):
                self._emergency(line)
            if line or self.dialect == "grbl":
                self._lines.append(line)
                self._run(self.time)
        else:
            self._part = (self._part + bytes([byte]))[-256:]

    def _emergency(self, line: bytes) -> None:
        self.planner.halt()
        if self._homing is not None:
            self._homing = None
            self._send("ok", self.time)
        if line == b"M112":
            self.raise_alarm(0)

    def _status(self) -> None:
        state = "Alarm" if self.alarm else "Check" if self.checking else "Jog" if self.planner.moving else "Idle"
        machine, inches = int(self.settings[10]) & 1, self.settings[13]
        shown = [value - (0.0 if machine else WORK_OFFSET) for value in self.planner.position]
        values = ",".join(f"{value / 25.4 if inches else value:.3f}" for value in shown)
        self._send(f"<{state}|{'MPos' if machine else 'WPos'}:{values}|FS:0,0>", self.time)

    def _execute(self, line: bytes) -> None:
        text = line.decode("ascii", "replace").strip()
        if self.dialect == "grbl":
            self._send(self._grbl(text.replace(" ", "")), self.time)
        elif not self.killed:
            self._marlin(text)

    def _grbl(self, text: str) -> str:
        if not text:
            return "ok"
        if match := re.fullmatch(r"\$H([XYZABC])", text):
            known = self.variant.single_homing and match[1] in self.letters
            return self._home((self.letters.index(match[1]),)) if known else self.variant.refuses_single
        if text == "$H":
            return self._home(tuple(range(len(self.units))))
        if self.variant.fluidnc and (answer := self._fluidnc(text)):
            return answer
        if text == "$I":
            self._send(f"[VER:1.1h.20190825:]\n[OPT:V{'Z' if self.variant.zero_at_home else ''},15,128]", self.time)
            if self.variant.names_axes:
                self._send(f"[AXS:{len(self.letters)}:{self.letters}]", self.time)
            return "ok"
        if text == "$G":
            self._send(f"[GC:G0 G54 G17 {'G20' if self.inches else 'G21'} G90 G94 M5 M9 T0 F0 S0]", self.time)
            return "ok"
        if text in ("G20", "G21") and not self.alarm:
            self.inches = text == "G20"
            return "ok"
        if text == "$C":
            self.checking = not self.checking
            return "ok"
        if text == "$$":
            for number, value in sorted(self.settings.items()):
                self._send(f"${number}={value:.3f}", self.time)
            return "ok"
        if text == "$#":
            other = "0.000," * 2 if self.variant.all_lengths else ""
            self._send(f"[TLO:{other}{self.mark:.3f}]", self.time)
            return "ok"
        if text == "$X":
            self.alarm = False
            return "ok"
        if match := re.fullmatch(r"\$(\d+)=([\d.]+)", text):
            self.settings[int(match[1])] = float(match[2])
            return self._grbl_settings()
        if self.alarm:
            return "error:9"
        if text[0] not in "$GFNMXYZABC":
            return "error:1"
        if match := re.fullmatch(r"G43\.1Z([\d.]+)", text):
            self.mark = float(match[1])
            return "ok"
        if match := re.fullmatch(r"\$J=G53(.*)", text):
            return "ok" if self.checking else self._move(match[1], [0.0] * len(self.units))
        return "error:3" if text.startswith("$") else "error:20"

    def _fluidnc(self, text: str) -> str:
        """Execute a command to which FluidNC and GRBL give different answers; return "" for any other command."""
        if text in ("$$", "$I"):
            self._send("$10=1" if text == "$$" else "[VER:3.7 FluidNC v3.7.0:]\n[OPT:PHSW]", self.time)
            return "ok"
        if re.fullmatch(r"\$\d+=.*", text) and not text.startswith("$10="):
            return "error:3"
        name, _, value = text.partition("=")
        if name == "$/stepping/idle_ms":
            number = 1
        elif (found := re.fullmatch(r"\$/axes/([xyzabc])/(.*)", name)) and found[2] in FLUIDNC_AXIS:
            number = FLUIDNC_AXIS[found[2]] + self.letters.index(found[1].upper())
        else:
            return ""
        if value:
            self.settings[number] = float(value)
            return self._grbl_settings()
        self._send(f"{name}={self.settings.get(number, 0.0):.3f}", self.time)
        return "ok"

    def _grbl_settings(self) -> str:
        self._apply({k: self.settings[110 + k] / 60.0 for k in range(len(self.units))}, "rates")
        self._apply({k: self.settings[120 + k] for k in range(len(self.units))}, "accelerations")
        return "ok"

    def _apply(self, values: dict[int, float], name: str) -> None:
        for k, value in values.items():
            getattr(self.planner, name)[k] = max(value, 1e-3)

    def _home_coordinate(self, i: int) -> float:
        """Return the coordinate of an axis after its homing [unit]."""
        if self.dialect == "marlin" or self.variant.zero_at_home:
            return 0.0
        if self.variant.fluidnc:
            return self.settings[FLUIDNC_AXIS["homing/mpos_mm"] + i]
        down = int(self.settings[23]) >> i & 1
        return self.settings[27] - self.settings[130 + i] if down else -self.settings[27]

    def _home(self, axes: tuple[int, ...]) -> str:
        goal, seconds = [*self.planner.position], 0.0
        for i in axes:
            unit = self.units[i]
            goal[i] -= unit.true_position * unit.setup.unit
            seconds = max(seconds, abs(unit.true_position) * unit.setup.joint.microstep / unit.setup.home_speed)
        self.planner.put(goal, seconds)
        self._homing, self._next_busy = (axes, self.time + seconds + HOME_PAUSE_S), self.time + KEEPALIVE_S
        return ""

    def _move(self, words: str, offsets: Sequence[float]) -> str:
        found = re.findall(r"([A-Z])(-?\d+(?:\.\d*)?)", words)
        if "".join(letter + number for letter, number in found) != words:
            return "error:2"
        scale = 25.4 if self.inches else 1.0
        values: dict[str, float] = {letter: scale * float(number) for letter, number in found}
        feed = values.pop("F", 0.0)
        if feed <= 0.0:
            return "error:22"
        if self.settings.get(20) and any(
            abs(v) > self.settings.get(130 + LETTERS.index(c), math.inf) for c, v in values.items()
        ):
            return "error:15"
        target = list(self.planner.end)
        for i, _ in enumerate(self.units):
            if self.letters[i] in values:
                target[i] = values[self.letters[i]] - offsets[i]
                if self.dialect == "marlin" and self.soft_endstops:
                    target[i] = max(target[i], 0.0)
        change = [b - a for a, b in zip(self.planner.end, target, strict=True)]
        rotary = self.dialect == "marlin"
        linear = math.hypot(*(d for i, d in enumerate(change) if not rotary or i < 3))
        self.planner.put(target, 60.0 * (linear or math.hypot(*change)) / feed)
        return "ok"

    def _marlin(self, text: str) -> None:
        if match := re.fullmatch(r"N(-?\d+) (.*)\*(\d+)", text):
            number, check = int(match[1]), 0
            for byte in f"N{match[1]} {match[2]}".encode():
                check ^= byte
            problem = "checksum mismatch" if check != int(match[3]) else ""
            if not problem and number != self._number + 1 and not match[2].startswith("M110"):
                problem = "Line Number is not Last Line Number+1"
            if problem:
                self._resend(problem)
                return
            renumbered = re.fullmatch(r"M110 N(-?\d+)", match[2])
            self._number, text = int(renumbered[1]) if renumbered else number, match[2]
        elif "*" in text or text.startswith("N"):
            self._resend("checksum mismatch")
            return
        self._send(self._command(text), self.time)

    def _resend(self, problem: str) -> None:
        self._send(f"Error:{problem}, Last Line: {self._number}", self.time)
        self._send(f"Resend: {self._number + 1}", self.time)
        self._send("ok", self.time)

    def _command(self, text: str) -> str:
        words = {w[0]: float(w[1:]) for w in re.findall(r"[A-Z]-?\d+(?:\.\d+)?", text)}
        own = {i: words[LETTERS[i]] for i in range(len(self.units)) if LETTERS[i] in words}
        code = text.split(" ")[0]
        if text.startswith("G1"):
            answer = self._move(text[2:].replace(" ", ""), self.offsets)
            return "ok" if answer == "ok" else f"echo:Unknown command: {text}\nok"
        match code:
            case "M114":  # without R it reports the end of the queue
                position = self.planner.position if self.realtime_position and text == "M114 R" else self.planner.end
                logical = "".join(f"{LETTERS[i]}:{p + self.offsets[i]:.2f} " for i, p in enumerate(position))
                steps = " ".join(f"{LETTERS[i]}:{round(p / self.units[i].setup.unit)}" for i, p in enumerate(position))
                return f"{logical}Count {steps}\nok"
            case "M115":
                parser = int(self.emergency_parser)
                return f"FIRMWARE_NAME:Marlin 2.1.2 (simulated)\nCap:EMERGENCY_PARSER:{parser}\nok"
            case "M92":
                return (
                    "M92 " + " ".join(f"{LETTERS[i]}{1 / u.setup.unit:.2f}" for i, u in enumerate(self.units)) + "\nok"
                )
            case "M203":
                self._apply(own, "rates")
            case "M201":
                self._apply(own, "accelerations")
            case "M211":
                if self.variant.soft_endstops == "switchable" and "S" in words:
                    self.soft_endstops = words["S"] > 0.0
                return f"  M211 S{int(self.soft_endstops)} ; {'ON' if self.soft_endstops else 'OFF'}\nok"
            case "M410" | "M112":
                if not self.emergency_parser:
                    self._emergency(code.encode())
            case "G92":
                for i, value in own.items():
                    self.offsets[i] = value - self.planner.end[i]
            case "G28":
                return self._home((next(i for i in range(len(self.units)) if LETTERS[i] in text[3:]),))
            case _:
                pass
        return "ok"

    def _send(self, text: str, now: float) -> None:
        if text:
            data = b"".join(line.encode("ascii", "replace") + b"\r\n" for line in text.split("\n"))
            self._out.put(self.noise.damage(data, self._faults), now + PROCESSING_S + self._faults.delay)
