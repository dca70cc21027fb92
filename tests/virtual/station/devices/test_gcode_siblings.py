"""Behaviour of GRBL and Marlin boards that only public reports describe, simulated in virtual time."""

from dataclasses import replace
from typing import Any

import pytest

from station.config.robots import RobotFile
from station.devices.gcode.protocol import Dialect
from station.devices.gcode.sequences import WITHOUT
from station.devices.interfaces import Condition
from station.lab.gcode_variants import VARIANTS, BoardVariant
from station.lab.simulated_gcode import SimulatedBoard
from tests.harness.stages_bench import START, StagesBench
from tests.virtual.station.devices.test_gcode_variants import bench_of, moves

USUAL = VARIANTS["usual"]


def bench_with(
    robot: RobotFile, dialect: Dialect, board: type[SimulatedBoard], variant: BoardVariant = USUAL, homed: bool = True
) -> StagesBench:
    """Return a bench whose board is a subclass of the simulated one."""
    bench = bench_of(robot, dialect, variant)
    places = [(q - s.home_at) / s.joint.microstep for q, s in zip(START, bench.setups, strict=True)]
    bench.simulated = board(dialect, bench.setups, places, homed, 0, variant)
    return bench


class Garbles(SimulatedBoard):
    """Answers a query of a setting of FluidNC by no number."""

    def _send(self, text: str, now: float) -> None:
        super()._send("$/axes/x/steps_per_mm=8O" if text.startswith("$/axes/x/steps_per_mm=") else text, now)


class Explains(SimulatedBoard):
    """Explains each of its settings, as grblHAL does."""

    def _send(self, text: str, now: float) -> None:
        if text[:1] == "$" and "=" in text:
            text = text.replace("=", " = " if text.startswith("$1 ") else "=") + "    (Step idle delay, milliseconds)"
        super()._send(text, now)


class Reports(SimulatedBoard):
    """Sends its status without a query, as by grblHAL's `$481` or FluidNC's `$Report/Interval`."""

    next_report = 0.0

    def advance(self, now: float) -> bytes:
        if now >= self.next_report:
            self.next_report = now + 0.05
            self._status()
        return super().advance(now)


class HasPendant(SimulatedBoard):
    """Reports once that a pendant has taken the control, and then ignores lines."""

    taken = False

    def take(self) -> None:
        self.taken = True
        self._send("<Idle|MPos:0.000,0.000,0.000|FS:0,0|MPG:1>", self.time)

    def _execute(self, line: bytes) -> None:
        if not self.taken:
            super()._execute(line)


class RunsFile(SimulatedBoard):
    """Names the file on its card in each report."""

    def _send(self, text: str, now: float) -> None:
        super()._send(text.replace("|FS:0,0>", "|FS:0,0|SD:12.50,/sd/my part.nc>"), now)


class Levels(SimulatedBoard):
    """Adds a slope of the bed to the steps of Z until levelling is switched off (`M420 S0`)."""

    levels = True

    def _command(self, text: str) -> str:
        self.levels = self.levels and text != "M420 S0"
        answer = super()._command(text)
        if self.levels and text == "M114 R":
            head, _, steps = answer.partition(" Z:" if "Count" not in answer else "Count ")
            x = self.planner.position[0]
            z = int(steps.split("Z:")[1].split("\n")[0]) + round(0.02 * x / self.units[2].setup.unit)
            return f"{head}Count {steps.split('Z:')[0]}Z:{z}\nok"
        return answer


class ReportsQueue(SimulatedBoard):
    """Sends the position at the end of its queue twice in a second, until `M154 S0`."""

    next_report: float = 0.0

    def _command(self, text: str) -> str:
        if text == "M154 S0":
            self.next_report = float("inf")
        return super()._command(text)

    def advance(self, now: float) -> bytes:
        if now >= self.next_report:
            self.next_report = now + 0.02
            self._send(self._command("M114").removesuffix("\nok"), now)
        return super().advance(now)


class HaltsItself(SimulatedBoard):
    """Halts after 20 s without a motion, until `M85 S0`."""

    moved_at, longest = 0.0, 20.0

    def _command(self, text: str) -> str:
        if text == "M85 S0":
            self.longest = float("inf")
        if text.startswith("G1"):
            self.moved_at = self.time
        return super()._command(text)

    def advance(self, now: float) -> bytes:
        if now - self.moved_at > self.longest and not self.killed:
            self.raise_alarm(0)
        return super().advance(now)


class StaysInAlarm(SimulatedBoard):
    """Stays in an alarm of grblHAL, of which it reports the number with its state, and rejects all commands."""

    number = 10

    def _send(self, text: str, now: float) -> None:
        super()._send(text.replace("<Idle|", f"<Alarm:{self.number}|"), now)

    def _grbl(self, text: str) -> str:
        return super()._grbl(text) if text in ("", "$I") else "error:79"


