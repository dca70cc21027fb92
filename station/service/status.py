"""Everything about a running station at one look."""

import threading
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from core.robot.robot import Array
from station.control.causes import Causes
from station.control.clock import StationClock
from station.control.messages import DeviceStatus
from station.control.ring import HEARTBEAT, PHASE, PROGRESS, RUN, STATE, STUCK, Ring, Timing
from station.control.states import LATCHED, State
from station.control.task import Phase
from station.control.telemetry import Channels
from station.service.standing import standing
from station.service.start import Run

#: Telemetry older than this is shown as stale [s].
STALE = 0.5
STUCK_TEXT = "the simulated robot cannot follow its stages under its load and stays where it is: take the load off"
#: States that are the station process's own word: a dead control process cannot say them.
OWN_WORD = (State.OFF, State.FAULT)


class Status(NamedTuple):
    """One look says everything."""

    state: State
    cause: str  #: why it is HOLD, STOPPED or FAULT
    run: Run | None  #: the run that is on, or the last one
    recording: bool  #: a run is being recorded, or its recording is being finished
    phase: Phase
    progress: float  #: part of the motion that is done
    age: float  #: since the last tick [s]
    timing: Timing
    values: Mapping[str, Array]  #: newest telemetry by group; empty until there is some
    devices: tuple[DeviceStatus, ...]  #: as reported last; empty before
    warnings: tuple[str, ...]  #: of this machine, this robot and the run that is on
    reserved: str  #: why nobody but a procedure may move anything; empty when everybody may
    standing: frozenset[str] = frozenset()  #: groups of `values` that are old


class StateMonitor:
    """What the control process has said of itself, and what telemetry shows; any thread may look."""

    def __init__(self, ring: Ring, channels: Channels, clock: StationClock) -> None:
        self._ring, self._channels, self._clock = ring, channels, clock
        self._lock = threading.Lock()
        self._said, self._cause = State.OFF, ""
        self._entered: Counter[State] = Counter()
        self._devices: tuple[DeviceStatus, ...] = ()
        self._refused: tuple[str, ...] = ()

    @property
    def state(self) -> State:
        """The present one."""
        with self._lock:
            return self._said if self._said in OWN_WORD else State(int(self._ring.counters[STATE]))

    @property
    def said(self) -> State:
        """What the control process has told last; `state` may be a moment newer."""
        return self._said

    @property
    def cause(self) -> str:
        """Of the state that was told last."""
        return self._cause

    def entered(self, state: State) -> int:
        """How often that state has been entered."""
        return self._entered[state]

    def hear(self, state: State, cause: str) -> bool:
        """The state that is told; whether it is another one."""
        with self._lock:
            changed = self._said is not state
            self._said, self._cause = state, cause
            self._entered[state] += changed
        return changed

    def fault(self, how: str, stopped: str) -> str:
        """The control process has ended: the cause, which begins with the one that was told before it."""
        with self._lock:
            before = Causes().add(self._cause if self._said in LATCHED else "")
            # A process that ends after a fault of its own has said why.
            why = str(before if self._said is State.FAULT else before.add(how))
            self._said = State.FAULT
            self._cause = "; ".join(part for part in (why, stopped, "reset to start it anew") if part)
            self._entered[State.FAULT] += 1
            return self._cause

    def forget(self) -> None:
        """The control process is to be started anew."""
        with self._lock:
            self._said, self._cause = State.OFF, ""

    def hear_devices(self, devices: tuple[DeviceStatus, ...]) -> None:
        """How they are doing."""
        self._devices = devices

    def hear_refused(self, warnings: tuple[str, ...]) -> None:
        """What the system has refused the control process."""
        self._refused = warnings

    def troubles(self) -> str:
        """Of the devices, in words; else the state's name."""
        return "; ".join(device.text for device in self._devices if device.text) or self._said.name

    def look(self, run: Run | None, recording: bool, reserved: str, warnings: tuple[str, ...]) -> Status:
        """Everything; the arguments are what others know."""
        ring, state = self._ring, self.state
        row = ring.latest()
        counters, numbers = ring.counters, ring.numbers
        ours = int(counters[RUN]) == (0 if run is None else run.number)
        stuck = (STUCK_TEXT,) if counters[STUCK] else ()
        told = run.start.warnings if run is not None and ours and state is State.RUNNING else ()
        return Status(
            state=state,
            cause=self._cause if state in LATCHED else "",
            run=run,
            recording=recording,
            phase=Phase(int(counters[PHASE])) if ours else Phase.NONE,
            progress=float(numbers[PROGRESS]),
            age=self._clock.now() - float(numbers[HEARTBEAT]),
            timing=ring.timing(),
            values={} if row is None else {name: self._channels.of(row, name) for name in self._channels.groups},
            devices=self._devices,
            warnings=(*warnings, *self._refused, *stuck, *told),
            reserved=reserved,
            standing=frozenset() if row is None else standing(self._channels, row),
        )
