"""The golden cases: short runs in virtual time whose recorded numbers must not change by a bit.

A case is a row of a table below or a short function. It returns numbers by name; for a run these are the channels of
telemetry in every tick.
"""

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from core.control.controllers import PositionMode, Strategy, TaskInputs, type_2
from core.control.setpoint_request import SetpointRequest
from core.control.velocity_ik import VelocityTask
from core.robot.limits import LimitContext
from core.robot.robot import Array
from station.calibration import procedures, summary
from station.calibration.plan import PlanSubject
from station.calibration.procedure import Procedure
from station.calibration.static_lab import StaticLab, run_static
from station.cli.calibrate import robot_start
from station.config.loads import RampLoad
from station.config.motions import HelixMotion, JointSweepMotion, Orders, StepMotion, WaypointsMotion
from station.config.robots import load_robot
from station.control.states import State
from station.control.task import MotionTask, Phase, StreamLimits, StreamRequest
from station.control.telemetry import Channels
from station.experiments.experiment import Case, load_experiment
from station.lab.config import StagesKind, load_lab
from station.lab.simulated_line import Faults
from station.lab.simulated_stages import STAGES
from station.lab.wires import HostPort
from tests.harness.cases import a_run
from tests.harness.lumen_mesh import write_lumen
from tests.harness.stages_bench import StagesBench, swing
from tests.harness.virtual_station import CIRCLE, VirtualStation, usual_case

#: Recorded numbers of a case over time, by name.
Numbers = Mapping[str, Array]

#: Changes of a preset experiment, after which its load acts within the first seconds.
SOON = {"load": {"period": 4.0}}
AT_ONCE = {"load": {"start": 0.3}}
#: Presets: experiment, case, duration of the motion [s], changed keys.
PRESETS: Mapping[str, tuple[str, str, float, Mapping[str, Any]]] = {
    "fig3 inner loop": ("fig3", "c", 1.0, {"load": {"frequency": 0.5}}),
    "fig3 dual layer": ("fig3", "d_feedforward", 1.0, {"load": {"frequency": 0.5}}),
    "fig7": ("fig7", "regulation", 1.0, SOON),
    "fig8 type 1 exact": ("fig8", "type_1_exact", 1.0, SOON),
    "fig8 distorted": ("fig8", "regulation_distorted", 1.0, SOON),
    "fig10 paper": ("fig10", "paper", 1.0, SOON),
    "points": ("points", "pointing", 1.0, {"load": {"ramp": 0.5}}),
    "palpate": ("palpate", "lump", 2.0, {"trajectory": {"travel": 0.6, "dwell": 1.2}}),
    "touch wall": ("touch", "wall", 1.5, {"load": {"distance": 0.001}}),
    "touch circle": ("touch", "circle", 1.5, {"load": {"distance": 0.001}}),
    "load rate": ("load_rate", "regulation-ramp_0_25s", 1.0, AT_ONCE),
    "load rate tap": ("load_rate", "type_1-tap", 1.0, AT_ONCE),
    "stiffness": ("stiffness", "natural-x", 1.0, {}),
    "stiffness wall": ("stiffness", "wall", 1.5, {"load": {"frequency": 0.3}}),
    "follow": ("follow", "breathing", 1.0, {"load": {"start": 0.0, "rise": 0.5}}),
    "follow newest frame": ("follow", "heartbeat_newest_frame", 1.0, {}),
    "no tracker": ("fewer_devices", "sensors_only", 1.0, SOON),
    "no sensors": ("fewer_devices", "tracker_only_sinusoid", 1.0, SOON),
    "stages only": ("fewer_devices", "stages_only", 1.0, {}),
    "realistic": ("accuracy", "default-tap", 1.0, AT_ONCE),
    "realistic shaft": ("accuracy", "paper-shaft", 1.0, {}),
    **{f"stages {kind}": ("stages", kind, 1.0, {}) for kind in STAGES},
}
#: Motions that no preset above makes.
MOTIONS: Mapping[str, Any] = {
    "helix": HelixMotion(radius=0.004, pitch=0.002, turn=2.0, turns=3.0),
    "step": StepMotion(offset=(0.0, 0.003, 0.0), stay=0.4),
    "waypoints": WaypointsMotion(points=((1.0, 0.004, 0.0, 0.0), (2.0, 0.004, 0.004, -0.002))),
    "joint sweep": JointSweepMotion(joint="inner_rotation", speed=0.2, distance=0.3),
}
#: Regions next to the tubes of the experiment `keep_out`, which reach the margin of each within 2 s [m].
BESIDE = (0.0180, -0.0150, 0.1285)
REGIONS: Mapping[str, Mapping[str, Any]] = {
    "sphere": {"centre": BESIDE, "radius": 0.0085},
    "box": {"centre": BESIDE, "edges": (0.0140, 0.030, 0.010), "rotation_vector": (0.0, 0.0, 0.2)},
    "mesh": {"inside": True},
}
LUMEN_RADII = np.full(9, 0.0152)


