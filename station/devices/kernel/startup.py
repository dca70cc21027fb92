"""Connecting and homing of axes: the part that all protocols share, and the interface of a protocol's own steps.

A script is a generator that yields requests or waiting times [s] and receives the answers; `ScriptRunner` runs it.
"""

import math
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from core.errors import CtrError
from station.devices.kernel.axis import CountedJoint
from station.devices.kernel.estimate import AxisEstimate
from station.devices.kernel.setting import Setting
from station.devices.kernel.setting import Value as SettingValue

STOP_TIMEOUT_S = 5.0  #: time in which every axis must confirm a stop [s]
BOOT_S = 10.0  #: time for a device's first answer; opening the port resets some devices, and others start slowly [s]
BOOT_WORD_S = 1.0  #: time without an answer after which a warning names the device that is waited for [s]
SETTLE_TIMEOUT_S = 2.0  #: time in which the positions of all homed axes must be confirmed [s]
HOMING_SLACK_S = 10.0  #: a homing motion may take twice its longest computed time plus this time [s]

Script = Generator[Any, Any, None]  #: yields requests, or waiting times [s]; receives answers
T = TypeVar("T")
Value = Generator[Any, Any, T]  #: script with a result


SetupT = TypeVar("SetupT", bound=CountedJoint)


class StartupError(CtrError):
    """An axis does not do what connecting or homing needs; the text names the stage and the reason."""


class HomingStep(NamedTuple):
    """Motion of one axis to its home sensor."""

    joint: str
    unit: str
    way: float  #: distance of the motion [unit]
    exact: bool  #: whether the start position is known; if not, `way` is the longest possible distance
    speed: float  #: speed of the motion [unit/s]


def homing_step(setup: CountedJoint, count: float | None) -> HomingStep:
    """Return the homing motion of a stage from `count` [counts]; None: the position is unknown.

    Axes home towards lower counts. A rotation passes its sensor once per turn; a rotation that starts below its zero
    turns back up by one turn after it has found the sensor.
    """
    turns, step, turn = setup.joint.motion == "rotation", setup.joint.microstep, 2.0 * math.pi
    if count is None:
        way = turn if turns else (setup.maximum - setup.minimum) * step
    else:
        above = (count - setup.home_count) * step
        way = above if above >= 0.0 or not turns else 2.0 * turn + above
    return HomingStep(setup.joint.name, "rad" if turns else "m", abs(way), count is not None, setup.home_speed)


class Homing:
    """Progress of the homing motions of all axes, which home one after the other."""

    def __init__(self, steps: Sequence[HomingStep]) -> None:
        self._steps = tuple(steps)
        self._at, self._since = 0, 0.0

    def start(self, number: int, now: float) -> None:
        """Record that the homing motion with the index `number` starts at `now` [s]."""
        self._at, self._since = number, now

    def progress(self, now: float) -> Mapping[str, Any]:
        """Return the moving axis, its number `of` all, distance `gone` of `way` [unit], and remaining time [s]."""
        step = self._steps[self._at]
        gone = min(step.way, (now - self._since) * step.speed)
        left = (step.way - gone) / step.speed + sum(each.way / each.speed for each in self._steps[self._at + 1 :])
        return {
            "joint": step.joint, "number": self._at + 1, "of": len(self._steps), "gone": gone, "way": step.way,
            "exact": step.exact, "unit": step.unit, "left_s": left,
        }  # fmt: skip


