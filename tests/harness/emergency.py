"""A process that stops simulated stages in virtual time after their control process has died."""

import sys

import numpy as np
import pytest

from station.config.robots import RobotFile
from station.control.clock import REAL_TIME_CLOCK
from tests.harness.stages_bench import KINDS, StagesBench

STEP_S = 0.0005  #: resolution of all times [s]


class StoppingProcess:
    """The process: its clock, during whose waits the stages run, and its end of their line."""

    def __init__(self, bench: StagesBench) -> None:
        self._bench, self.last_motion, self.first_bytes = bench, bench.now, 0.0
        self.bytes = [0, 0]  #: sent by the stopping process, and received

    def now(self) -> float:
        return self._bench.now

    def sleep(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / STEP_S))):
            before = self._bench.positions
            self._bench.let_pass(STEP_S)
            if (np.abs(self._bench.positions - before) > 1e-9).any():
                self.last_motion = self._bench.now

    def open(self, *_: object) -> "StoppingProcess":
        """Open the port, whose bytes in transit are lost."""
        self._bench.host.reopen()
        return self

    def read(self) -> bytes:
        data = self._bench.host.read()
        self.bytes[1] += len(data)
        return data

    def write(self, data: bytes) -> None:
        self.first_bytes = self.first_bytes or (self.now() if data else 0.0)
        self.bytes[0] += len(data)
        self._bench.host.write(data)

    def close(self) -> None:
        """The port stays, for the driver that comes later."""

    def stop(self, robot: RobotFile, kind: str) -> str:
        """Call the emergency stop of the driver, and return its result; raises NotStopped."""
        options = dict(KINDS[kind].table("port", REAL_TIME_CLOCK))
        del options["driver"]
        with pytest.MonkeyPatch.context() as patch:
            for module in [module for name, module in sys.modules.items() if name.startswith("station.devices")]:
                if hasattr(module, "SerialLink"):
                    patch.setattr(module, "SerialLink", self.open)
            return KINDS[kind].driver.emergency_stop(options, robot)(self)


def next_session(bench: StagesBench, kind: str) -> StagesBench:
    """Return the bench with a new driver, which another process has connected."""
    bench.host.reopen()
    bench.stages = KINDS[kind].on(bench.host, bench.robot)
    return bench.connect()