def preset(experiment: str, name: str, duration: float, changes: Mapping[str, Any]) -> Case:
    """Return a case of a preset experiment; its motion is not checked on the model, which would take seconds."""
    changed = {"duration": duration, "settling": 0.0, **changes}
    return load_experiment(experiment, changed, check_motions=False, only=name).cases[0]


def of_run(case: Case) -> Numbers:
    """Run a case with the product's runner."""
    run = a_run(case, seed=1)
    assert run.completed, run.cause
    return by_channel(run.channels, run.rows)


def by_channel(channels: Channels, rows: Array) -> Numbers:
    return {channel.name: rows[:, i] for i, channel in enumerate(channels.all)}


def of_station(station: VirtualStation) -> Numbers:
    return by_channel(station.loop.channels, np.array(station.rows))


def in_region(kind: str) -> Numbers:
    """Run a circle next to a region; the mesh is a lumen around the tubes."""
    region = {"name": kind, "kind": kind, "margin": 0.001, **REGIONS[kind]}
    with tempfile.TemporaryDirectory() as folder:
        if kind == "mesh":
            region["file"] = str(Path(folder) / "lumen.stl")
            write_lumen(Path(region["file"]), np.linspace((0.0, 0.0, -0.02), (0.0185, -0.0415, 0.24), 9), LUMEN_RADII)
        changes = {"keep_out": [region], "load": {"times": [0.0, 1.0]}, "trajectory": {"period": 5.0}}
        return of_run(preset("keep_out", "rib", 2.0, changes))


def motion(which: Any) -> Numbers:
    return of_station(VirtualStation(usual_case()).moving(which))


