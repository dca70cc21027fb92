"""The control loop with the virtual lab: connecting, taring, a complete run, stops, and readings that are NaN."""

import math
from typing import Any

import numpy as np
import pytest

from core.robot.robot import Array
from station.config.loads import ConstantLoad
from station.config.motions import CircleMotion, HoldMotion, JointSweepMotion, Orders
from station.control.loop import ControlLoop, MotionTask, Phase
from station.control.states import RefusedError, State
from station.devices.interfaces import Condition, Devices, TipReading, WrenchReading
from station.devices.zaber.protocol import ZaberCommand
from station.experiments.experiment import Case
from tests.harness.cases import a_case
from tests.harness.watched_bench import Bench

#: Times of rest before a motion [s]: first the filters settle, then readings are averaged.
SETTLE, AVERAGE = 0.5, 1.5


@pytest.fixture(scope="module")
def case() -> Case:
    """Return the case of Fig. 10 with feed-forward on the default virtual lab."""
    return a_case("fig10", "feedforward")


@pytest.fixture(scope="module")
def ideal() -> Case:
    """Return a case with the same kind of controller on the ideal lab, which has no errors."""
    return a_case("fig3", "d_feedforward")


def task(case: Case, motion: Any, duration: float, start: Array | None = None) -> MotionTask:
    return MotionTask(case.controller, Orders(motion, case.robot.robot()), duration, start)


CIRCLE = CircleMotion(radius=0.010, period=8.0)


def test_devices_receive_nothing_before_connect(case):
    bench = Bench(case)

    assert bench.tick(200) is None
    assert bench.loop.state is State.OFF
    assert bench.lab.chain.units[0].settings[ZaberCommand.SET_MAXIMUM] == 1_536_000  # maximum position of a new unit


def test_states_before_ready_follow_the_devices(case):
    bench = Bench(case)
    bench.loop.connect(0.0)
    seen = [bench.loop.state]
    conditions = []
    while bench.loop.state is not State.READY:
        assert bench.now < 10.0
        row = bench.tick()
        if bench.loop.state is not seen[-1]:
            seen.append(bench.loop.state)
            conditions.append(
                (bench.stages.condition, bench.devices.tracker.condition, bench.devices.sensors.condition)
            )
        if bench.loop.state is State.CONNECTING:
            assert row is None

    # Stages report that they are homed, so CONNECTED lasts no longer than a tick.
    assert seen == [State.CONNECTING, State.HOMED, State.READY]
    assert conditions[0] == (Condition.CONNECTED,) * 3
    assert bench.stages.commands == []


def test_start_is_refused_before_the_station_is_ready(case):
    bench = Bench(case)
    bench.loop.connect(0.0)
    bench.tick(50)

    with pytest.raises(RefusedError, match="it needs READY"):
        bench.loop.start(task(case, CIRCLE, 1.0))

    bench.tick(50)
    assert bench.loop.state is State.CONNECTING
    assert bench.loop.phase is Phase.NONE
    assert bench.stages.commands == []


def test_station_in_ready_estimates_the_tip_and_sends_no_velocity(ideal):
    bench = Bench(ideal)
    bench.ready()
    bench.tick(100)

    assert bench.loop.state is State.READY
    assert bench.stages.commands == []
    # The bound is the error of 10 mm sub-links compared with an exact rod of the same parameters.
    assert np.linalg.norm(bench.of("tip_estimated") - bench.of("tip_true"), axis=1).max() < 1e-4


def test_first_tare_is_a_mean_and_not_one_noisy_sample(case):
    """A single sample of two sensors with 0.02 N of noise would have an error of 0.028 N per axis."""
    bench = Bench(case)
    bench.ready()
    bench.tick(1000)
    start = len(bench.rows)
    bench.tick(500)

    assert bench.of("force")[start:].mean(axis=0) == pytest.approx(np.zeros(3), abs=0.005)


