"""Content of the scene, on a live station and on synthetic telemetry."""

import logging
import os
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest

from core.control.trajectories import Setpoint
from core.robot.robot import Array, Robot
from station.config.controllers import ControllerFile
from station.config.loads import ConstantLoad, NoLoad
from station.config.motions import CircleMotion, HoldMotion, JointSweepMotion, Motion, Orders, SinusoidMotion
from station.config.robots import load_robot
from station.control.loop import MotionTask
from station.control.states import State
from station.control.telemetry import Channels
from station.service.commands import Start
from tests.harness.leftovers import nothing_left_behind
from tests.harness.viewing import Viewed, viewing
from tests.harness.waiting import until
from web.scene.content import path_offsets
from web.scene.history import TRACE_BIN_S, TRACE_SPAN_S, TipTrace
from web.scene.scene import ARROW_SCALE_M_PER_N, UNITS_PER_M
from web.scene.view import FRAME_RATE_HZ, UNWATCHED_EVERY


@pytest.fixture(autouse=True, scope="module")
def nothing_is_left_behind() -> Iterator[None]:
    """Check that nothing outlives the module: a reset station has a new process and a new thread that reads from it."""
    with nothing_left_behind(30.0):
        yield


@pytest.fixture(scope="module")
def viewed(nothing_is_left_behind: None) -> Iterator[Viewed]:
    with viewing() as viewed:
        yield viewed


def task(motion: Motion, duration: float = 60.0) -> MotionTask:
    robot = load_robot("paper")
    return MotionTask(ControllerFile().controller(robot), Orders(motion, robot.robot()), duration)


# ---- the reference path


def test_the_drawn_path_of_a_circle_is_one_lap() -> None:
    path = path_offsets(task(CircleMotion(radius=0.01, period=8.0, normal=(0.0, 1.0, 0.0))))
    centre = path.mean(axis=0)
    np.testing.assert_allclose(np.linalg.norm(path - centre, axis=1), 0.01, rtol=0.03)
    np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(path[0], path[-1])
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert length.sum() == pytest.approx(2.0 * np.pi * 0.01, rel=0.01)
    assert length.max() < 1e-3


def test_the_drawn_path_of_a_sinusoid_has_its_whole_amplitude() -> None:
    path = path_offsets(task(SinusoidMotion(direction=(0.0, 0.0, 1.0), amplitude=0.015, frequency=0.05)))
    assert path[:, 2].max() == pytest.approx(0.015, abs=2e-5)
    assert path[:, 2].min() == pytest.approx(-0.015, abs=2e-5)


def test_the_drawn_path_of_a_short_motion_ends_with_the_motion() -> None:
    path = path_offsets(task(CircleMotion(radius=0.01, period=8.0), duration=2.0))
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(0.5 * np.pi * 0.01, rel=0.05)


@pytest.mark.parametrize("motion", [HoldMotion(), JointSweepMotion(joint="outer_rotation", speed=0.05, distance=1.0)])
def test_a_motion_without_a_desired_path_has_no_drawn_path(motion: Motion) -> None:
    assert len(path_offsets(task(motion))) < 2


# ---- the history


def telemetry(robot: Robot, begin: float, seconds: float) -> tuple[Channels, Array]:
    """Return telemetry rows at 500 Hz: a tip at (1, 2, 3) mm and a force of 0.1 N with noise."""
    channels = Channels(robot)
    time = begin + 0.002 * np.arange(round(seconds / 0.002))
    rows = np.zeros((len(time), len(channels)))
    channels.of(rows, "time")[:, 0] = time
    channels.of(rows, "tip_new")[::12] = 1.0
    channels.of(rows, "truth_known")[:] = 1.0
    channels.of(rows, "tip_measured")[:] = (0.001, 0.002, 0.003)
    channels.of(rows, "force")[:, 0] = 0.1 + 0.02 * np.random.default_rng(0).standard_normal(len(time))
    return channels, rows


def test_points_of_the_tip_trace_are_means_over_a_tenth_of_a_second(paper_robot: Robot) -> None:
    channels, rows = telemetry(paper_robot, 5.0, 3.0)
    history = TipTrace(channels)
    for part in np.array_split(rows, 77):
        history.take(part)
    assert len(history.points) == 29
    np.testing.assert_allclose(np.diff([point.time for point in history.points]), TRACE_BIN_S, atol=1e-9)
    np.testing.assert_allclose([point.tip for point in history.points], [(0.001, 0.002, 0.003)] * 29)
    assert abs(history.mean("force")[0] - 0.1) < 4 * 0.02 / np.sqrt(50)
    assert len(history.recent) == round(TRACE_BIN_S / 0.002)


def test_the_tip_trace_keeps_its_time_span_and_no_more(paper_robot: Robot) -> None:
    channels, rows = telemetry(paper_robot, 0.0, 25.0)
    history = TipTrace(channels)
    history.take(rows)
    assert len(history.points) == round(TRACE_SPAN_S / TRACE_BIN_S)
    assert history.now - history.points[0].time < TRACE_SPAN_S + TRACE_BIN_S