def streamed() -> Numbers:
    """A circle whose setpoints arrive at 50 Hz, then only velocities, then nothing."""
    station = VirtualStation(usual_case()).ready()
    station.loop.start(MotionTask(station.case.controller, StreamLimits(), 60.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    start = station.now

    def request(now: float) -> StreamRequest | None:
        sent = start + 0.02 * math.floor((now - start) / 0.02 + 1e-6)
        turn = 2.0 * math.pi * (sent - start) / 6.0
        position = 0.005 * np.array([math.cos(turn) - 1.0, math.sin(turn), 0.0])
        if now > start + 1.6:
            return StreamRequest(0, None)
        velocity = np.zeros(3) if now < start + 1.2 else np.array([0.0, 0.004, 0.0])
        return StreamRequest(0, SetpointRequest(position if now < start + 1.2 else None, velocity, sent, 0.05))

    station.request = request
    station.seconds(2.0)
    return of_station(station)


def jog_and_goto() -> Numbers:
    """Jogs of joints and tip, then a motion to a pose."""
    station = VirtualStation(usual_case()).ready()
    for space, velocity in (("joints", [0.1, -0.1, 0.002]), ("tip", [0.003, 0.0, 0.002])):
        station.loop.jog(station.now, space, np.array(velocity))
        station.seconds(0.2)
        station.becomes(State.READY)
    goal = station.case.start + np.array([0.1, -0.1, 0.004])
    still = Orders(CIRCLE, station.case.robot.robot())
    station.loop.start(MotionTask(station.loop.controller, still, 0.0, goal, rests=False))
    station.becomes(State.READY)
    return of_station(station)


def jog_direction() -> Numbers:
    station = VirtualStation(preset("points", "pointing_alone", 2.0, {})).ready()
    station.seconds(0.2)
    station.loop.jog(station.now, "direction", np.array([0.0, 0.1, 0.0]))
    station.seconds(0.6)
    return of_station(station)


def stop_in_a_run() -> Numbers:
    """STOP, and the reset after it."""
    station = VirtualStation(usual_case()).moving(since=0.3)
    station.loop.stop(station.now)
    station.seconds(0.3)
    assert station.state is State.STOPPED
    station.loop.reset(station.now)
    station.seconds(0.2)
    return of_station(station)


def tracker_lost() -> Numbers:
    """HOLD because the tracker lost the coil, and the reset after it has returned."""
    station = VirtualStation(usual_case()).moving(since=0.3)
    station.fail("lose_tool", "tracker")
    station.becomes(State.HOLD)
    station.seconds(0.5)
    station.mend()
    station.seconds(0.5)
    station.loop.reset(station.now)
    station.seconds(0.2)
    return of_station(station)


def noisy_lines() -> Numbers:
    """Damaged bytes on every line, a saturated sensor, and the fault of a stage without an answer."""
    station = VirtualStation(usual_case()).moving(since=0.3)
    station.fail("flip_bits", "stages", value=1e-3)
    station.seconds(0.5)
    station.fail("saturate", "inner")
    station.becomes(State.HOLD)
    station.fail("mute", "outer_rotation")
    station.becomes(State.FAULT)
    station.mend()
    station.loop.reset(station.now)
    station.seconds(0.5)
    return of_station(station)


def changed_stiffness() -> Numbers:
    case = preset("stiffness", "natural-x", 60.0, {})
    station = VirtualStation(case).moving(case.file.trajectory, since=0.2)
    station.lab.apply_load(RampLoad(times=(0.0, 0.2), magnitudes=(0.0, 0.1)), station.now)
    station.seconds(0.3)
    station.loop.set_stiffness(station.now, (60.0, 60.0, 300.0))
    station.seconds(1.0)
    return of_station(station)


@dataclass(frozen=True)
class SlowLoop:
    """Outer loop in Python."""

    gain: float = 2.0

    def tip_velocity(self, setpoint: Any, tip: Array) -> Array:
        return setpoint.velocity + self.gain * (setpoint.position - tip)


@dataclass(frozen=True)
class StillJoint:
    """Task in Python: the outer rotation prefers to stay."""

    def rows(self, at: TaskInputs) -> VelocityTask:
        return VelocityTask(np.array([[2e-3, 0.0, 0.0]]), np.zeros(1))


@dataclass(frozen=True)
class SlowPair:
    """Limit in Python of the sum of two joint speeds."""

    names = ("sum of the rotations: at most 0.02 rad/s",)

    def rows(self, at: LimitContext) -> tuple[Array, Array]:
        return np.array([[1.0, 1.0, 0.0]]), np.array([0.02])

    def check(self, at: LimitContext) -> None: ...


def custom(change: Callable[[Any], Any]) -> Numbers:
    """Run a circle with a part of the controller in Python."""
    case = usual_case()
    return of_station(VirtualStation(case._replace(controller=change(case.controller))).moving(since=0.4))


CUSTOM: Mapping[str, Callable[[Any], Any]] = {
    "loop": lambda controller: replace(controller, strategy=Strategy(SlowLoop(), type_2)),
    "inner loop": lambda controller: replace(
        controller, strategy=Strategy(PositionMode(2.5, 2.5), lambda u, view: VelocityTask(view.loaded.jacobian[:3], u))
    ),
    "task": lambda controller: replace(controller, tasks=(StillJoint(),)),
    "limit": lambda controller: replace(controller, limits=replace(controller.limits, others=(SlowPair(),))),
}


class Tap:
    """Records the bytes at the host's end of a line with the times at which they are written and read."""

    def __init__(self, port: HostPort, clock: Callable[[], float]) -> None:
        self._sides: tuple[list[float], list[float]] = ([], [])
        self._write, self._read, self._clock = port.write, port.read, clock
        port.write, port.read = self._written, self._received  # type: ignore[method-assign]

    def _written(self, data: bytes) -> None:
        self._note(0, data)
        self._write(data)

    def _received(self) -> bytes:
        data = self._read()
        self._note(1, data)
        return data

    def _note(self, side: int, data: bytes) -> None:
        self._sides[side].extend(part for byte in data for part in (self._clock(), float(byte)))

    def numbers(self) -> Numbers:
        """Return time and value of each byte in turn, for both directions."""
        return {name: np.array(side) for name, side in zip(("to device", "to host"), self._sides, strict=True)}


def wire(kind: StagesKind) -> Numbers:
    """Homing, motion, STOP, damaged bytes and a lost line of three stages, with all bytes on their line."""
    bench = StagesBench(load_robot("paper"), kind, (0.05, 0.3, -0.125), homed=False)
    tap = Tap(bench.host, lambda: bench.now)
    positions, sent, truth = list[Array](), list[Array](), list[Array]()

    def run(seconds: float, velocities: Callable[[float], Sequence[float]] | None = swing) -> None:
        for _ in range(round(seconds / 0.02)):
            bench.run(0.02, velocities)
            for values, value in (
                (positions, bench.reading.positions),
                (sent, bench.reading.sent),
                (truth, bench.truth),
            ):
                values.append(np.nan_to_num(value, nan=-9.0))

    bench.connect().home()
    run(2.0)
    bench.stages.stop(bench.now)
    run(0.5, None)
    bench.simulated.faults = Faults(flip=3e-4, drop=3e-4)
    run(1.0)
    bench.simulated.faults = Faults(mute=frozenset({2}))
    run(1.0)
    bench.simulated.faults = Faults()
    bench.connect()
    run(0.5)
    bench.host.device.unplug()
    run(0.1)
    texts = [str(bench.stages.condition), bench.cause, repr(bench.stages.details())]
    rows = {"positions": positions, "sent": sent, "truth": truth}
    return {
        **{f"{name}.{i}": column for name, values in rows.items() for i, column in enumerate(np.array(values).T)},
        **{f"bytes {name}": values for name, values in tap.numbers().items()},
        "texts": np.frombuffer("\n".join(texts).encode(), np.uint8).astype(np.float64),
    }


def _flat(result: Any, name: str = "") -> dict[str, Array]:
    """Return the numbers of nested tables, lists and arrays by their path."""
    if isinstance(result, np.ndarray | float | int):
        return {name: np.atleast_1d(np.asarray(result, np.float64)).ravel()}
    if isinstance(result, Mapping):
        pairs = result.items()
    elif hasattr(result, "_asdict"):
        pairs = result._asdict().items()
    elif isinstance(result, list | tuple):
        pairs = enumerate(result)
    else:
        return {}
    return {
        path: value for key, part in pairs for path, value in _flat(part, f"{name}.{key}" if name else str(key)).items()
    }


def calibration(procedure: Callable[[PlanSubject], Procedure[Any]]) -> Numbers:
    """Return the result of a procedure in the lab at rest."""
    file = load_robot("paper")
    subject = PlanSubject.of(file, robot_start(file))
    return _flat(
        summary.numbers(run_static(procedure(subject), StaticLab(subject, load_lab("uncalibrated", file), 1)), subject)
    )


FEW = procedures.Effort(unloaded=8, loaded=8, between=4, check=3)
CASES: Mapping[str, Callable[[], Numbers]] = {
    **{name: partial(lambda row: of_run(preset(*row)), row) for name, row in PRESETS.items()},
    **{f"motion {name}": partial(motion, which) for name, which in MOTIONS.items()},
    **{f"region {kind}": partial(in_region, kind) for kind in REGIONS},
    "streamed circle": streamed,
    "jog and goto": jog_and_goto,
    "jog of the direction": jog_direction,
    "stop in a run": stop_in_a_run,
    "tracker lost": tracker_lost,
    "faults": noisy_lines,
    "changed stiffness": changed_stiffness,
    **{f"custom {name}": partial(custom, change) for name, change in CUSTOM.items()},
    **{f"wire {kind}": partial(wire, kind) for kind in STAGES},
    "calibration tracker": partial(calibration, lambda subject: procedures.tracker(subject, FEW)),
    "calibration force": partial(calibration, lambda subject: procedures.force(subject, FEW)),
}