def test_run_rests_for_the_tare_and_the_start_tip_before_its_motion(case):
    bench = Bench(case)
    bench.ready()
    bench.loop.start(task(case, CIRCLE, 1.0))
    bench.until(Phase.SETTLING)
    start, first = bench.now, len(bench.rows)
    bench.until(Phase.MOVING)

    assert bench.now - start == pytest.approx(SETTLE + AVERAGE)
    assert bench.stages.commands == [] or bench.stages.commands[0][0] >= start + SETTLE + AVERAGE - 1e-9
    resting = [row for row in bench.rows[first:-1] if bench.of("time", [row])[0, 0] >= start + SETTLE - 1e-9]
    frames = bench.of("tip_measured", resting)[bench.of("tip_new", resting)[:, 0] > 0]
    assert len(frames) == 60
    # The first setpoint is the start tip, which is the mean of the frames at rest.
    assert bench.of("tip_desired")[-1] == pytest.approx(frames.mean(axis=0), abs=1e-12)
    # The mean of 60 frames with a noise of 0.1 mm has an error of 13 um; the true tip did not move.
    assert bench.of("tip_desired")[-1] == pytest.approx(bench.of("tip_true")[-1], abs=60e-6)


def test_tare_removes_the_sensors_offsets_from_the_load(case):
    bench = Bench(case)
    bench.ready()
    bench.loop.start(task(case, HoldMotion(), 2.0))
    bench.until(Phase.MOVING)
    bench.lab.apply_load(ConstantLoad(magnitude=0.3, direction=(0.0, 0.6, 0.8)), bench.now + 0.5)
    start = len(bench.rows)
    bench.tick(900)

    # Without the tare the readings have offsets of up to 1 N.
    assert np.abs(bench.of("wrench_raw")[start]).max() > 0.2
    # Tolerance: noise of two sensors, 0.02 N each, averaged over 200 and 600 samples, and friction.
    assert bench.of("force")[start : start + 200].mean(axis=0) == pytest.approx(np.zeros(3), abs=0.01)
    assert bench.of("force")[start + 300 :].mean(axis=0) == pytest.approx([0.0, 0.18, 0.24], abs=0.01)


def test_completed_run_leaves_the_station_at_rest_and_ready(ideal):
    bench = Bench(ideal)
    bench.ready()
    bench.loop.start(task(ideal, CIRCLE, 1.5))
    bench.tick(500)
    assert bench.loop.part_done(bench.now) == 0.0  # only the motion counts
    bench.until(Phase.MOVING)
    first = len(bench.rows) - 1
    bench.tick(375)
    assert bench.loop.part_done(bench.now) == pytest.approx(0.5)
    while bench.loop.progress is not None:
        bench.tick()
    moving = bench.rows[first:-1]

    assert bench.loop.state is State.READY
    assert bench.loop.cause == ""
    assert len(moving) == 750
    assert (bench.of("state", moving) == State.RUNNING).all()
    # The tip follows within 0.1 mm. The chord of the circle after 1.5 s of 8 s is 2 * 10 mm * sin(pi * 1.5 / 8).
    assert np.abs(bench.of("tip_desired", moving) - bench.of("tip_true", moving)).max() < 1e-4
    path = bench.of("tip_true", moving)
    assert np.linalg.norm(path[-1] - path[0]) == pytest.approx(0.020 * math.sin(math.pi * 1.5 / 8.0), rel=0.02)
    assert bench.stages.stops[-1] == bench.now
    assert bench.stages.commands[-1][0] < bench.now
    at_rest = bench.truths[-1].tip
    bench.tick(100)
    assert bench.truths[-1].tip == pytest.approx(at_rest, abs=5e-5)
    assert not bench.of("velocity_sent")[-1].any()


def test_stop_during_a_motion_brings_every_axis_to_rest_and_lasts(case):
    bench = Bench(case)
    bench.ready()
    first = task(case, CIRCLE, 8.0)
    bench.loop.start(first)
    bench.until(Phase.MOVING)
    bench.tick(300)
    with pytest.raises(RefusedError, match="RUNNING"):
        bench.loop.start(task(case, HoldMotion(), 1.0))
    assert bench.loop.progress is not None
    assert bench.loop.progress.task.orders is first.orders
    assert np.abs(bench.of("velocity_sent")[-1]).min() > 0.0
    last = bench.stages.commands[-1][0]
    bench.loop.stop(bench.now)
    bench.tick(5)  # wait 10 ms: a message may occupy the line, then the stop command takes 6.25 ms

    assert bench.loop.state is State.STOPPED
    assert bench.loop.cause == "stopped by the operator"
    assert not bench.of("velocity_sent")[-1].any()
    bench.tick(120)  # wait for 12 ms of transport and 0.2 s of braking from top speed
    at_rest = bench.of("joints")[-1]
    bench.tick(500)
    assert bench.of("joints")[-1] == pytest.approx(at_rest, abs=1e-12)
    assert bench.stages.commands[-1][0] == last
    with pytest.raises(RefusedError, match="STOPPED"):
        bench.loop.start(task(case, CIRCLE, 1.0))
    bench.loop.reset(bench.now)
    assert (bench.loop.state, bench.loop.cause) == (State.READY, "")


