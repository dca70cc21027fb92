"""The check of drivers in virtual time: good drivers pass, and a driver that breaks a requirement fails that one."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from station.config.robots import RobotFile, load_robot
from station.devices.driver_check.requirements import Finding, Must
from station.devices.driver_check.samples import check_sensors, check_tracker
from station.devices.driver_check.stages import check_stages
from station.devices.interfaces import (
    Clock,
    Condition,
    DeviceFault,
    DeviceKind,
    JointReading,
    Stages,
    TipReading,
    WrenchReading,
)
from station.docs.examples.line_stages import line_stages
from station.docs.examples.line_stages.line_stages import LineStages
from station.docs.examples.line_stages.test_line_stages import OPTIONS, Box
from station.lab.config import load_lab
from station.lab.virtual_bench import virtual_bench
from tests.harness.emergency import StoppingProcess
from tests.harness.stages_bench import KINDS, TICK, StagesBench

NEAR_HOME = (0.05, 0.3, -0.125)
PAPER = load_robot("paper")


class LabClock:
    """Clock in whose time the simulated stages run."""

    def __init__(self, bench: StagesBench) -> None:
        self._bench = bench

    def now(self) -> float:
        return self._bench.now

    def sleep(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / TICK))):
            self._bench.let_pass()


def findings(
    paper: RobotFile, kind: str, change: Callable[[Stages], Any] = lambda stages: stages, moves: bool = True
) -> dict[str, Finding]:
    """Return the findings of a check, by their subjects; `change` makes the driver defective."""
    bench = StagesBench(paper, kind, NEAR_HOME, homed=False)
    clock = LabClock(bench)

    def opens() -> Stages:
        bench.host.reopen()
        return change(KINDS[kind].on(bench.host, bench.robot))

    def stop(_: object) -> str:
        return StoppingProcess(bench).stop(paper, kind)

    return {finding.subject: finding for finding in check_stages(opens, paper.joints, clock, stop, moves)}


class Changed:
    """A driver with some other attributes."""

    def __init__(self, driver: Any, **others: Any) -> None:
        self._driver, self._others = driver, others

    def __getattr__(self, name: str) -> Any:
        return self._others[name] if name in self._others else getattr(self._driver, name)


def failed(found: list[Finding]) -> set[str]:
    return {finding.subject for finding in found if finding.good is False}


def of_kind(kind: DeviceKind) -> list[Must]:
    return [must for must in Must if kind in must.value.kinds]


def check_line_stages(
    change: Callable[[Any, Box], Any] = lambda stages, box: stages,
    box: Callable[[], Box] = Box,
    stop: Callable[[Clock], Any] | None = lambda clock: line_stages.emergency_stop(OPTIONS, PAPER, clock),
    driver: type[LineStages] = LineStages,
    moves: bool = True,
) -> list[Finding]:
    """Return the findings about the example's driver, or about a defective driver or box."""
    simulated = box()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(line_stages, "SerialLink", simulated.open)
        options = line_stages.Options(host="box", port=1)
        opens = lambda: change(driver(options, PAPER), simulated)  # noqa: E731
        return list(check_stages(opens, PAPER.joints, simulated, stop, moves))


def test_every_requirement_of_stages_is_checked_once_and_the_example_keeps_it():
    found = check_line_stages()
    assert sorted(finding.subject for finding in found) == sorted(must.value.name for must in of_kind("stages"))
    assert [finding for finding in found if finding.good is not True] == []


def test_built_in_driver_passes_every_check(paper):
    """`tests/thorough/test_every_driver.py` checks the other drivers."""
    assert [finding for finding in findings(paper, "zaber").values() if not finding.good] == []


def test_stages_are_not_moved_without_permission(paper):
    found = findings(paper, "zaber_ascii", moves=False)
    needs = {must.value.name for must in of_kind("stages") if must.value.moves}
    assert {finding.subject for finding in found.values() if finding.good is None} == needs
    assert all("--move" in found[name].text for name in needs)


# Stages, one defect each


class Deaf(LineStages):
    """Does not notice silence."""

    def poll(self, now: float) -> JointReading:
        self._newest = now
        return super().poll(now)