class Axes(Generic[SetupT]):
    """All axes of a driver; what is known of them persists when their ports are opened again."""

    def __init__(self, setups: Sequence[SetupT]) -> None:
        self.setups = tuple(setups)
        self.now = -math.inf  #: time [s], set before a script continues
        self.identities: list[NamedTuple | None] = [None for _ in setups]  #: as axes have reported it; None: not yet
        self.homed = [False for _ in setups]
        self.started = -math.inf  #: time at which connecting started [s]
        self.waits = ""  #: text that states what connecting waits for; empty: nothing
        self.home_again: set[int] = set()  #: axes that must be homed even if they report to be homed
        self.homing: Homing | None = None  #: progress of the latest homing
        #: Settings of each axis and of its device by name: value found, meaning, and what it was set to.
        self.settings: list[dict[str, str]] = [{} for _ in setups]
        self.estimates: Sequence[AxisEstimate] = ()  #: estimates of this session, in the order of the setups

    def name(self, i: int) -> str:
        """Return the name of a stage, for messages."""
        return f"the stage {self.setups[i].joint.name}"

    def record(
        self,
        i: int | None,
        setting: Setting,
        found: SettingValue | None,
        wanted: SettingValue | None = None,
        name: str = "",
    ) -> None:
        """Record the values of a setting of axis `i`, or of all axes (None); `name` replaces the setting's name."""
        for each in self.settings if i is None else (self.settings[i],):
            each[name or setting.name] = setting.text(found, wanted)

    def count(self, i: int) -> float:
        """Return the estimated position of a stage [counts]."""
        return self.estimates[i].position + self.setups[i].minimum

    def must_home(self, i: int) -> None:
        """Record that a stage has lost its position and must be homed."""
        self.homed[i] = False
        self.home_again.add(i)

    def identify(self, i: int, found: NamedTuple, expected: Mapping[str, Any]) -> None:
        """Check the identity of an axis against that of the last session, or else against `expected` (None: any).

        Raises:
            StartupError: it is another device.
        """
        before, values = self.identities[i], found._asdict()
        for key, value in expected.items():
            value = value if before is None else getattr(before, key)
            if value is not None and values[key] != value:
                what = {"device_id": "device ID", "serial": "serial number"}[key]
                raise StartupError(
                    f"{self.name(i)} has {what} {values[key]}; {value} is expected: is it another device?"
                )
        self.identities[i] = found

    def first_answer(self, who: str, ask: Callable[[], Value[T | None]]) -> Value[T | None]:
        """Return the first answer of a device, which may still be starting; None if it does not answer in time.

        `ask` is a script that requests the answer, and returns None without one. Until the first answer, silence is no
        fault.
        """
        while (answer := (yield from ask())) is None and (waited := self.now - self.started) <= BOOT_S:
            if waited > BOOT_WORD_S:
                self.waits = f"{who} has not answered for {waited:.0f} s; it may be starting (at most {BOOT_S:.0f} s)"
            yield 0.02
        self.waits = ""
        return answer

    def stopped(self, stopping: Callable[[], Collection[int]]) -> Script:
        """Wait until every axis has confirmed its stop: until then a repeated stop could end a new motion."""
        give_up = self.now + STOP_TIMEOUT_S
        while moving := stopping():
            if self.now > give_up:
                raise StartupError(f"{self.name(min(moving))} has not confirmed a stop for {STOP_TIMEOUT_S:.0f} s")
            yield 0.02

    def settle(self, slack: float = 0.0) -> Script:
        """Wait for confirmed positions of all homed stages; mark a stage outside its travel as not homed.

        `slack`: distance beyond the travel that still counts as inside [counts].
        """
        give_up = self.now + SETTLE_TIMEOUT_S
        while moving := [i for i, homed in enumerate(self.homed) if homed and not self.estimates[i].known]:
            if self.now > give_up:
                raise StartupError(f"{self.name(moving[0])} does not stop: its position changes")
            yield 0.02
        for i, setup in enumerate(self.setups):
            if self.homed[i] and not setup.minimum - slack <= self.count(i) <= setup.maximum + slack:
                self.homed[i] = False  # another program has homed the stage and set another position

    def home_at_rest(self, steps: "HomingSteps", stopping: Callable[[], Collection[int]]) -> Script:
        """Home all stages after their stop, and wait for their positions; `stopping` returns the axes that stop."""
        yield from self.stopped(stopping)
        yield from self.home(steps)
        yield from self.settle()

    def home(self, steps: "HomingSteps") -> Script:
        """Home the translations first, then one rotation after the other."""
        order = sorted(range(len(self.setups)), key=lambda i: self.setups[i].joint.motion != "translation")
        known = [self.count(i) if self.homed[i] and self.estimates[i].known else None for i in order]
        self.homing = Homing([homing_step(self.setups[i], count) for i, count in zip(order, known, strict=True)])
        for i in order:
            self.homed[i] = False
            yield from steps.mark(i, finished=False)
        for number, i in enumerate(order):
            self.homing.start(number, self.now)
            yield from self._home_one(i, steps)

    def _home_one(self, i: int, steps: "HomingSteps") -> Script:
        """Home one stage; a rotation that began below its zero has found its sensor one turn too low, and turns back.

        A rotation passes its home sensor once per turn while it moves down. If it started within half a turn of its
        zero and moved more than half a turn to the sensor, it started below zero.
        """
        setup, estimate = self.setups[i], self.estimates[i]
        estimate.forget(adrift=True)
        reach = max((setup.maximum - setup.minimum) * setup.joint.microstep, 2.0 * math.pi) / setup.home_speed
        moved = yield from steps.seek(i, self.now + 2.0 * reach + HOMING_SLACK_S)
        if setup.joint.motion == "rotation" and moved > math.pi:
            seconds = 2.0 * math.pi / setup.home_speed
            yield from steps.turn_back(i, self.now + 2.0 * seconds + HOMING_SLACK_S)
        yield from steps.mark(i, finished=True)
        estimate.forget()
        self.homed[i] = True
        self.home_again.discard(i)


class HomingSteps(Protocol):
    """Steps of the homing of one protocol."""

    def mark(self, i: int, *, finished: bool) -> Script:
        """Mark an axis as homed, or not; the mark outlasts this process and a loss of power of the axis.

        All marks are removed before the first homing motion. So if the homing is interrupted, a later session does not
        count an axis as homed that has not finished its own homing.
        """
        ...

    def seek(self, i: int, give_up: float) -> Value[float]:
        """Move an axis to its home sensor, and return the distance [rad or m]; raise an error at `give_up` [s]."""
        ...

    def turn_back(self, i: int, give_up: float) -> Script:
        """Turn a rotation up by one turn, and count zero there; raise an error at the time `give_up` [s]."""
        ...