def test_a_restart_of_the_control_loop_starts_a_new_tip_trace(paper_robot: Robot) -> None:
    channels, rows = telemetry(paper_robot, 50.0, 2.0)
    history = TipTrace(channels)
    history.take(rows)
    history.take(telemetry(paper_robot, 0.0, 0.5)[1])
    assert history.points[0].time < 1.0
    assert len(history.points) == 4


# ---- the scene


def test_a_robot_at_rest_is_drawn_at_the_models_position(viewed: Viewed) -> None:
    viewed.make_ready()
    scene = viewed.view._scene
    until(lambda: viewed.view.drawn.message == "")  # an empty message: nothing is missing in the picture
    joints = viewed.supervisor.status().values["joints"]
    unloaded = viewed.supervisor.statics.solve(joints, np.zeros(6))
    # The tubes end at the measured tip. Noise of the sensors moves both by tenths of a millimetre.
    measured = viewed.supervisor.status().values["tip_measured"]
    np.testing.assert_allclose(scene._meshes[0].vertices[-1], measured, atol=2e-3)
    # The first tare is a single sample; half a second later a mean of samples replaces it.
    until(lambda: bool(np.allclose(scene._estimated.position / UNITS_PER_M, unloaded.tip, atol=2e-3)))
    np.testing.assert_allclose(
        scene._measured.position / UNITS_PER_M, viewed.supervisor.status().values["tip_measured"], atol=1e-3
    )
    assert scene._measured.visible
    assert not scene._desired.visible
    assert viewed.view.drawn.message == ""


def test_a_motion_is_drawn_with_its_path_its_setpoint_and_its_load(viewed: Viewed) -> None:
    viewed.make_ready()
    circle = CircleMotion(radius=0.01, period=10.0)
    viewed.supervisor.send(Start(trajectory=circle, load=ConstantLoad(magnitude=0.2), duration=20.0))
    scene = viewed.view._scene
    until(lambda: scene._path.visible)
    until(lambda: (force := viewed.view.drawn.force) is not None and 0.15 < np.linalg.norm(force) < 0.25)
    tail, head = scene._force.points[0]
    assert np.linalg.norm(head - tail) == pytest.approx(0.2 * ARROW_SCALE_M_PER_N, rel=0.25)
    assert (head - tail)[0] > 0.9 * np.linalg.norm(head - tail)  # gravity is +x
    assert scene._desired.visible
    # The setpoint stays on the path.
    way = np.linalg.norm(scene._path.points[:, 0] - scene._desired.position / UNITS_PER_M, axis=1)
    assert way.min() < 1e-3
    order = Orders(CircleMotion(radius=0.01, period=10.0), viewed.supervisor.robot).at(0.0)
    assert isinstance(order, Setpoint)
    assert np.ptp(scene._path.points[:, 0], axis=0).max() == pytest.approx(0.02, rel=0.01)
    viewed.supervisor.stop()
    until(lambda: not scene._desired.visible)


def test_the_scene_is_drawn_continuously(viewed: Viewed) -> None:
    viewed.make_ready()
    frames: list[float] = []
    update = viewed.view._scene.update
    try:
        viewed.view._scene.update = lambda *args, **drawn: (frames.append(time.monotonic()), update(*args, **drawn))[1]
        until(lambda: len(frames) > 30)
    finally:
        viewed.view._scene.update = update
    assert (
        frames[-1] - frames[0] > 0.9 * 30 * UNWATCHED_EVERY / FRAME_RATE_HZ
    )  # upper bound: without clients the scene is drawn less often


def test_a_request_for_a_public_link_to_the_scene_is_refused(viewed: Viewed, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert viewed.server.request_share_url() is None
    assert "refused" in caplog.text


def test_the_scene_marks_stale_telemetry_and_recovers_after_a_restart(viewed: Viewed) -> None:
    viewed.make_ready()
    scene = viewed.view._scene
    until(lambda: scene._measured.visible)
    os.kill(viewed.supervisor.pids()["control"], signal.SIGKILL)
    until(lambda: viewed.supervisor.status().state is State.FAULT)
    until(lambda: viewed.view.drawn.message.startswith("stale"))
    assert not scene._measured.visible
    assert not scene._estimated.visible
    assert viewed.view.drawn.measured is viewed.view.drawn.force is None
    viewed.supervisor.reset()
    until(lambda: scene._measured.visible)
    until(lambda: viewed.view.drawn.message == "")


def test_a_simulated_robot_that_cannot_follow_its_stages_causes_a_warning(viewed: Viewed) -> None:
    viewed.make_ready()
    # The load is larger than a request may set, so that the simulated robot has no stable shape.
    viewed.supervisor.lab.apply_load(ConstantLoad.model_construct(magnitude=1e6))
    try:
        until(lambda: any("cannot follow" in text for text in viewed.supervisor.status().warnings))
    finally:
        viewed.supervisor.lab.apply_load(NoLoad())
    # Other warnings may come and go meanwhile on a busy computer.
    until(lambda: not any("cannot follow" in text for text in viewed.supervisor.status().warnings))