class SendsBeforeReady(LineStages):
    def command(self, velocities: np.ndarray, now: float) -> None:
        if self.ready:
            super().command(velocities, now)
        else:
            self._send(velocities)


class HidesNan(Deaf):
    """Forwards NaN to the box, and reports that it has stopped."""

    def command(self, velocities: np.ndarray, now: float) -> None:
        super().command(velocities, now)
        if not np.isfinite(velocities).all():
            self._link.write(b"nan nan nan\n")


class HidesItsSpeed(LineStages):
    """Sends a velocity beyond the limit, and reports the limited one."""

    def command(self, velocities: np.ndarray, now: float) -> None:
        if self.ready and (np.abs(velocities) > self._speeds).any():
            self._send(velocities)
            self._sent = np.clip(velocities, -self._speeds, self._speeds)
        else:
            super().command(velocities, now)


class MovesOnConnecting(LineStages):
    def connect(self, now: float) -> None:
        super().connect(now)
        self._link.write(b"0 0 0.001\n")


class Unhomed(LineStages):
    """Never becomes ready, and refuses to home."""

    ready = False  # type: ignore[assignment]


class Faulty(Box):
    """A box with a fault from a time on, in which the axes move."""

    def __init__(self, since: float, fault: str) -> None:
        super().__init__()
        self._since, self._fault = since, fault

    def fails(self, fault: str) -> bool:
        return self._fault == fault and self.now() > self._since

    def receive(self, line: str) -> None:
        if "nan" in line:
            self._fault, self._since = "silent", self.now()  # its program ends
        elif self.fails("runs away"):
            self._commanded = 3.0 * np.array([joint.speed for joint in PAPER.joints])
        elif self.fails("halves") and line != "stop":
            super().receive(" ".join(f"{0.5 * float(each):g}" for each in line.split()))
        elif self.fails("swaps") and line != "stop":
            super().receive(" ".join(line.split()[i] for i in (1, 0, 2)))
        else:
            super().receive(line)

    def send(self) -> None:
        if self.fails("frozen"):
            self.port.device.write(self._last)
        elif not self.fails("silent"):
            self._last = (" ".join(f"{q:.9f}" for q in self.positions) + "\n").encode()
            super().send()


#: A time of the check at which the stages move; a later one is in the motion after the first stop.
MOVING, AFTER_STOP = 1.6, 2.2


def raising(name: str, since: float) -> Callable[[Any, Box], Any]:
    """Return a change by which a method raises from a time on."""

    def change(stages: Any, box: Box) -> Any:
        def method(*arguments: Any) -> Any:
            if box.now() >= since:
                raise ZeroDivisionError("float division by zero")
            return getattr(stages, name)(*arguments)

        return Changed(stages, **{name: method})

    return change


def polled(edit: Callable[[JointReading], Any], since: float = 0.0) -> Callable[[Any, Box], Any]:
    """Return a change of the reading from a time on."""

    def change(stages: Any, box: Box) -> Any:
        return Changed(stages, poll=lambda now: edit(stages.poll(now)) if box.now() >= since else stages.poll(now))

    return change


def waiting(name: str, seconds: float) -> Callable[[Any, Box], Any]:
    """Return a change by which a method waits."""

    def change(stages: Any, box: Box) -> Any:
        def method(*arguments: Any) -> Any:
            box.sleep(seconds)
            return getattr(stages, name)(*arguments)

        return Changed(stages, **{name: method})

    return change


def nan_in_the_middle(reading: JointReading) -> JointReading:
    return reading._replace(positions=np.array([reading.positions[0], math.nan, reading.positions[2]]))


class Freezing:
    """Change by which a driver returns its last positions from a time on, although the box works."""

    def __init__(self, since: float) -> None:
        self._since = since

    def __call__(self, stages: Any, box: Box) -> Any:
        last: list[np.ndarray] = []

        def poll(now: float) -> JointReading:
            reading = stages.poll(now)
            if box.now() < self._since:
                last[:] = [reading.positions]
            return reading._replace(positions=last[0])

        return Changed(stages, poll=poll)


def unconfirmed(clock: Clock) -> str:
    return "stopped"


def broken_stop(clock: Clock) -> str:
    raise OSError("no such port")


def slow_stop(clock: Clock) -> str:
    text = line_stages.emergency_stop(OPTIONS, PAPER, clock)
    clock.sleep(3.0)
    return text


