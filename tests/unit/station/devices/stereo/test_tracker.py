"""The driver of two cameras: positions from datagrams, their times, and human-readable faults."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.calibration.rigid_transform import RigidTransform
from core.robot.robot import Array
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.devices.cameras import CameraFile
from station.devices.interfaces import Severity
from station.devices.stereo.sighting import Sighting, pack
from station.devices.stereo.tracker import StereoTracker, stereo
from station.lab.wires import MemoryInbox
from tests.harness.stereo_rig import CAMERAS, PERIOD_S, Rig


def circle(time: float) -> Array:
    """Return a position on a circle of 10 mm with a period of 2 s, faster than a lab moves the tip."""
    turn = math.pi * time
    return 0.01 * np.array([math.cos(turn), math.sin(turn), 0.5 * math.sin(turn)])


def test_position_is_in_the_registered_frame_and_latency_moves_its_time() -> None:
    mount = RigidTransform(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.1, 0.2, 0.3]))
    plain, moved = (Rig(circle, **options).run(1.0) for options in ({}, {"registration": mount, "latency": 0.01}))

    for one, other in zip(plain, moved, strict=True):
        assert other.position == pytest.approx(mount.apply(one.position))
        assert other.time == pytest.approx(one.time - 0.01)


def test_dropped_frames_cost_little_accuracy() -> None:
    random = np.random.default_rng(1)
    rig = Rig(circle)
    rig.lost = lambda name, time: random.random() < 0.2

    readings = rig.run(10.0)

    errors = [np.linalg.norm(reading.position - circle(reading.time)) for reading in readings[5:]]
    assert len(readings) > 0.6 * 10.0 / PERIOD_S
    assert max(errors) < 5e-4  # a fifth of the frames is lost, at 31 mm/s and 0.1 m/s^2


@pytest.mark.parametrize("name", ["left", "right"])
def test_silent_camera_is_a_warning_then_a_hold_with_its_name(name: str) -> None:
    rig = Rig(circle)
    rig.lost = lambda camera, time: camera == name and time > 1.0

    rig.run(1.25)
    warning = rig.tracker.trouble(1.25)
    rig.run(1.6, start=1.25)
    hold = rig.tracker.trouble(1.6)

    assert warning is not None
    assert warning.severity is Severity.WARN
    assert hold is not None
    assert hold.severity is Severity.HOLD
    assert f"no frames arrive (camera {name})" in hold.text


def test_hidden_ball_is_reported_with_the_camera_and_returns() -> None:
    rig = Rig(circle)
    rig.hidden = lambda camera, time: camera == "right" and 1.0 < time < 2.0

    rig.run(1.9)
    fault = rig.tracker.trouble(1.9)
    rig.run(2.5, start=1.9)

    assert fault is not None
    assert "the ball is not visible (camera right)" in fault.text
    assert rig.tracker.trouble(2.5) is None


def test_several_balls_in_a_picture_are_a_hold_with_the_camera() -> None:
    rig = Rig(circle)
    rig.run(1.0)
    rig.shift["right"][:] = math.inf
    assert not rig.run(2.0, start=1.1)
    fault = rig.tracker.trouble(2.0)
    assert fault is not None
    assert fault.severity is Severity.HOLD
    assert fault.text.endswith("several balls of one colour are visible (camera right): cover the others")


def test_camera_that_sends_fewer_frames_than_its_rate_is_named_with_the_key() -> None:
    rig = Rig(circle)
    rig.lost = lambda name, time: name == "right" and rig.frames[name] % 5 != 0
    rig.run(5.0)
    fault = rig.tracker.trouble(5.0)
    assert fault is not None
    assert "camera right sends 6 frames/s, and its 'rate' is 30: give it more light, or set 'rate'" in fault.text


def test_datagrams_of_another_program_are_quoted_with_what_was_expected() -> None:
    inbox = MemoryInbox()
    tracker = StereoTracker(inbox, CAMERAS)
    inbox.put(b"HELLO")
    tracker.poll(1.0)
    assert "'HELLO' arrives, expected messages of camera left and camera right" in str(tracker.trouble(1.0))


def test_moved_camera_is_detected_because_the_lines_of_sight_miss_each_other() -> None:
    rig = Rig(circle)
    rig.run(1.0)
    rig.shift["left"] = np.array([0.0, 12.0])

    assert rig.run(1.6, start=1.0) == []
    fault = rig.tracker.trouble(1.6)
    assert fault is not None
    assert "was a camera moved, or are the two cameras exchanged?" in fault.text
    assert "busy" not in fault.text


@pytest.mark.parametrize("names", [("left",), ("right",), ("left", "right")])
def test_cameras_whose_pictures_are_processed_late_end_a_motion_with_the_delay_and_the_busy_computer(
    names: tuple[str, ...],
) -> None:
    rig = Rig(circle)
    rig.run(1.0)
    assert rig.tracker.trouble(1.0) is None
    rig.processing |= dict.fromkeys(names, 0.18)

    rig.run(3.0, start=1.0)
    fault = rig.tracker.trouble(3.0)
    assert fault is not None
    assert fault.severity is Severity.HOLD
    assert "this computer is too busy to find the ball" in fault.text
    for name in CAMERAS:
        assert (f"camera {name} takes 180 ms" in fault.text) == (name in names)


@given(st.lists(st.binary(max_size=120), max_size=20))
def test_poll_survives_any_datagrams(datagrams: list[bytes]) -> None:
    inbox = MemoryInbox()
    tracker = StereoTracker(inbox, CAMERAS)
    for data in datagrams:
        inbox.put(data)

    assert tracker.poll(1.0) is None
    assert tracker.details()["malformed"] == len(datagrams)


def test_sightings_of_other_cameras_and_of_other_times_give_no_position() -> None:
    inbox = MemoryInbox()
    tracker = StereoTracker(inbox, CAMERAS)
    inbox.put(pack(Sighting("top", 1, 1.0, 1.0, 640.0, 360.0)))
    inbox.put(pack(Sighting("left", 1, 1.0, 1.0, 640.0, 360.0)))
    inbox.put(pack(Sighting("left", 2, 100.0, 1.0, 640.0, 360.0)))  # exposed after it was sent

    assert tracker.poll(2.0) is None
    assert tracker.details()["malformed"] == 2


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"cameras": ("left",)}, r"one camera alone cannot track the tip.*several millimetres; add a second camera"),
        ({"cameras": ("left", "left")}, "two different cameras"),
        ({"cameras": ("left", "top")}, r"no table \[cameras.top\]; there are left, right"),
        ({"cameras": ("left", "right"), "max_residual": 0.0}, "max_residual"),
    ],
)
def test_unsuitable_cameras_are_refused_with_the_reason(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        stereo({**options, "views": CAMERAS}, load_robot("paper"))


def test_two_cameras_with_one_device_are_refused_with_both() -> None:
    views = {name: camera.model_copy(update={"device": "/dev/video0"}) for name, camera in CAMERAS.items()}
    with pytest.raises(ConfigError, match="left and right have the same device '/dev/video0'"):
        stereo({"cameras": ("left", "right"), "views": views}, load_robot("paper"))


def test_camera_without_a_calibration_is_refused_with_the_command() -> None:
    bare = {name: CameraFile(device=f"/dev/v4l/by-id/{name}") for name in CAMERAS}

    with pytest.raises(ConfigError, match=r"cameras.left needs 'lens' and 'pose'.*ctr-station cameras calibrate"):
        stereo({"cameras": ("left", "right"), "views": bare}, load_robot("paper"))
