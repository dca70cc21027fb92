"""A whole bench in virtual time for the tests of faults: plant, serial lines, drivers and the control loop."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.config.controllers import PERIOD_S
from station.config.motions import CircleMotion, Orders
from station.control.loop import ControlLoop
from station.control.monitors import Margins
from station.control.states import State
from station.control.task import MotionTask, Phase, StreamRequest
from station.devices.cameras import CalibratedView
from station.experiments.experiment import Case
from station.lab.faults import LabFault
from station.lab.simulated_bench import SimulatedBench
from station.lab.virtual_bench import virtual_bench
from tests.harness.cases import a_case

CIRCLE = CircleMotion(radius=0.010, period=8.0)
AXES = ("outer_rotation", "inner_rotation", "inner_translation")


def usual_case() -> Case:
    """Return the case fig10 with feed-forward and observer on the default virtual lab."""
    return a_case("fig10", "feedforward")


class VirtualStation:
    """A control loop on devices that are simulated at wire level; the test ticks it."""

    def __init__(
        self,
        case: Case,
        margins: Margins | None = None,
        seed: int = 0,
        views: Mapping[str, CalibratedView] = MappingProxyType({}),
    ) -> None:
        """Connect the devices of a case; `views` are the calibrated lenses and poses of its cameras."""
        self.case = case
        lab, self.devices = virtual_bench(case.robot, case.lab, seed, case.start, views=views)
        assert isinstance(lab, SimulatedBench)
        self.lab = lab
        self._margins = margins
        self.loop = ControlLoop(case.controller, self.devices, margins)
        self.rows: list[Array] = []
        self.now = -PERIOD_S
        #: Function that returns the latest streamed setpoint at a time [s].
        self.request: Callable[[float], StreamRequest | None] = lambda _: None
        self.loop.connect(0.0)

    def restart_loop(self) -> ControlLoop:
        """Replace the control loop by another one, which connects the devices, as a new control process does."""
        self.loop = ControlLoop(self.case.controller, self.devices, self._margins)
        self.loop.connect(self.now)
        return self.loop

    @property
    def state(self) -> State:
        return self.loop.state

    @property
    def places(self) -> Array:
        """True joint positions (n,) [rad or m]."""
        return self.lab.positions

    def fail(self, kind: str, device: str, **more: Any) -> None:
        """Start a fault of a device now."""
        self.lab.inject([LabFault.model_validate({"kind": kind, "device": device, **more})], self.now)

    def mend(self) -> None:
        self.lab.inject([], self.now)

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.now = round(self.now + PERIOD_S, 9)
            row = self.loop.tick(self.now, self.lab.advance(self.now), self.request(self.now))
            if row is not None:
                assert np.isfinite(row).all()
                self.rows.append(row)

    def seconds(self, time: float) -> None:
        self.tick(round(time / PERIOD_S))

    def until(self, holds: Callable[[], bool], most: float = 10.0) -> float:
        """Tick until `holds()` is true; return the elapsed virtual time [s]."""
        begin = self.now
        while not holds():
            assert self.now - begin < most, (self.state, self.loop.cause, self.loop.phase)
            self.tick()
        return self.now - begin

    def becomes(self, state: State, most: float = 10.0) -> float:
        return self.until(lambda: self.state is state, most)

    def ready(self) -> "VirtualStation":
        self.becomes(State.READY)
        return self

    def moving(self, motion: Any = CIRCLE, duration: float = 60.0, since: float = 1.0) -> "VirtualStation":
        """Bring the station to READY, start a motion and tick until it is under way."""
        self.ready()
        self.loop.start(MotionTask(self.case.controller, Orders(motion, self.case.robot.robot()), duration))
        self.until(lambda: self.loop.phase is Phase.MOVING)
        self.seconds(since)
        assert self.state is State.RUNNING
        return self

    def rests(self, joints: tuple[int, ...] = (0, 1, 2)) -> bool:
        """Return whether the true positions of these joints do not change for the next 0.1 s."""
        before = self.places
        self.seconds(0.1)
        return bool((self.places == before)[list(joints)].all())

    def of(self, group: str, rows: list[Array] | None = None) -> Array:
        return self.loop.channels.of(np.array(self.rows if rows is None else rows), group)
