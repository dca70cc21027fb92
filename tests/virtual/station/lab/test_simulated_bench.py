"""The virtual lab at wire level with the station's drivers on its wires, in virtual time."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from core.control.sensors import closure, fuse_at
from station.config.loads import ConstantLoad, NoLoad, RampLoad, SineLoad
from station.config.robots import RobotFile, load_robot
from station.devices.ati.calibration import read_page
from station.devices.ati.netft import NetftSensors
from station.devices.aurora.session import FrameQuality
from station.devices.aurora.tracker import AuroraTracker
from station.devices.interfaces import JointReading, TipReading, WrenchReading
from station.devices.zaber.setup import PortSetup
from station.devices.zaber.stages import Condition, ZaberStages
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import BaseSensorConfig, LabConfig, PlantConfig, TrackerConfig
from station.lab.simulated_bench import SimulatedBench

TICK = 0.002
PARK = np.array([0.05, 0.30, -0.125])
QUIET = BaseSensorConfig(
    force_noise=0.0,
    moment_noise=0.0,
    force_count=0.0,
    moment_count=0.0,
    drift=0.0,
    moment_drift=0.0,
    force_offset=0.0,
    moment_offset=0.0,
)
#: The default plant and devices without noise.
CLEAR = LabConfig(tracker=TrackerConfig(noise=0.0), sensors=QUIET)


class Bench:
    """A lab whose wires are in memory, with a driver on each wire."""

    def __init__(
        self, robot: RobotFile, config: LabConfig = CLEAR, seed: int = 0, at: np.ndarray = PARK, homed: bool = False
    ) -> None:
        self.lab = SimulatedBench(robot, config, seed, at, homed=homed)
        hosts = self.lab.hosts
        every = tuple(range(len(robot.joints)))
        self.stages = ZaberStages(self.lab.setups, [PortSetup(hosts.stages, every)])
        self.tracker = AuroraTracker(hosts.aurora, registration=GENERATOR_POSE)
        self.sensors = NetftSensors(hosts.netft, [read_page(box.page() or b"") for box in self.lab.boxes])
        self.sensors.start(0.0)
        self.now = 0.0
        self.joints: JointReading
        self.wrenches: WrenchReading
        self.frames: list[TipReading] = []
        self.tips: list[tuple[float, np.ndarray]] = []  # times and true tips

    def run(
        self, seconds: float, velocities: Sequence[float] | None = None, until: Callable[[], bool] = lambda: False
    ) -> "Bench":
        end = self.now + seconds
        while self.now < end and not until():
            self.tips.append((self.now, self.lab.advance(self.now).tip))
            assert self.lab.trouble == ""
            self.joints = self.stages.poll(self.now)
            self.wrenches = self.sensors.poll(self.now)
            if (frame := self.tracker.poll(self.now)) is not None:
                self.frames.append(frame)
            if velocities is not None:
                self.stages.command(np.array(velocities), self.now)
            self.now += TICK
        return self

    def connect(self) -> "Bench":
        self.stages.connect(self.now)
        return self.run(10.0, until=lambda: self.stages.condition is not Condition.CONNECTING)

    def home(self) -> "Bench":
        self.stages.home(self.now)
        return self.run(60.0, until=lambda: self.stages.condition is not Condition.HOMING)

    def true_tip(self, time: float) -> np.ndarray:
        times, tips = np.array([t for t, _ in self.tips]), np.array([tip for _, tip in self.tips])
        return np.array([np.interp(time, times, tips[:, axis]) for axis in range(3)])


@pytest.fixture(scope="module")
def homed() -> Bench:
    """Return a lab that is connected and homed, at a pose from which every joint can move in both directions."""
    bench = Bench(load_robot("paper")).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
    assert bench.stages.homed == [False, False, False]  # no stage is homed after power-up
    bench.home()
    assert bench.stages.ready, bench.stages.problem
    bench.run(3.0, [0.10, 0.20, 0.008])
    bench.stages.stop(bench.now)
    return bench.run(1.0)


def test_true_joints_before_homing_are_the_configured_ones(paper):
    bench = Bench(paper).run(0.1)

    assert bench.lab.positions == pytest.approx(PARK, abs=1e-12)


def test_homed_stages_report_the_true_joints(homed):
    microsteps = np.abs(homed.joints.positions - homed.lab.positions) / [s.joint.microstep for s in homed.lab.setups]

    assert homed.stages.at_rest
    assert microsteps.max() < 1.0


def test_commanded_velocities_move_the_true_joints(homed):
    before = homed.lab.positions
    homed.run(1.0, [0.05, -0.08, 0.004])
    homed.stages.stop(homed.now)
    homed.run(0.5)

    moved = homed.lab.positions - before
    assert moved == pytest.approx([0.05, -0.08, 0.004], rel=0.15)
    assert homed.joints.positions == pytest.approx(homed.lab.positions, abs=5e-6)


@pytest.mark.parametrize(
    ("name", "at"),
    [
        ("three_tubes", [0.02, 0.03, 0.04, -0.140, -0.220, -0.325]),
        # The outermost tube retracts first, so that every tube's end stays in front of its outer neighbour's end.
        ("balanced_pair", [0.02, 0.03, 0.04, -0.040, -0.095, -0.160]),
    ],
)
def test_robot_of_three_tubes_connects_and_homes(name, at):
    robot, at = load_robot(name), np.array(at)
    bench = Bench(robot, at=at).connect().home()

    assert bench.stages.ready, bench.stages.problem
    assert bench.joints.positions == pytest.approx(bench.lab.positions, abs=5e-6)
    assert len(bench.wrenches.wrenches) == 3
    assert bench.sensors.is_usable


def test_tracker_driver_reports_the_true_tip_at_the_time_of_the_measurement(homed):
    homed.run(1.0, [0.08, 0.10, 0.006])  # the tip moves by a third of a millimetre during the latency of 24 ms
    seen = [frame for frame in homed.frames if frame.time > homed.now - 0.8]
    homed.stages.stop(homed.now)
    homed.run(0.5)

    assert len(seen) >= 28  # 40 frames/s
    assert homed.tracker.report(homed.now).quality is FrameQuality.GOOD
    errors = [frame.position - homed.true_tip(frame.time) for frame in seen]
    assert np.abs(errors).max() < 30e-6


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.3, 0.4, 0.5)])
def test_force_estimated_from_the_base_sensors_is_the_load(homed, paper, direction):
    homed.lab.apply_load(ConstantLoad(magnitude=0.4, direction=direction), homed.now)
    homed.run(0.2)
    fused = fuse_at(paper.robot(), homed.joints.positions, homed.wrenches.wrenches)
    homed.lab.apply_load(NoLoad(), homed.now)

    assert homed.sensors.is_usable
    expected = 0.4 * np.array(direction) / np.linalg.norm(direction)
    assert homed.lab.truth.force == pytest.approx(expected)
    # The tolerance includes 0.1 deg of play at the inner rotation.
    assert fused.force == pytest.approx(expected, abs=1.5e-3)
    assert closure(fused, homed.lab.truth.tip) < 0.5e-3


def test_time_of_a_load_counts_from_its_start(homed):
    homed.lab.apply_load(SineLoad(amplitude=0.2, frequency=0.5), homed.now)
    homed.run(0.5)
    homed.lab.apply_load(NoLoad(), homed.now)

    assert homed.lab.truth.force == pytest.approx([0.2, 0.0, 0.0], abs=1e-4)


def test_untared_force_sensors_read_different_offsets(paper):
    bench = Bench(paper, LabConfig()).run(0.5)

    assert [each["calibration"] for each in bench.sensors.details().values()] == ["FT00001", "FT00002"]
    first, second = bench.wrenches.wrenches
    assert np.abs(first - second).max() > 0.05


def test_time_of_a_force_sample_is_accurate_to_a_few_tenths_of_a_millisecond(paper):
    bench = Bench(paper, CLEAR.model_copy(update={"plant": PlantConfig(play={})})).run(0.1)
    start, late = bench.now, []
    # the force rises by 1 N/s, so its value indicates the time of measurement
    bench.lab.apply_load(RampLoad(times=(0.0, 0.5), magnitudes=(0.0, 0.5)), start)
    for _ in range(200):
        bench.run(TICK)
        force = fuse_at(paper.robot(), bench.lab.positions, bench.wrenches.wrenches).force[0]
        late.append(bench.wrenches.time - (start + force))

    # If the boxes sent a record each tick, every record would wait equally long for its poll, with an error of 1.7 ms.
    assert np.abs(late[50:]).max() < 0.4e-3
    assert np.mean(late[50:]) < 0.25e-3


def test_homed_stages_need_no_homing_after_reconnecting(paper):
    bench = Bench(paper, at=np.array([-0.2, 1.5, -0.1]), homed=True).connect()

    assert bench.stages.ready, bench.stages.problem
    assert bench.joints.positions == pytest.approx([-0.2, 1.5, -0.1], abs=5e-6)
    bench.run(1.0, [0.05, -0.08, 0.004])
    bench.stages.stop(bench.now)
    bench.run(0.5)
    assert bench.joints.positions == pytest.approx(bench.lab.positions, abs=5e-6)


def test_lab_continues_with_the_last_shape_at_an_impossible_pose(paper):
    lab = SimulatedBench(paper, CLEAR, 0, PARK)
    tip = lab.advance(0.002).tip
    lab.apply_load(ConstantLoad.model_construct(magnitude=1e6), 0.0)
    stuck = lab.advance(0.004)

    assert lab.trouble
    assert np.array_equal(stuck.tip, tip)
    lab.apply_load(NoLoad(), 0.0)
    assert lab.advance(0.006).tip == pytest.approx(tip, abs=1e-7)
    assert lab.trouble == ""


def test_simulated_bench_is_the_same_for_the_same_seed_only(paper):
    def frames_and_wrenches(seed: int) -> tuple[np.ndarray, np.ndarray]:
        bench = Bench(paper, LabConfig(), seed).run(2.0)
        assert len(bench.frames) > 10
        return np.array([frame.position for frame in bench.frames]), bench.wrenches.wrenches

    first, again, other = (frames_and_wrenches(seed) for seed in (7, 7, 8))

    for one, same, different in zip(first, again, other, strict=True):
        assert np.array_equal(one, same)
        assert not np.array_equal(one, different)


def test_simulated_bench_advances_in_steps_of_any_length(paper):
    lab = SimulatedBench(paper, CLEAR, 0, PARK)
    steps = (0.0, 1e-4, 1e-3, 0.5, 0.5, math.pi)
    for now in steps:
        lab.advance(now)

    assert lab.time == math.pi
    assert lab.positions == pytest.approx(PARK, abs=1e-12)
