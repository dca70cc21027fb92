"""Processes of a running station: start, watch and restart the lab and the control process."""

import os
import threading
import traceback
from collections.abc import Callable, Collection, Sequence

from station.config.loads import Load, NoLoad, Obstacle
from station.config.strict import ConfigError
from station.control.child_process import is_alive
from station.control.guard import Guard, Rank
from station.control.messages import StateNotice
from station.control.process import ring_width
from station.control.realtime import Life, life, load, request_fifo, too_busy
from station.control.ring import HEARTBEAT, LAB_HEARTBEAT, STATE, STATION_HEARTBEAT, WATCHERS, Ring
from station.control.sleep import TURN_OFF_SLEEP, Awake
from station.control.states import MOVING, RefusedError, State
from station.devices.config import BenchFile
from station.lab.faults import LabFault
from station.lab.process import LabBench, LabError, LabHost
from station.service.control_host import WATCHER_PRIORITY, ControlHost, ControlReport, ExitReport
from station.service.fallback_stop import NO_STAGES, StopOutcome
from station.service.runs import StartRequest
from station.service.station_file import Rig
from station.threads import limit_to_one_thread


class Backend:
    """Backend that provides the devices: the process of a virtual lab, which applies loads and faults, or real devices.

    Its methods are thread-safe. Real devices exist independently of the station: they need no process, and only the
    operator applies loads to them.
    """

    def __init__(self, bench: Rig, ring: Ring) -> None:
        self._bench, self._ring = bench, ring
        self._lock = threading.Lock()
        self._devices = bench.devices  # None: not known before the lab has started
        self._motion_start: float | None = None
        self._load: Load = NoLoad()  # load that was applied last
        self._applied: StartRequest | None = None  # start request whose load and faults are applied now
        self._host: LabHost | None = None  # process of the lab; None with real devices

    def open(self) -> None:
        """Start the lab, or replace a lab that has died."""
        bench = self._bench
        if bench.devices is not None:
            return
        if self._host is not None:
            self._host.close()
        shape = any(camera.simulated for camera in bench.cameras.values())
        lab = LabBench(bench.robot, bench.lab, bench.seed, bench.park, bench.fifo, bench.terminals, bench.clock, shape)
        # Other threads use the old host until the new one is assigned.
        self._load = NoLoad()
        self._host, self._devices = LabHost(lab, self._ring.name, ring_width(bench.robot)), None

    @property
    def removed_load(self) -> bool:
        """Whether the virtual lab applies no load now, so that the operator need not take one off."""
        return self._bench.devices is None and isinstance(self._load, NoLoad)

    @property
    def alive(self) -> bool:
        """Whether the lab's process runs; always true for real devices."""
        return self._bench.devices is not None or (self._host is not None and self._host.alive)

    @property
    def pid(self) -> int | None:
        """Process ID of the lab while it runs; None for real devices."""
        return self._host.pid if self._host is not None and self._host.alive else None

    def devices(self) -> BenchFile:
        """Return the devices that the control process has to open; wait for a lab that is starting.

        Raises:
            LabError: the lab did not start.
        """
        if self._devices is None:
            if self._host is None:
                raise LabError("the lab was not started")
            self._devices = self._host.devices()
        return self._devices

    def apply_load(self, load: Load) -> None:
        """Apply a load to the tip of the virtual lab's robot now; `NoLoad` also removes an obstacle."""
        self._apply(load, self._bench.clock.now())

    def _apply(self, load: Load, start: float) -> None:
        if self._host is not None:
            self._load = load
            self._host.apply_load(load, start)

    def inject(self, faults: Sequence[LabFault]) -> None:
        """Inject faults into the simulated devices from now on; an empty sequence clears all faults.

        Raises:
            ConfigError: the devices are real.
        """
        self.check(faults)
        if self._host is not None:
            self._host.inject(faults, self._bench.clock.now())

    def check(self, faults: Sequence[LabFault]) -> None:
        """Check that the faults can be injected into the devices of this station.

        Raises:
            ConfigError: the devices are real.
        """
        if faults and self._bench.devices is not None:
            raise ConfigError("faults can be injected into the virtual lab only; this station has real devices")

    def motion(self, start: StartRequest | None, motion_start: float | None) -> None:
        """Apply the load and faults of a run whose motion started at `motion_start`, by the station's clock [s].

        With `motion_start` None the motion has ended, so its load and faults are cleared. Only an obstacle remains, as
        a real one does, until another load replaces it or `apply_load` removes it.
        """
        with self._lock:
            if motion_start == self._motion_start:
                return
            # Clear the load and faults of the ended run; the next run may already have been requested.
            ended, self._applied = self._applied, None if motion_start is None else start
            self._motion_start = motion_start
        if self._host is None:
            return
        if ended is not None and ended.load is not None and not isinstance(self._load, Obstacle):
            self._apply(NoLoad(), 0.0)
        if ended is not None and ended.faults:
            self._host.inject((), 0.0)
        if motion_start is not None and start is not None:
            stays = isinstance(self._load, Obstacle) and isinstance(start.load, NoLoad)
            if start.load is not None and not stays:
                self._apply(start.load, motion_start)
            if start.faults:
                self._host.inject(start.faults, motion_start)

    def close(self) -> None:
        """End the lab's process; with real devices do nothing."""
        if self._host is not None:
            self._host.close()
            self._host = None