DEFECTS: dict[str, tuple[Must, dict[str, Any]]] = {
    "poll raises": (Must.NO_EXCEPTIONS, {"change": raising("poll", MOVING)}),
    "command raises": (Must.NO_EXCEPTIONS, {"change": raising("command", MOVING)}),
    "stop raises": (Must.NO_EXCEPTIONS, {"change": raising("stop", 1.0)}),
    "trouble raises": (Must.NO_EXCEPTIONS, {"change": raising("trouble", MOVING)}),
    "connect raises": (Must.NO_EXCEPTIONS, {"change": raising("connect", 0.0)}),
    "only the last stop raises": (Must.NO_EXCEPTIONS, {"change": raising("stop", 0.0), "moves": False}),
    "tuple": (Must.RESULTS, {"change": polled(tuple)}),
    "two positions": (Must.RESULTS, {"change": polled(lambda r: r._replace(positions=r.positions[:2]))}),
    "sent is unknown": (Must.RESULTS, {"change": polled(lambda r: r._replace(sent=np.nan * r.sent))}),
    "ready is a number": (Must.RESULTS, {"change": lambda stages, box: Changed(stages, ready=1)}),
    "each poll waits": (Must.DURATION, {"change": waiting("poll", 0.005)}),
    "stop waits": (Must.DURATION, {"change": waiting("stop", 1.0)}),
    "mute box": (Must.CONNECTION, {"box": partial(Faulty, 0.0, "silent")}),
    "box becomes mute": (Must.CONNECTION, {"box": partial(Faulty, MOVING, "silent")}),
    "zero before connecting": (
        Must.UNKNOWN,
        {"change": polled(lambda r: r._replace(positions=np.nan_to_num(r.positions)))},
    ),
    "moves on connecting": (Must.REST, {"driver": MovesOnConnecting, "moves": False}),
    "sends before ready": (Must.NOT_READY, {"driver": SendsBeforeReady}),
    "refuses to home": (Must.HOMING, {"driver": Unhomed}),
    "unknown in the middle": (Must.FINITE, {"change": polled(nan_in_the_middle, MOVING)}),
    "driver freezes at rest": (Must.FRESH, {"change": Freezing(0.5)}),
    "driver freezes in motion": (Must.FRESH, {"change": Freezing(1.1)}),
    "silence is not noticed": (Must.FRESH, {"driver": Deaf, "box": partial(Faulty, 1.1, "silent")}),
    "box freezes": (Must.FRESH, {"box": partial(Faulty, 1.1, "frozen")}),
    "box freezes at its stop": (Must.FRESH, {"box": partial(Faulty, AFTER_STOP, "frozen")}),
    "half the velocity": (Must.SPEED, {"box": partial(Faulty, 0.0, "halves")}),
    "exchanged joints": (Must.SPEED, {"box": partial(Faulty, 0.0, "swaps")}),
    "sent is the opposite": (Must.SPEED, {"change": polled(lambda r: r._replace(sent=-r.sent))}),
    "hidden speed": (Must.SPEED_LIMIT, {"driver": HidesItsSpeed}),
    "box runs away": (Must.SPEED_LIMIT, {"box": partial(Faulty, 1.1, "runs away")}),
    "stop without effect": (Must.STOP, {"change": lambda stages, box: Changed(stages, stop=lambda now: None)}),
    "forwards nan to a box that ends": (Must.VELOCITY_NAN, {"driver": HidesNan, "box": partial(Faulty, math.inf, "")}),
    "no emergency stop": (Must.EMERGENCY_STOP, {"stop": None}),
    "emergency stop without effect": (Must.EMERGENCY_STOP, {"stop": unconfirmed}),
    "emergency stop raises": (Must.EMERGENCY_STOP, {"stop": broken_stop}),
    "emergency stop without a text": (Must.EMERGENCY_STOP, {"stop": lambda clock: slow_stop(clock) and None}),
    "slow emergency stop": (Must.EMERGENCY_STOP, {"stop": slow_stop}),
}