def test_run_approaches_its_start_pose_first_inside_the_limits(case):
    away = case.start + np.array([math.radians(5.0), math.radians(-3.0), 0.004])
    bench = Bench(case, start=away)
    bench.ready()
    first = len(bench.rows)
    bench.loop.start(task(case, HoldMotion(), 0.5, case.start))
    bench.until(Phase.SETTLING)
    bench.tick(200)

    assert bench.of("joints")[first] == pytest.approx(away, abs=1e-5)
    # The tolerance includes the travel while the stop command is transmitted.
    assert np.abs(bench.of("joints")[-1] - case.start) == pytest.approx(np.zeros(3), abs=2e-3)
    assert abs(bench.of("joints")[-1][2] - case.start[2]) < 2e-4
    assert (np.abs(bench.of("velocity_sent")) <= case.controller.limits.speed).all()


def test_sweep_moves_only_its_joint_by_its_distance(case):
    bench = Bench(case)
    bench.ready()
    bench.loop.start(task(case, JointSweepMotion(joint="outer_rotation", speed=0.1, distance=0.05), 1.0))
    bench.until(Phase.MOVING)
    bench.tick(450)

    moved = bench.of("joints")[-1] - case.start
    assert moved[0] == pytest.approx(0.05, abs=0.003)  # tolerance: commands may start and end up to 25 ms late
    assert moved[1:] == pytest.approx([0.0, 0.0], abs=1e-5)


def test_sensors_that_answer_nan_before_a_motion_cause_hold_until_they_answer_valid_numbers(case):
    bench = Bench(case, breaks="sensors")
    bench.ready()
    bench.loop.start(task(case, CIRCLE, 8.0))
    bench.until(Phase.SETTLING)
    bench.tick(200)
    assert bench.loop.state is State.RUNNING
    assert bench.broken is not None
    bench.broken.since = bench.now
    bench.tick(10)
    bench.broken.since = math.inf
    bench.tick(10)
    assert bench.loop.state is State.HOLD
    bench.loop.reset(bench.now)
    bench.loop.start(task(case, HoldMotion(), 0.1))
    while bench.loop.progress is not None:
        bench.tick()

    assert bench.loop.state is State.READY


def test_run_without_tracker_frames_at_rest_ends_in_hold_and_names_the_tracker(case):
    class Blind:
        """Tracker that sends no frame from the time `since` on."""

        def __init__(self, tracker: Any) -> None:
            self.tracker = tracker
            self.since = math.inf

        def poll(self, now: float) -> TipReading | None:
            reading = self.tracker.poll(now)
            return reading if now < self.since else None

        def __getattr__(self, name: str) -> Any:
            return getattr(self.tracker, name)

    bench = Bench(case)
    devices = bench.devices
    blind = Blind(devices.tracker)
    bench.loop = ControlLoop(case.controller, Devices(bench.stages, blind, devices.sensors))
    bench.ready()
    bench.loop.start(task(case, CIRCLE, 1.0))
    bench.tick(20)
    blind.since = bench.now
    bench.tick(1500)

    assert bench.loop.state is State.HOLD
    assert "tracker" in bench.loop.cause
    assert bench.stages.commands == []


def test_telemetry_row_has_the_device_readings_of_its_tick(case):
    readings: list[WrenchReading] = []

    class Overheard:
        def __init__(self, sensors: Any) -> None:
            self.sensors = sensors

        def poll(self, now: float) -> WrenchReading:
            readings.append(self.sensors.poll(now))
            return readings[-1]

        def __getattr__(self, name: str) -> Any:
            return getattr(self.sensors, name)

    bench = Bench(case)
    devices = bench.devices
    bench.loop = ControlLoop(case.controller, Devices(bench.stages, devices.tracker, Overheard(devices.sensors)))
    bench.ready()
    row = bench.tick(30)

    assert row is not None
    assert bench.of("time", [row]).item() == pytest.approx(bench.now)
    assert bench.of("wrench_raw", [row])[0] == pytest.approx(readings[-1].wrenches.ravel())
    assert bench.of("joints", [row])[0] == pytest.approx(bench.devices.stages.poll(bench.now).positions)
    assert bench.of("tip_true", [row])[0] == pytest.approx(bench.truths[-1].tip)
    assert bench.of("truth_known", [row]).item() == 1.0
