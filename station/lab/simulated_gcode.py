"""A simulated G-code board at wire level: GRBL 1.1 at 115200 baud or Marlin 2 at 250000 baud."""

import math
import re
from collections import deque
from collections.abc import Sequence

from station.devices.gcode.protocol import BAUDS, Dialect
from station.devices.gcode.setup import AxisSetup, GcodeAxisFile, Letter
from station.devices.zaber.setup import StageSetup
from station.lab.gcode_planner import Planner
from station.lab.simulated_zaber import Faults, LineNoise, PacedLine, free_buffer

BLOCKS: dict[Dialect, int] = {"grbl": 15, "marlin": 16}
BANNER = "Grbl 1.1h ['$' for help]"
LETTERS: tuple[Letter, ...] = ("X", "Y", "Z", "A", "B", "C")
RESTART_TIME_S = 0.5  #: time after switching on in which the board ignores bytes [s]
PROCESSING_S = 0.0005  #: time from the end of a line to the start of its reply; assumed [s]
KEEPALIVE_S = 2.0  #: interval in which Marlin reports that it executes a long command [s]
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
    """One board that moves every stage."""

    def __init__(
        self,
        dialect: Dialect,
        setups: Sequence[StageSetup],
        true_positions: Sequence[float],
        homed: bool,
        seed: int = 0,
    ) -> None:
        self.dialect, self.time = dialect, 0.0
        self.emergency_parser = self.realtime_position = True  # options of the Marlin firmware
        self.planner = Planner(len(setups), BLOCKS[dialect])
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
        self._incoming: deque[tuple[float, int]] = deque()  # bytes with their arrival
        self._lines: deque[bytes] = deque()
        self._part, self._free, self._deaf_until = b"", -math.inf, -math.inf
        self._out = PacedLine(self._byte_time)
        self._homing: tuple[int, float] | None = None  # axis, and the end of its homing [s]
        self._next_busy = math.inf  # time of the next report of a long command [s]
        self._number = 0
        self.settings = {10: 1.0, 22: 1.0}
        for k, axis in enumerate(axes):
            self.settings |= {100 + k: 1.0 / axis.unit, 110 + k: 500.0, 120 + k: 10.0}

    @property
    def faults(self) -> Faults:
        """Active faults; a fault of one slot's cable is one of the whole board."""
        return self._faults

    @faults.setter
    def faults(self, faults: Faults) -> None:
        self._faults = faults
        for slot, unit in enumerate(self.units, 1):
            if slot in faults.stalled and unit.stuck is None:
                unit.stuck = unit.true_position
            elif slot not in faults.stalled and unit.stuck is not None:
                true, unit.stuck = unit.stuck, None
                unit.shift += true - unit.true_position

    def power_cycle(self, slot: int) -> None:  # noqa: ARG002 - all stages have one board
        """Switch the board off and on."""
        self._restart()
        self._deaf_until = self.time + RESTART_TIME_S
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
            (i, _), self._homing = self._homing, None
            self.planner.set_position(i, 0.0)
            self.units[i].shift = 0.0
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
                    self._part, self.mark = b"", 0.0
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
        state = "Alarm" if self.alarm else "Jog" if self.planner.moving else "Idle"
        values = ",".join(f"{value:.3f}" for value in self.planner.position)
        self._send(f"<{state}|MPos:{values}|FS:0,0>", self.time)

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
            i = "".join(LETTERS).index(match[1])
            return self._home(i) if i < len(self.units) else "error:3"
        if text == "$$":
            for number, value in sorted(self.settings.items()):
                self._send(f"${number}={value:.3f}", self.time)
            return "ok"
        if text == "$#":
            self._send(f"[TLO:{self.mark:.3f}]", self.time)
            return "ok"
        if text == "$X":
            self.alarm = False
            return "ok"
        if match := re.fullmatch(r"\$(\d+)=([\d.]+)", text):
            self.settings[int(match[1])] = float(match[2])
            self._apply({k: self.settings[110 + k] / 60.0 for k in range(len(self.units))}, "rates")
            self._apply({k: self.settings[120 + k] for k in range(len(self.units))}, "accelerations")
            return "ok"
        if self.alarm:
            return "error:9"
        if text[0] not in "$GFNMXYZABC":
            return "error:1"
        if match := re.fullmatch(r"G43\.1Z([\d.]+)", text):
            self.mark = float(match[1])
            return "ok"
        if text.startswith("$J=G53"):
            return self._move(text[6:], [0.0] * len(self.units))
        return "error:3" if text.startswith("$") else "error:20"

    def _apply(self, values: dict[int, float], name: str) -> None:
        for k, value in values.items():
            getattr(self.planner, name)[k] = max(value, 1e-3)

    def _home(self, i: int) -> str:
        unit = self.units[i]
        goal = [*self.planner.position]
        goal[i] -= unit.true_position * unit.setup.unit
        distance = abs(unit.true_position) * unit.setup.joint.microstep
        seconds = distance / unit.setup.home_speed
        self.planner.put(goal, seconds)
        self._homing, self._next_busy = (i, self.time + seconds + HOME_PAUSE_S), self.time + KEEPALIVE_S
        return ""

    def _move(self, words: str, offsets: Sequence[float]) -> str:
        found = re.findall(r"([A-Z])(-?\d+(?:\.\d*)?)", words)
        if "".join(letter + number for letter, number in found) != words:
            return "error:2"
        values: dict[str, float] = {letter: float(number) for letter, number in found}
        feed = values.pop("F", 0.0)
        if feed <= 0.0:
            return "error:22"
        if self.settings.get(20) and any(
            abs(v) > self.settings.get(130 + LETTERS.index(c), math.inf) for c, v in values.items()
        ):
            return "error:15"
        target = list(self.planner.end)
        for i, _ in enumerate(self.units):
            if LETTERS[i] in values:
                target[i] = values[LETTERS[i]] - offsets[i]
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
            case "M114":  # without R the end of the queue
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
            case "M410" | "M112":
                if not self.emergency_parser:
                    self._emergency(code.encode())
            case "G92":
                for i, value in own.items():
                    self.offsets[i] = value - self.planner.end[i]
            case "G28":
                return self._home(next(i for i in range(len(self.units)) if LETTERS[i] in text[3:]))
            case _:
                pass
        return "ok"

    def _send(self, text: str, now: float) -> None:
        if text:
            data = b"".join(line.encode("ascii", "replace") + b"\r\n" for line in text.split("\n"))
            self._out.put(self.noise.damage(data, self._faults), now + PROCESSING_S + self._faults.delay)