@pytest.mark.parametrize("defect", list(DEFECTS))
def test_a_defect_of_stages_fails_its_requirement(defect):
    must, about = DEFECTS[defect]
    found = check_line_stages(**about)
    assert failed(found) == {must.value.name}, found
    assert len(found) == len({finding.subject for finding in found}) == len(of_kind("stages"))


def test_stages_whose_stop_raises_are_stopped_by_their_emergency_stop():
    box = Box()
    check_line_stages(raising("stop", 1.0), lambda: box)
    box.sleep(0.3)  # the axes brake
    before = box.positions
    box.sleep(1.0)
    assert box.positions.tolist() == before.tolist()


def test_every_requirement_of_stages_has_a_defect():
    assert {must for must, _ in DEFECTS.values()} == set(of_kind("stages"))


# Trackers and sensors


class OwnClock:
    """Clock whose time passes only while the check sleeps."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time = round(self.time + seconds, 6)


class Sampled:
    """A tracker or two force sensors; each of `edits` changes the reading number `n` of the time `time`."""

    condition = Condition.CLOSED

    def __init__(self, clock: OwnClock, period: float, reading: Callable[[int, float], Any]) -> None:
        self._clock, self._period, self._reading, self._last = clock, period, reading, -1

    def connect(self, now: float) -> None:
        self.condition = Condition.CONNECTED

    def poll(self, now: float) -> Any:
        number = math.floor(now / self._period)
        new, self._last = number != self._last, number
        reading = self._reading(number, min(now, number * self._period))
        return None if isinstance(reading, TipReading) and not new else reading

    def trouble(self, now: float) -> DeviceFault | None:
        return None

    def close(self) -> None:
        self.condition = Condition.CLOSED


def tip(number: int, time: float) -> TipReading:
    return TipReading(
        number, time, np.array([0.1, 0.0, 0.15 + 1e-5 * math.sin(time)]), direction=np.array([0.0, 0.6, 0.8])
    )


def wrench(number: int, time: float) -> WrenchReading:
    return WrenchReading(time, np.full((2, 6), math.sin(time)))


def raised() -> Any:
    raise OSError("gone")


def check_sampled(reading: Callable[[int, float], Any], change: Callable[[Any, OwnClock], Any]) -> list[Finding]:
    clock = OwnClock()
    if isinstance(reading(0, 0.0), TipReading):
        return list(check_tracker(lambda: change(Sampled(clock, 0.025, reading), clock), clock))
    return list(check_sensors(lambda: change(Sampled(clock, 0.001, reading), clock), 2, clock))


def unchanged(device: Any, clock: OwnClock) -> Any:
    return device


def wait(device: Any, clock: OwnClock) -> Any:
    return Changed(device, poll=lambda now: clock.sleep(0.004) or device.poll(now))


def fail_later(device: Any, clock: OwnClock) -> Any:
    def poll(now: float) -> Any:
        if now > 1.5:
            device.condition = Condition.FAULT
        return device.poll(now)

    return Changed(device, poll=poll)


#: Reading of a device after 1.5 s of the check.
def late(reading: Callable[[int, float], Any], wrong: Callable[[int, float], Any]) -> Callable[[int, float], Any]:
    return lambda number, time: wrong(number, time) if time > 1.5 else reading(number, time)


UNKNOWN = np.full(3, math.nan)
TRACKER_DEFECTS: dict[str, tuple[set[Must], Callable[[int, float], Any], Callable[[Any, OwnClock], Any]]] = {
    "raises": ({Must.NO_EXCEPTIONS}, late(tip, lambda n, t: raised()), unchanged),
    "four numbers": ({Must.RESULTS}, late(tip, lambda n, t: tip(n, t)._replace(position=np.zeros(4))), unchanged),
    "waits": ({Must.DURATION}, tip, wait),
    "fault": ({Must.CONNECTION}, tip, lambda device, _: Changed(device, condition=Condition.FAULT)),
    "fault later": ({Must.CONNECTION}, tip, fail_later),
    "silent": ({Must.SAMPLES}, late(tip, lambda n, t: None), unchanged),
    "time does not advance": ({Must.SAMPLES, Must.TIMES}, lambda n, t: tip(n, 0.0), unchanged),
    "frame repeats": (
        {Must.SAMPLES, Must.TIMES, Must.FRAME_NUMBERS}, late(tip, lambda n, t: tip(60, 1.5)), unchanged
    ),
    "time in the future": ({Must.TIMES}, lambda n, t: tip(n, t + 0.1), unchanged),
    "time of another clock": ({Must.TIMES}, lambda n, t: tip(n, t - 1000.0), unchanged),
    "time in milliseconds": ({Must.TIMES}, lambda n, t: tip(n, t / 1000.0), unchanged),
    "frame number repeats": ({Must.FRAME_NUMBERS}, late(tip, lambda n, t: tip(60, t)), unchanged),
    "position nan": ({Must.POSITIONS}, late(tip, lambda n, t: tip(n, t)._replace(position=UNKNOWN)), unchanged),
    "millimetres": (
        {Must.POSITIONS}, lambda n, t: tip(n, t)._replace(position=1e3 * tip(n, t).position), unchanged
    ),
    "direction of length 2": (
        {Must.POSITIONS}, lambda n, t: tip(n, t)._replace(direction=np.array([0.0, 0.0, 2.0])), unchanged
    ),
}  # fmt: skip
SENSOR_DEFECTS: dict[str, tuple[set[Must], Callable[[int, float], Any], Callable[[Any, OwnClock], Any]]] = {
    "raises": ({Must.NO_EXCEPTIONS}, late(wrench, lambda n, t: raised()), unchanged),
    "one tube": ({Must.RESULTS}, lambda n, t: WrenchReading(t, np.zeros((1, 6))), unchanged),
    "none": ({Must.RESULTS}, late(wrench, lambda n, t: None), unchanged),
    "waits": ({Must.DURATION}, wrench, wait),
    "fault": ({Must.CONNECTION}, wrench, lambda device, _: Changed(device, condition=Condition.FAULT)),
    "unusable": ({Must.SAMPLES}, late(wrench, lambda n, t: wrench(n, t)._replace(usable=False)), unchanged),
    "sample repeats": ({Must.SAMPLES, Must.TIMES}, late(wrench, lambda n, t: wrench(1500, 1.5)), unchanged),
    "time in the future": ({Must.TIMES}, lambda n, t: wrench(n, t + 0.1), unchanged),
    "wrench nan": (
        {Must.WRENCHES}, late(wrench, lambda n, t: WrenchReading(t, np.full((2, 6), math.nan))), unchanged
    ),
}  # fmt: skip


SAMPLED_DEFECTS = {"tracker": TRACKER_DEFECTS, "sensors": SENSOR_DEFECTS}


@pytest.mark.parametrize(("kind", "defect"), [(kind, name) for kind, all_ in SAMPLED_DEFECTS.items() for name in all_])
def test_a_defect_of_a_tracker_or_of_sensors_fails_its_requirement(kind, defect):
    musts, reading, change = SAMPLED_DEFECTS[kind][defect]
    found = check_sampled(reading, change)
    assert failed(found) == {must.value.name for must in musts}, found
    assert len(found) == len(of_kind(kind))


@pytest.mark.parametrize(("kind", "defects"), SAMPLED_DEFECTS.items())
def test_every_requirement_of_tracker_and_sensors_has_a_defect(kind, defects):
    alone = [next(iter(musts)) for musts, _, _ in defects.values() if len(musts) == 1]
    assert set(alone) == set(of_kind(kind))


def test_built_in_tracker_and_sensors_pass_every_check():
    start = np.array([0.0, math.pi / 2, -0.1])
    lab, devices = virtual_bench(PAPER, load_lab("gentle", PAPER), 0, start)

    class TimeOfLab(OwnClock):
        def sleep(self, seconds: float) -> None:
            super().sleep(seconds)
            lab.advance(self.time)

    def opened(device: Any) -> Callable[[], Any]:
        return lambda: device

    clock = TimeOfLab()
    for found in (
        check_tracker(opened(devices.tracker), clock),
        check_sensors(opened(devices.sensors), len(PAPER.tubes), clock),
    ):
        assert [finding for finding in found if finding.good is not True] == []


def test_value_that_never_changes_is_mentioned():
    found = check_sampled(lambda n, t: tip(n, t)._replace(position=np.zeros(3)), unchanged)
    assert ["all are equal" in finding.text for finding in found if finding.requirement is Must.POSITIONS] == [True]
