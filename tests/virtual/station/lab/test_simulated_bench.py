"""The virtual lab at wire level with the station's drivers on its wires, in virtual time."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from core.control.sensors import fuse_at
from station.config.loads import ConstantLoad, NoLoad, RampLoad, SineLoad
from station.config.robots import BaseFile, RobotFile, load_robot
from station.devices.ati.calibration import read_page
from station.devices.ati.netft import NetftSensors
from station.devices.aurora.tracker import AuroraTracker
from station.devices.interfaces import Condition, JointReading, TipReading, WrenchReading
from station.devices.kernel.quality import Quality
from station.devices.kernel.stages import Port
from station.devices.zaber.stages import zaber_stages
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
        self.stages = zaber_stages(self.lab.setups, [Port(hosts.stages, every)])
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
    """Return a lab with homed stages at a pose from which every joint can move in both directions."""
    bench = Bench(load_robot("paper"), at=np.array([0.3, 0.6, -0.106]), homed=True).connect()
    assert bench.stages.ready, bench.stages.problem
    return bench.run(1.0)


def test_robot_of_three_tubes_connects_and_homes():
    # The outermost tube retracts first, so that every tube's end stays in front of its outer neighbour's end.
    bench = Bench(load_robot("balanced_pair"), at=np.array([0.02, 0.03, 0.04, -0.040, -0.095, -0.160])).connect()
    assert not any(bench.stages.axes.homed)  # no stage is homed after power-up
    bench.home()

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
    assert homed.tracker.report(homed.now).quality is Quality.GOOD
    errors = [frame.position - homed.true_tip(frame.time) for frame in seen]
    assert np.abs(errors).max() < 30e-6


def test_force_estimated_from_the_base_sensors_is_the_load(homed, paper):
    direction = (0.3, 0.4, 0.5)
    homed.lab.apply_load(ConstantLoad(magnitude=0.4, direction=direction), homed.now)
    homed.run(0.2)
    fused = fuse_at(paper.robot(), homed.joints.positions, homed.wrenches.wrenches)
    homed.lab.apply_load(NoLoad(), homed.now)

    assert homed.sensors.is_usable
    expected = 0.4 * np.array(direction) / np.linalg.norm(direction)
    assert homed.lab.truth.force == pytest.approx(expected)
    # The tolerance includes 0.1 deg of play at the inner rotation.
    assert fused.force == pytest.approx(expected, abs=1.5e-3)
    assert np.linalg.norm(fused.moment - np.cross(homed.lab.truth.tip, fused.force)) < 0.5e-3


def test_force_sensor_under_the_robot_reads_the_load_in_the_axes_of_the_plate(paper):
    turned = paper.model_copy(update={"base": BaseFile(rotation_vector=(0.0, 0.0, 0.5 * math.pi))})
    bench = Bench(turned.sensed_at("robot", "at"), at=np.array([0.3, 0.6, -0.106])).run(0.1)
    unloaded = bench.wrenches.wrenches
    bench.lab.apply_load(ConstantLoad(magnitude=0.4, direction=(0.3, 0.4, 0.5)), bench.now)
    bench.run(0.2)

    force, tip = bench.lab.truth.force, bench.lab.truth.tip
    assert np.linalg.norm(force) == pytest.approx(0.4)
    (x, y, z), (tx, ty, tz) = force, tip  # the plate's x axis is the world's y axis
    in_plate = [y, -x, z, *np.cross([ty, -tx, tz], [y, -x, z])]
    assert bench.wrenches.wrenches.shape == (1, 6)
    assert bench.wrenches.wrenches[0] == pytest.approx(in_plate, abs=1e-5)  # without an error by the drives' play
    assert unloaded[0] == pytest.approx(np.zeros(6), abs=1e-5)


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


def test_simulated_bench_advances_in_steps_of_any_length(paper):
    lab = SimulatedBench(paper, CLEAR, 0, PARK)
    steps = (0.0, 1e-4, 1e-3, 0.5, 0.5, math.pi)
    for now in steps:
        lab.advance(now)

    assert lab.time == math.pi
    assert lab.positions == pytest.approx(PARK, abs=1e-12)