#: Time without a tick after which the control process counts as hung [s]; it is then killed and the stages are stopped.
HUNG_AFTER_S = 1.0
#: Time without a tick after which the control process counts as hung, until the station has been READY once [s]. It is
#: longer, because the first ticks of a new installation compile code.
FIRST_TICKS_TIMEOUT_S = 60.0
#: Longest time that a reset waits for the heartbeat of a process [s].
HEARTBEAT_TIMEOUT_S = 3.0
LAB_LABEL, CONTROL_LABEL, GUARD_LABEL = "the virtual lab", "the control process", "the guard"
#: Time for the guard to end [s]; after it the guard is killed.
GUARD_PATIENCE_S = 1.0
#: Time without a tick after which the system is asked whether the control process is suspended [s].
SUSPENDED_AFTER_S = 0.2
#: Interval between two checks by the watchdog [s].
POLL_INTERVAL_S = 0.02
#: Delay of a watchdog's check above which the station shows a warning [s], and duration of that warning [s].
LATE_WARNING_S, WARNING_DURATION_S = 0.5, 30.0


class ProcessSupervisor:
    """Owner of the lab's process and the control process, and their watchdog; its methods are thread-safe."""

    def __init__(
        self,
        bench: Rig,
        ring: Ring,
        on_report: Callable[[ControlReport], None],
        on_exit: Callable[[ExitReport], None],
        problem: Callable[[], str],
    ) -> None:
        """Prepare the processes, which `open` starts.

        Args:
            bench: rig that the processes control.
            ring: shared memory for telemetry.
            on_report: called with each report of the control process and with the outcome of stopping the stages.
            on_exit: called after an unexpected end of the control process.
            problem: polled by the watchdog; returns why a motion must end, or an empty text.
        """
        self.lab = Backend(bench, ring)
        self._bench, self._ring, self._clock = bench, ring, bench.clock
        self._on_report, self._on_exit, self._problem = on_report, on_exit, problem
        self._tick_timeout = FIRST_TICKS_TIMEOUT_S
        self._checked_at = self._late_at = 0.0  # times of the last check and of the last long delay [s]
        self._late = 0.0  # latest delay of the watchdog that caused a warning [s]
        self._guard: Guard | None = None
        self._awake: Awake | None = None  # keeper that prevents sleep of this computer
        self._parent = os.getppid()
        self._lost = dict.fromkeys(Rank, 0)  # process IDs of helpers that were found ended or suspended
        self.control: ControlHost | None = None  #: host of the present control process; None before `open`
        self._closing, self._changing = threading.Event(), threading.Lock()
        self._watchdog = threading.Thread(target=self._watch, name="watchdog")

    def open(self) -> None:
        """Start the processes and the watchdog; call this once."""
        limit_to_one_thread()
        self._awake = Awake(lid=self._bench.devices is not None)
        self._ring.counters[WATCHERS + Rank.STATION] = os.getpid()
        self._start_guard()
        self.lab.open()
        self._start_control()
        self._watchdog.start()

    def failed(self) -> tuple[str, ...]:
        """Return the labels of the processes that have died or hang; this may wait for a heartbeat."""
        control = self.control
        if control is None:
            return ()
        ring, clock = self._ring, self._clock
        lab_alive = self.lab.alive and (
            self.lab.pid is None or is_alive(ring, LAB_HEARTBEAT, clock, HEARTBEAT_TIMEOUT_S)
        )
        # After the end of a lab the control process has to be restarted, too, to find the devices of the new lab.
        patience = max(HEARTBEAT_TIMEOUT_S, self._tick_timeout)
        if lab_alive and control.alive and is_alive(ring, HEARTBEAT, clock, patience):
            return ()
        return (CONTROL_LABEL,) if lab_alive else (LAB_LABEL, CONTROL_LABEL)

    def pids(self) -> dict[str, int]:
        """Return the process ID of every process that runs, by name."""
        found = {"station": os.getpid()}
        if self.control is not None and self.control.alive:
            found["control"] = self.control.pid
        if self.lab.pid is not None:
            found["lab"] = self.lab.pid
        if self._guard is not None:
            found["guard"] = self._guard.pid
        return found

    def renew_guard(self) -> bool:
        """Start another guard if the present one has ended or is suspended; return whether that was necessary."""
        with self._changing:
            if self._guard is None or self._guard.runs or self.closing:
                return False
            self._guard.close(0.0)
            self._start_guard()
            return True

    def end_failed(self, failed: Collection[str]) -> None:
        """End the control process, and also the lab if `failed` contains the lab's label."""
        if self.control is not None:
            if self.control.alive:
                self.control.kill(f"it was ended because {' and '.join(failed)} did not respond")
            self.control.close()
        if LAB_LABEL in failed:
            self.lab.close()

    def restart(self) -> None:
        """Start the control process again, and the lab if the lab has ended.

        Raises:
            RefusedError: the station is ending.
        """
        with self._changing:
            if self.closing:
                raise RefusedError("the station is ending")
            if not self.lab.alive:
                self.lab.open()
            self._start_control()

    @property
    def closing(self) -> bool:
        """Whether the station is ending, so that no process may be started."""
        return self._closing.is_set()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings that the station process was delayed, or that this computer may sleep while real stages move."""
        found: list[str] = []
        if self._late and self._clock.now() - self._late_at <= WARNING_DURATION_S:
            found.append(
                f"this computer is too busy: the station process was delayed by {self._late:.1f} s ({load()}), and a"
                " STOP would be delayed, too; close pages and clients, end other programs; run ctr-station doctor"
            )
        if self._bench.devices is not None and self._awake is not None and (refused := self._awake.refused):
            found.append(f"this computer may sleep, and moving stages then continue ({refused}): {TURN_OFF_SLEEP}")
        return tuple(found)

    def end_control(self) -> StopOutcome:
        """Stop every axis and end the control process; no control process is started after this call.

        Returns:
            Outcome of stopping the stages.
        """
        with self._changing:
            self._closing.set()
        return NO_STAGES if self.control is None else self.control.close()

    def close(self) -> None:
        """End the control process like `end_control`, then the lab."""
        self.end_control()
        self.lab.close()
        if self._guard is not None:
            self._guard.close(GUARD_PATIENCE_S)
            self._guard = None
        if self._awake is not None:
            self._awake.close()
        if self._watchdog.is_alive():
            self._watchdog.join(timeout=self._clock.real(3.0))

    def _start_guard(self) -> None:
        self._guard = Guard(self._ring, ring_width(self._bench.robot), self._clock)

    def _start_control(self) -> None:
        self.control = ControlHost(self._bench, self._ring, self.lab.devices, self._receive, self._on_exit)

    def _receive(self, message: ControlReport) -> None:
        if isinstance(message, StateNotice) and message.state is State.READY:
            self._tick_timeout = HUNG_AFTER_S
        self._on_report(message)

    def _watch(self) -> None:
        """Write this process's heartbeat and kill the control process when it hangs."""
        if self._bench.fifo:
            request_fifo(WATCHER_PRIORITY)
        failures: set[str] = set()
        while not self._closing.wait(self._clock.real(POLL_INTERVAL_S)):
            try:
                self._check()
            except Exception as error:  # the watchdog must continue after any failure
                if repr(error) not in failures:
                    traceback.print_exc()
                failures.add(repr(error))

    def _check(self) -> None:
        now, control = self._clock.now(), self.control
        late = now - self._checked_at - POLL_INTERVAL_S if self._checked_at else 0.0
        self._checked_at = now
        if late > LATE_WARNING_S:
            self._late, self._late_at = late, now
        self._ring.numbers[STATION_HEARTBEAT] = now
        ticked = float(self._ring.numbers[HEARTBEAT])
        if control is None or not control.alive:
            return
        if ticked > 0.0 and now - ticked > self._tick_timeout:
            silent, waits_for = f"the control loop was silent for {now - ticked:.1f} s", control.waits_for
            if waits_for:
                control.kill(f"{silent}, because it waits for {waits_for}")
            else:
                control.kill(too_busy(silent), load())
        elif ticked > 0.0 and now - ticked > SUSPENDED_AFTER_S and life(control.pid) is Life.SUSPENDED:
            control.kill("the control process was suspended")
        # A run has no value without its recording, so a failed recording ends the run in HOLD.
        elif problem := self._lost_process() or self._problem():
            control.hold(problem)

    def _lost_process(self) -> str:
        """Return why a motion must end: without a guard always, else only at the end of another process."""
        moving = self._ring.counters[STATE] in MOVING
        if moving and self._guard is not None and not self._guard.runs:
            return "the guard has ended or is suspended, so nothing may move; reset starts another guard"
        lost = ""
        if self._parent != os.getppid():
            self._parent = os.getppid()
            lost = "the program that started the station has ended"
        for rank in (Rank.RECORDER, Rank.GATEWAY):  # without a camera a run continues with a warning
            pid = int(self._ring.counters[WATCHERS + rank])
            if pid and pid != self._lost[rank] and (found := life(pid)) is not Life.RUNS:
                self._lost[rank] = pid
                how = "has ended" if found is Life.ENDED else "was suspended"
                lost = f"the process of the {rank.name.lower()} {how}"
        return f"{lost}, and all axes were stopped" if lost and moving else ""