class NeedsAllHomed(SimulatedBoard):
    """Returns to the alarm after the homing of one axis until all are homed, as grblHAL does, without a line."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.homed = set[str]()

    def _grbl(self, text: str) -> str:
        if text.startswith("$H") and text[2:] in self.letters:
            self.homed.add(text[2:])
        return super()._grbl(text)

    def _status(self) -> None:
        self.alarm = self.alarm or len(self.homed) < len(self.letters)
        super()._status()


class Chatters(SimulatedBoard):
    """Sends lines that no command requested, as Marlin does (M155, host actions, SD card)."""

    next_line = 0.0

    def advance(self, now: float) -> bytes:
        if now >= self.next_line and not self.killed:
            self.next_line = now + 0.2
            for text in (" T:21.3 /0.0 B:20.8 /0.0 @:0 B@:0", "//action:notification ready", "echo:SD init fail"):
                self._send(text, now)
        return super().advance(now)


class KnowsNone(SimulatedBoard):
    """Knows none of the optional commands."""

    def _command(self, text: str) -> str:
        if text.split(" ")[0] in ("M154", "M420", "M425", "M593", "M852"):
            return f'echo:Unknown command: "{text}"\nok'
        return super()._command(text)


@pytest.mark.parametrize(
    ("dialect", "board"),
    [("grbl", Explains), ("grbl", Reports), ("grbl", RunsFile), ("marlin", Levels), ("marlin", ReportsQueue),
     ("marlin", KnowsNone), ("marlin", Chatters)],
)  # fmt: skip
def test_board_with_other_words_or_functions_connects_and_moves(
    paper: RobotFile, dialect: Dialect, board: type[SimulatedBoard]
) -> None:
    bench = bench_with(paper, dialect, board).connect()
    assert bench.stages.ready, bench.cause
    moves(bench)


@pytest.mark.parametrize(("number", "words"), [(10, "the emergency stop is active"), (17, "the driver of a motor")])
def test_alarm_of_grblhal_that_lasts_is_named_when_connecting(paper: RobotFile, number: int, words: str) -> None:
    bench = bench_with(paper, "grbl", StaysInAlarm, VARIANTS["grblhal"])
    assert isinstance(bench.simulated, StaysInAlarm)
    bench.simulated.number = number
    bench.connect()
    assert bench.stages.condition is Condition.FAULT
    assert f"the board reports: {words}" in bench.cause


@pytest.mark.parametrize(("name", "words"), [("grblhal", "see the table"), ("fluidnc", "the board must be homed")])
def test_alarm_has_the_meaning_of_its_firmware(paper: RobotFile, name: str, words: str) -> None:
    bench = bench_of(paper, "grbl", VARIANTS[name]).connect()
    assert isinstance(bench.simulated, SimulatedBoard)
    bench.simulated.raise_alarm(14)
    bench.run(0.3)
    assert f"the board reports: {words}" in bench.cause


def test_grblhal_that_locks_itself_until_all_axes_are_homed_is_homed(paper: RobotFile) -> None:
    bench = bench_with(paper, "grbl", NeedsAllHomed, VARIANTS["grblhal"], homed=False).connect()
    bench.home()
    assert bench.stages.ready, bench.cause
    moves(bench)


def test_bytes_before_the_start_of_marlin_are_skipped(paper: RobotFile) -> None:
    bench = StagesBench(paper, "marlin")
    bench.simulated.start_for(2.0)
    bench.host.device.to_host.extend(b"\xff\x00\xe3boot\nld\r\n\xfe")
    bench.connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause


def test_marlin_does_not_halt_itself_without_motions(paper: RobotFile) -> None:
    bench = bench_with(paper, "marlin", HaltsItself).connect()
    bench.run(30.0)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause


def test_functions_of_marlin_that_change_motions_are_switched_off(paper: RobotFile) -> None:
    bench, sent = bench_of(paper, "marlin", USUAL), bytearray()
    receive = bench.simulated.receive

    def recorded(data: bytes, now: float) -> None:
        sent.extend(data)
        receive(data, now)

    bench.simulated.receive = recorded
    bench.connect()
    assert all(f" {text}*".encode() in sent for text in WITHOUT)
    assert bench.stages.ready, bench.cause


def test_pendant_that_has_the_control_is_named(paper: RobotFile) -> None:
    bench = bench_with(paper, "grbl", HasPendant).connect()
    assert bench.stages.ready, bench.cause
    assert isinstance(bench.simulated, HasPendant)
    bench.simulated.take()
    bench.run(0.3)
    assert "the board reports the state 'Pendant': give the control back at its pendant" in bench.cause


def test_grblhal_without_the_homing_of_single_axes_homes_all(paper: RobotFile) -> None:
    variant = replace(VARIANTS["grblhal"], single_homing=False, refuses_single="error:5")
    bench = bench_of(paper, "grbl", variant, homed=False).connect()
    bench.home()
    assert bench.stages.ready, bench.cause
    moves(bench)


def test_disabled_homing_is_named(paper: RobotFile) -> None:
    variant = replace(USUAL, single_homing=False, refuses_single="error:5", settings={22: 0.0})
    bench = bench_of(paper, "grbl", variant, homed=False).connect()
    bench.home()
    assert "homing is not enabled ($22)" in bench.cause


def test_setting_of_fluidnc_that_is_no_number_is_quoted(paper: RobotFile) -> None:
    bench = bench_with(paper, "grbl", Garbles, VARIANTS["fluidnc"]).connect()

    assert bench.stages.condition is not Condition.CONNECTED
    assert "steps_per_mm=8O'] to $/axes/x/steps_per_mm; expected a number, true or false" in bench.cause


def test_soft_limits_of_fluidnc_that_do_not_contain_the_travel_are_named(paper: RobotFile) -> None:
    usual = VARIANTS["fluidnc"]
    bench = bench_of(paper, "grbl", replace(usual, settings={**usual.settings, 910: 1.0})).connect()
    assert "soft limits keep X between 3 and 203, but outer_rotation moves" in bench.cause
