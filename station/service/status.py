"""Status of a running station: its state, run, devices, timing and newest telemetry."""

import threading
from collections import Counter, deque
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.control.clock import StationClock
from station.control.messages import DeviceStatus
from station.control.ring import HEARTBEAT, PHASE, PREPARED_LATE, PROGRESS, RUN, STATE, STUCK, Ring, Timing
from station.control.states import LATCHED, State, StopReasons
from station.control.task import Phase
from station.control.telemetry import Channels, stale_groups
from station.devices.interfaces import with_details
from station.recording.run_outcome import limited_parts, saturation_warning
from station.service.runs import RunRequest

#: Age above which telemetry is shown as stale [s].
STALE_AFTER_S = 0.5
#: Number of status samples from which the share of time with joints at their limits is computed.
SATURATION_SAMPLES = 200
#: Fewest samples for a warning about joints at their limits.
MIN_SATURATION_SAMPLES = 20
STUCK_TEXT = "the simulated robot cannot follow its stages under its load and stays where it is: take the load off"
PREPARED_LATE_TEXT = (
    "{} compiled functions were prepared while the control loop was running, which delayed its ticks: repeat the"
    " motion, and report this defect with the station's log"
)
#: States that the station process itself sets: a dead control process cannot report them.
STATION_STATES = (State.OFF, State.FAULT)


class StationStatus(NamedTuple):
    """Status of a station at one moment."""

    state: State  #: present state
    cause: str  #: human-readable cause of HOLD, STOPPED or FAULT
    run: RunRequest | None  #: the present run, or the last one
    recording: bool  #: whether a run is being recorded, or its recording is being finished
    phase: Phase  #: phase of the run
    progress: float  #: completed part of the motion, 0 ... 1
    age: float  #: time since the last tick [s]; 0 before the first tick of a station that has just started
    timing: Timing  #: timing statistics of the control loop
    values: Mapping[str, Array]  #: newest telemetry by group; empty before the first row
    devices: tuple[DeviceStatus, ...]  #: devices as last reported; empty before the first report
    warnings: tuple[str, ...]  #: warnings about this computer, this robot and the present run
    reserved: str  #: reason why only a calibration procedure may move the robot; empty if it is not reserved
    stale_groups: frozenset[str] = frozenset()  #: groups of `values` that are stale
    details: str = ""  #: addresses and raw values that belong to the cause


