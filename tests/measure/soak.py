"""Soak test: a complete station with random actions of a simulated operator and random faults of the devices.

`python -m tests.measure.soak [--minutes 10] [--seed 0]`

The processes are those of live operation: virtual lab, control process and recorder. The operator starts runs, stops,
jogs, tares, homes and resets, and one device after the other fails. The test detects processes that end, memory that
grows, unexplained HOLD and FAULT states, and faults that are not reported exactly once.
"""

import argparse
import json
import math
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError
from station.config.loads import ConstantLoad, NoLoad
from station.config.motions import CircleMotion, HoldMotion, SinusoidMotion
from station.control.commands import Jog, Tare
from station.control.realtime import TOO_BUSY
from station.control.states import State
from station.lab.faults import FaultKind, LabFault
from station.service.commands import ApplyLoad, ClearFaults, Home, InjectFaults, Start
from station.service.station_file import load_station
from station.service.supervisor import Supervisor

_PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


def resident_bytes(pid: int) -> float | None:
    """Return the resident memory of a process [bytes]; None if it has ended or the system does not report it."""
    try:
        return float(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * _PAGE
    except (OSError, IndexError, ValueError):
        return None


class Growth:
    """Memory growth of one process."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._sizes: list[float] = []

    def add(self, time: float, size: float) -> None:
        """Add the resident memory `size` [bytes] that was measured at `time` [s]."""
        self._times.append(time)
        self._sizes.append(size)

    @property
    def size(self) -> float:
        """Latest resident memory [bytes]."""
        return self._sizes[-1] if self._sizes else 0.0

    @property
    def slope(self) -> float:
        """Slope of a line fitted to the second half of the sizes, which has no initial allocations [bytes/s]."""
        half = len(self._times) // 2
        if len(self._times) - half < 3:
            return 0.0
        return float(np.polyfit(self._times[half:], self._sizes[half:], 1)[0])


#: Longest time for the start of the station, which may compile all code on a busy computer [s].
START_TIMEOUT_S = 300.0
#: Longest time until the station reports a fault, and until the station is READY after repair and reset [s].
FAULT_REPORT_TIMEOUT_S, RECOVERY_TIMEOUT_S = 3.0, 400.0
#: Growth of a process's memory that is not yet a failure [bytes], and largest slope that is no leak [bytes/s].
MEMORY_TOLERANCE_BYTES, LEAK_BYTES_PER_S = 8e6, 2e3
RESTING_STATES = (State.HOLD, State.STOPPED, State.FAULT)


class FaultChance(NamedTuple):
    """Fault that the test may inject, and the state that this fault must cause."""

    kind: FaultKind
    device: str
    leads_to: State


FAULT_CHANCES = (
    *(FaultChance(kind, "tracker", State.HOLD) for kind in ("mute", "lose_tool", "disconnect", "unplug")),
    *(
        FaultChance(kind, tube, State.HOLD)
        for tube in ("inner", "outer")
        for kind in ("mute", "saturate", "bad_status")
    ),
    FaultChance("freeze", "sensors", State.HOLD),
    FaultChance("mute", "stages", State.FAULT),
    FaultChance("disconnect", "stages", State.FAULT),
    FaultChance("disconnect", "inner_translation", State.FAULT),
)


@dataclass
class SoakResult:
    """Result of a soak test."""

    seed: int
    seconds: float = 0.0
    actions: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)  #: detected failures
    machine: int = 0  #: runs that were delayed by the computer
    growth: dict[str, Growth] = field(default_factory=dict)

    def summary(self) -> dict[str, Any]:
        """Return the result as a JSON object; its list `wrong` has all failures, including memory leaks."""
        leaks = [
            f"memory of {name} grows by {slope / 1e3:.1f} kB/s"
            for name, growth in self.growth.items()
            if (slope := growth.slope) > LEAK_BYTES_PER_S and slope * self.seconds > MEMORY_TOLERANCE_BYTES
        ]
        wrong = [*self.wrong, *leaks]
        return {
            "seed": self.seed,
            "seconds": round(self.seconds, 1),
            "passed": not wrong,
            "wrong": wrong,
            "actions": dict(self.actions),
            "refused": self.refused,
            "faults": dict(self.faults),
            "held_up_by_this_computer": self.machine,
            "memory_mb": {name: round(growth.size / 1e6, 1) for name, growth in self.growth.items()},
            "growth_mb_per_hour": {name: round(growth.slope * 3.6e-3, 2) for name, growth in self.growth.items()},
        }


def soak(seconds: float, seed: int, folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Run a soak test for `seconds`, with pseudo-terminals as serial lines and data in `folder`; return the summary.

    Raises:
        CtrError: the station does not start.
    """
    terminals = folder / "lines" if hasattr(os, "openpty") else None
    if terminals is not None:
        terminals.mkdir()
    bench = replace(load_station(None).bench(), terminals=terminals)
    supervisor = Supervisor(bench, folder / "runs")
    try:
        supervisor.open()
        supervisor.wait_ready(START_TIMEOUT_S)
        soaked = _Soak(supervisor, seed)
        soaked.run(seconds, progress)
    finally:
        supervisor.close()
    return soaked.result.summary()


class _Soak:
    def __init__(self, supervisor: Supervisor, seed: int) -> None:
        self.result = SoakResult(seed)
        self._supervisor = supervisor
        self._chance = random.Random(seed)
        self._start_time = time.monotonic()
        self._pids = supervisor.pids()
        self._last_state = State.READY
        self._last_check = 0.0

    def run(self, seconds: float, progress: Callable[[float], None]) -> None:
        self._wait(lambda state: state is State.READY, 60.0)
        while (passed := time.monotonic() - self._start_time) < seconds:
            progress(min(1.0, passed / seconds))
            self._explain()
            self._one()
            self._check_processes()
        self._try("stop", self._supervisor.stop)
        self.result.seconds = time.monotonic() - self._start_time
        progress(1.0)

    def _one(self) -> None:
        """Carry out one random action of the operator, or inject a fault; the station may refuse the action."""
        state, chance = self._supervisor.status().state, self._chance
        if state in (*RESTING_STATES, State.CONNECTED):
            self._recover()
        elif state is State.RUNNING and chance.random() < 0.3:
            self._fail(chance.choices(FAULT_CHANCES, [1 if c.leads_to is State.FAULT else 3 for c in FAULT_CHANCES])[0])
        else:
            action = chance.choice(("start", "start", "stop", "jog", "tare", "reset", "pull", "wait", "wait"))
            getattr(self, f"_{action}")()
        self._pause(chance.uniform(0.05, 1.0))

    # Actions of the operator

    def _start(self) -> None:
        motion = self._chance.choice((
            CircleMotion(radius=0.005, period=10.0), HoldMotion(),
            SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.005, frequency=0.1),
            CircleMotion(radius=0.008, period=15.0),
        ))  # fmt: skip
        duration = self._chance.uniform(1.0, 15.0)
        load = self._chance.choice((NoLoad(), ConstantLoad(magnitude=0.1)))
        self._try("start", lambda: self._supervisor.send(Start(trajectory=motion, load=load, duration=duration)))

    def _stop(self) -> None:
        self._try("stop", self._supervisor.stop)

    def _jog(self) -> None:
        velocity = [self._chance.uniform(-0.003, 0.003) for _ in range(3)]
        for _ in range(self._chance.randint(1, 8)):
            self._try("jog", lambda: self._supervisor.send(Jog(space="tip", velocity=tuple(velocity))))
            time.sleep(0.1)

    def _tare(self) -> None:
        self._try("tare", lambda: self._supervisor.send(Tare()))

    def _reset(self) -> None:
        self._try("reset", self._supervisor.reset)

    def _pull(self) -> None:
        size = self._chance.uniform(0.0, 0.2)
        self._try("pull", lambda: self._supervisor.send(ApplyLoad(load=ConstantLoad(magnitude=size))))

    def _wait(self, reached: Callable[[State], bool] | None = None, timeout: float = 0.0) -> bool:
        """Wait up to `timeout` [s] until `reached` returns True for the state; without arguments pause up to 2 s."""
        if reached is None:
            self._pause(self._chance.uniform(0.1, 2.0))
            return True
        deadline = time.monotonic() + timeout
        while not reached(self._supervisor.status().state):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    def _try(self, name: str, action: Callable[[], Any]) -> None:
        self.result.actions[name] += 1
        try:
            action()
        except CtrError:
            self.result.refused += 1  # the station refused the action in its present state

    # Faults

    def _fail(self, fault: FaultChance) -> None:
        """Inject a fault, check that the station reports the fault exactly once, and repair the device."""
        name = f"{fault.kind} {fault.device}"
        before = self._supervisor.entered(fault.leads_to)
        if self._supervisor.status().state is not State.RUNNING:
            return
        self._supervisor.send(InjectFaults(faults=(LabFault(kind=fault.kind, device=fault.device),)))
        self.result.faults[name] += 1
        shown = self._wait(lambda state: state in RESTING_STATES, FAULT_REPORT_TIMEOUT_S)
        status = self._supervisor.status()
        self._pause(0.5)
        times = self._supervisor.entered(fault.leads_to) - before
        self._supervisor.send(ClearFaults())
        if not shown:
            if self._supervisor.status().state is not State.READY:  # READY: the run had ended before the fault
                self.result.wrong.append(f"{name}: not reported within {FAULT_REPORT_TIMEOUT_S:g} s")
        elif self._is_machine(status.cause):
            self.result.machine += 1
        elif status.state is not fault.leads_to or times != 1:
            self.result.wrong.append(
                f"{name}: {times} times {fault.leads_to.name}, now {status.state.name}: {status.cause}"
            )
        self._last_state = self._supervisor.status().state

    def _recover(self) -> None:
        """Reset the station, and home its stages if necessary, until the station is READY."""
        deadline = time.monotonic() + RECOVERY_TIMEOUT_S
        while (state := self._supervisor.status().state) is not State.READY:
            if time.monotonic() > deadline:
                self.result.wrong.append(
                    f"not READY {RECOVERY_TIMEOUT_S:g} s after a reset but {state.name}: {self._what_is_wrong()}"
                )
                return
            if state in RESTING_STATES:
                self._try("reset", self._supervisor.reset)
            elif state is State.CONNECTED:
                self._try("home", lambda: self._supervisor.send(Home(way_is_clear=True, then_working_pose=False)))
            time.sleep(0.2)

    def _what_is_wrong(self) -> str:
        """Return a text with the cause of the state and the reported faults of the devices."""
        status = self._supervisor.status()
        texts = [status.cause, *(f"{device.name} {device.condition}: {device.text}" for device in status.devices)]
        return "; ".join(text for text in texts if text)

    def _explain(self) -> None:
        """Count a HOLD or FAULT that no injected fault caused as a failure, unless a late computer is its cause."""
        status = self._supervisor.status()
        if status.state is self._last_state:
            return
        self._last_state = status.state
        if status.state in (State.HOLD, State.FAULT):
            if self._is_machine(status.cause):
                self.result.machine += 1
            else:
                self.result.wrong.append(f"unexplained {status.state.name}: {status.cause or 'no cause given'}")

    def _is_machine(self, cause: str) -> bool:
        """Return whether the computer, not the station, is responsible for a cause."""
        return TOO_BUSY in cause

    def _pause(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            time.sleep(min(0.1, left))

    def _check_processes(self) -> None:
        now = time.monotonic()
        if now - self._last_check < 0.5:
            return
        self._last_check = now
        pids = self._supervisor.pids()
        for name in [name for name, pid in self._pids.items() if pids.get(name) != pid]:
            self.result.wrong.append(f"process {name} ({self._pids[name]}) has ended")
        self._pids = pids
        for name, pid in pids.items():
            size = resident_bytes(pid)
            if size is not None and math.isfinite(size):
                self.result.growth.setdefault(name, Growth()).add(now, size)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description="Operate a station at random, with faults, and print what is wrong.")
    options.add_argument("--minutes", type=float, default=10.0)
    options.add_argument("--seed", type=int, default=0)
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory(prefix="ctr-soak-") as directory:
        summary = soak(60.0 * chosen.minutes, chosen.seed, Path(directory), lambda _: None)
    print(json.dumps(summary, indent=2))  # noqa: T201
    sys.exit(not summary["passed"])
