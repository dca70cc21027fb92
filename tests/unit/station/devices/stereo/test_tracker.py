"""The driver of two cameras: positions from datagrams, their times, and faults in words."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.calibration.rigid_transform import RigidTransform
from core.robot.robot import Array
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.devices.cameras import CameraFile, LensFile
from station.devices.config import Mount
from station.devices.interfaces import Condition, Severity, TipReading
from station.devices.projection import CameraView, view_of
from station.devices.stereo.sighting import Sighting, pack
from station.devices.stereo.tracker import StereoTracker, stereo
from station.lab.wires import MemoryInbox

LENS = LensFile(focal=(1280.0, 1280.0), centre=(640.0, 360.0))
PERIOD_S, LATENCY_S = 1.0 / 30.0, 0.04
#: Station's clock minus the loop's clock [s].
CLOCK_OFFSET_S = 5000.0
CAMERAS = {
    "left": CameraFile(
        width=1280, height=720, lens=LENS, pose=Mount(position=(0, -0.5, 0), rotation_vector=(-math.pi / 2, 0, 0))
    ),
    "right": CameraFile(
        width=1280, height=720, lens=LENS, pose=Mount(position=(-0.5, 0, 0), rotation_vector=(0, math.pi / 2, 0))
    ),
}


def views() -> dict[str, CameraView]:
    return {name: view for name, camera in CAMERAS.items() if (view := view_of(camera)) is not None}


class Rig:
    """Two cameras that see a moving point; their frames are not synchronised."""

    def __init__(self, path: Callable[[float], Array], **options: Any) -> None:
        self.inbox = MemoryInbox()
        self.tracker = StereoTracker(self.inbox, CAMERAS, **options)
        self.tracker.connect(0.0)
        self.path, self.views = path, views()
        self.frames = dict.fromkeys(CAMERAS, 0)
        self.phases = {"left": 0.004, "right": 0.021}
        self.lost: Callable[[str, float], bool] = lambda name, time: False
        self.hidden: Callable[[str, float], bool] = lambda name, time: False
        self.shift = {"left": np.zeros(2), "right": np.zeros(2)}  #: added to the pixels

    def run(self, until: float, start: float = 0.0) -> list[TipReading]:
        """Poll the driver every 2 ms and return its readings."""
        readings: list[TipReading] = []
        due = {name: start + phase for name, phase in self.phases.items()}
        arrivals: list[tuple[float, bytes]] = []
        for now in np.arange(start, until, 0.002):
            for name, view in self.views.items():
                if now < due[name]:
                    continue
                time, due[name] = due[name], due[name] + PERIOD_S
                self.frames[name] += 1
                if self.lost(name, time):
                    continue
                pixel = view.project(self.path(time)[None])[0] + self.shift[name]
                if self.hidden(name, time):
                    pixel = np.full(2, math.nan)
                sent = time + LATENCY_S
                sighting = Sighting(name, self.frames[name], CLOCK_OFFSET_S + time, CLOCK_OFFSET_S + sent, *pixel)
                arrivals.append((sent, pack(sighting)))
            for arrival, data in [one for one in arrivals if one[0] <= now]:
                self.inbox.put(data)
                arrivals.remove((arrival, data))
            if (reading := self.tracker.poll(float(now))) is not None:
                readings.append(reading)
        return readings


def circle(time: float) -> Array:
    """Return a position on a circle of 10 mm with a period of 2 s, faster than a lab moves the tip."""
    turn = math.pi * time
    return 0.01 * np.array([math.cos(turn), math.sin(turn), 0.5 * math.sin(turn)])


def test_moving_point_is_measured_at_the_time_of_its_exposure() -> None:
    rig = Rig(circle)

    readings = rig.run(3.0)

    assert len(readings) == pytest.approx(3.0 / PERIOD_S, abs=5)
    assert rig.tracker.condition is Condition.CONNECTED
    # Datagrams wait up to 2 ms for the next poll, so the loop's clock is known within 2 ms: 0.06 mm at 31 mm/s.
    errors = [np.linalg.norm(reading.position - circle(reading.time)) for reading in readings[2:]]
    assert max(errors) < 2e-4
    frames = [reading.frame for reading in readings]
    assert frames == sorted(set(frames))
    assert rig.tracker.trouble(3.0) is None


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


def test_moved_camera_is_detected_because_the_lines_of_sight_miss_each_other() -> None:
    rig = Rig(circle)
    rig.run(1.0)
    rig.shift["left"] = np.array([0.0, 12.0])

    assert rig.run(1.6, start=1.0) == []
    fault = rig.tracker.trouble(1.6)
    assert fault is not None
    assert "was a camera moved?" in fault.text


def test_jump_of_the_ball_is_rejected_until_it_lasts() -> None:
    rig = Rig(lambda time: np.array([0.0, 0.0, 0.0 if not 1.0 < time < 1.1 else 0.06]))

    readings = rig.run(2.0)

    assert max(abs(reading.position[2]) for reading in readings) < 1e-3
    counts = rig.tracker.details()
    assert counts["jumps"] >= 1  # one camera sees the jump earlier than the other: their lines of sight miss
    assert counts["jumps"] + counts["disagreements"] >= 3


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
        ({"cameras": ("left", "top")}, r"no table \[cameras.top\]; it has left, right"),
        ({"cameras": ("left", "right"), "max_residual": 0.0}, "max_residual"),
    ],
)
def test_unsuitable_cameras_are_refused_with_the_reason(options: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        stereo({**options, "views": CAMERAS}, load_robot("paper"))


def test_camera_without_a_calibration_is_refused_with_the_command() -> None:
    bare = {name: CameraFile(device=f"/dev/v4l/by-id/{name}") for name in CAMERAS}

    with pytest.raises(ConfigError, match=r"cameras.left needs 'lens' and 'pose'.*ctr-station cameras calibrate"):
        stereo({"cameras": ("left", "right"), "views": bare}, load_robot("paper"))