class StateMonitor:
    """Monitor of the state that the control process reports and telemetry shows; its methods are thread-safe."""

    def __init__(self, ring: Ring, channels: Channels, clock: StationClock) -> None:
        self._ring, self._channels, self._clock = ring, channels, clock
        self._lock = threading.RLock()
        self.reported = State.OFF  #: state that the control process has reported last; `state` may be slightly newer
        self.cause = self.details = ""  #: cause of the state that was reported last, and its addresses and values
        self.contact = ""  #: why the tip may have contact while nothing moves; empty without contact
        self.entered: Counter[State] = Counter()  #: how often the station has entered each state
        self.devices: tuple[DeviceStatus, ...] = ()  #: devices as last reported; empty before the first report
        self.refusals: tuple[str, ...] = ()  #: warnings about real-time settings that the system has refused
        self._starting = False  # whether the first control process has been started and has reported nothing yet
        self._end = ""  # text about the end of the control process, with the earlier causes
        self._at_bound: deque[tuple[float, Array]] = deque(maxlen=SATURATION_SAMPLES)

    @property
    def state(self) -> State:
        """Present state of the station."""
        with self._lock:
            ours = self.reported in STATION_STATES and not self._starting
            return self.reported if ours else State(int(self._ring.counters[STATE]))

    @property
    def run_number(self) -> int:
        """Number of the run that the control process executes or executed last; 0 before the first run."""
        return int(self._ring.counters[RUN])

    @property
    def full_cause(self) -> str:
        """Cause of the state that was reported last, with its details, for the terminal, the log and recordings."""
        return with_details(self.cause, self.details)

    def begin(self) -> None:
        """Show CONNECTING until the first report; call this before the first control process is started.

        The control process connects the devices as soon as its code is compiled, which may take several minutes.
        """
        with self._lock:
            self._ring.counters[STATE] = State.CONNECTING
            self._starting = True

    def set_reported(self, state: State, cause: str, details: str = "") -> bool:
        """Store a reported state; return whether it differs from the previous one."""
        with self._lock:
            self._starting = False
            changed = self.reported is not state
            self.reported, self.cause, self.details = state, cause, details
            self.entered[state] += changed
        return changed

    def fault(self, how: str, stages: str, details: str = "") -> str:
        """Set FAULT after the end of the control process; return the cause, which starts with the earlier causes.

        Args:
            how: how the process ended.
            stages: text about the stages until `set_stop_outcome` is called; empty if no process has driven the stages.
            details: values that belong to `how`.
        """
        with self._lock:
            self._starting = False
            before = StopReasons().add(self.cause if self.reported in LATCHED else "")
            # A process that ends after its own fault has already reported the cause.
            known = self.reported is State.FAULT
            self._end = str(before if known else before.add(how))
            self.details = self.details if known else "; then ".join(filter(None, (self.details, details)))
            self.reported = State.FAULT
            self.cause = "; ".join(filter(None, (self._end, stages)))
            self.entered[State.FAULT] += 1
            return self.cause

    def set_stop_outcome(self, text: str) -> None:
        """Store the outcome of stopping the stages after the control process has ended."""
        with self._lock:
            if self._end:
                self.cause = f"{self._end}; {text}"

    def forget(self) -> None:
        """Clear the reported state before the control process is restarted."""
        with self._lock:
            self._starting = False
            self.reported = State.OFF
            self.cause = self.details = self._end = ""

    def device_problems(self) -> str:
        """Return the messages of all devices with a problem, or the name of the state if there are none."""
        return "; ".join(device.text for device in self.devices if device.text) or self.reported.name

    def snapshot(
        self, run: RunRequest | None, recording: bool, reserved: str, warnings: tuple[str, ...]
    ) -> StationStatus:
        """Return the status of the station; the arguments are the parts that this monitor does not store."""
        ring = self._ring
        state, cause, details = self._state_and_cause()
        row = ring.latest()
        counters, numbers = ring.counters, ring.numbers
        starting = self._starting  # read first: after the first report there is a heartbeat
        ticked = float(numbers[HEARTBEAT])
        ours = int(counters[RUN]) == (0 if run is None else run.number)
        stuck = (STUCK_TEXT,) if counters[STUCK] else ()
        late = (PREPARED_LATE_TEXT.format(counters[PREPARED_LATE]),) if counters[PREPARED_LATE] else ()
        values = {} if row is None else {name: self._channels.of(row, name) for name in self._channels.groups}
        saturated = self._saturation(values)
        contact = (self.contact,) if self.contact and state is State.READY else ()
        run_warnings = run.start.warnings if run is not None and ours and state is State.RUNNING else ()
        return StationStatus(
            state=state,
            cause=cause,
            run=run,
            recording=recording,
            phase=Phase(int(counters[PHASE])) if ours else Phase.NONE,
            progress=float(numbers[PROGRESS]),
            age=0.0 if starting and not ticked else self._clock.now() - ticked,
            timing=ring.timing(),
            values=values,
            devices=self.devices,
            warnings=(*warnings, *self.refusals, *contact, *stuck, *late, *run_warnings, *saturated),
            reserved=reserved,
            stale_groups=frozenset() if row is None else stale_groups(self._channels, row),
            details=details,
        )

    def _state_and_cause(self) -> tuple[State, str, str]:
        """Return the present state, its cause and details; cause and details arrive shortly after the state."""
        with self._lock:
            state = self.state
            known = state in LATCHED and state is self.reported
            return state, self.cause if known else "", self.details if known else ""

    def _saturation(self, values: Mapping[str, Array]) -> tuple[str, ...]:
        """Return a warning while joints are at their limits because the tip follows a target."""
        with self._lock:
            if not values or not values["target_followed"].any():
                self._at_bound.clear()
                return ()
            time = float(values["time"].ravel()[0])
            if not self._at_bound or time > self._at_bound[-1][0]:
                self._at_bound.append((time, values["at_bound"].copy()))
            samples = np.array([at_bound for _, at_bound in self._at_bound])
        names = [one.name.removeprefix("at_bound.") for one in self._channels.all if one.name.startswith("at_bound.")]
        warning = saturation_warning(limited_parts(names, samples, np.ones(len(samples))))
        return (warning,) if warning and len(samples) >= MIN_SATURATION_SAMPLES else ()
