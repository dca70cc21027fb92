"""Driver of a tracker that consists of two cameras, which see a coloured ball at the robot's tip.

The cameras' processes find the ball in their frames and send its pixels as datagrams. The driver computes the position
of the ball from the pixels of both cameras at the same time. The frames of the two cameras are not synchronised:
the position is computed for each frame of the first camera, and the pixel of the second camera is interpolated or
extrapolated to the time of that frame.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from pydantic import Field

from core.calibration.rigid_transform import RigidTransform
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import MAX_SILENCE_S, ConfigError, Latency, Name, Row, Strict, check
from station.devices.cameras import ONE_CAMERA, CameraFile, measuring
from station.devices.config import Mount, twins
from station.devices.interfaces import Condition, DeviceFault, Severity, TipReading
from station.devices.jump_gate import JumpGate
from station.devices.kernel.quality import Quality, Sampled, quoted, sample_fault
from station.devices.kernel.sampled import SampleClock
from station.devices.links.link import DatagramInbox, LinkError
from station.devices.projection import CameraView
from station.devices.stereo.sighting import Sighting, unpack
from station.devices.stereo.triangulation import triangulate

#: Time without a position after which a motion ends in HOLD [s]: ten frames of a camera with 30 Hz.
HOLD_AFTER_S = 0.34
#: Limits for the interpolated or extrapolated pixel of the second camera: largest time after its newest frame, and
#: largest time between the two frames that are used [periods of its frames].
MAX_AHEAD_FRAMES, MAX_GAP_FRAMES = 1.6, 3.5
#: Standard deviation of a pixel coordinate of the ball [pixel].
PIXEL_DEVIATION = 0.1
#: Largest standard deviation of a position in its most uncertain direction [m].
MAX_DEVIATION_M = 1e-3
#: Number of newest frames whose processing times count, and their largest median [periods of the frames]. Slower
#: processing skips frames. Then the frames of the two cameras are too far apart in time, or a position is too old.
PROCESSED_FRAMES, MAX_PROCESSING_FRAMES = 9, 1.5
#: Weight of a new value in the moving mean square of the residuals, and their smallest RMS that is a WARN [pixel].
RESIDUAL_WEIGHT, WARN_PIXELS = 0.05, 1.0


#: Why the newest frames gave no position.
APART = "the pictures of the two cameras are too far apart in time"
DISAGREE = (
    "the two cameras do not see the ball at the same place; was a camera moved, or are the two cameras exchanged?"
    " Calibrate the cameras again"
)
UNCERTAIN = "the lines of sight of the two cameras are nearly parallel; move the cameras apart"
JUMP = "the positions jumped; is something else of the ball's colour in the picture?"


class Inbox(Protocol):
    """Receiver of datagrams."""

    port: int  #: UDP port on this computer; 0 for a receiver in memory

    def receive(self) -> list[bytes]:
        """Return the datagrams that have arrived."""
        ...

    def close(self) -> None:
        """Close the receiver."""
        ...


@dataclass
class Counts:
    """Counters since the driver was opened."""

    frames: int = 0  #: frames of both cameras
    positions: int = 0  #: computed positions
    hidden: int = 0  #: frames without a visible ball
    unpaired: int = 0  #: frames of the first camera without a frame of the second one
    disagreements: int = 0  #: pairs whose lines of sight do not meet
    jumps: int = 0  #: positions that the ball cannot have reached
    malformed: int = 0  #: datagrams that are damaged or of other cameras


class Pixel(NamedTuple):
    """Pixel of the ball in one frame."""

    time: float  #: time of the frame, by the loop's clock [s]
    at: Array  #: (2,) column and row


class Eye:
    """The newest frames of one camera."""

    def __init__(self, camera: CameraFile) -> None:
        self._period, self._latency = 1.0 / camera.rate, camera.latency
        self._pixels: deque[Pixel] = deque(maxlen=4)
        self._processing: deque[float] = deque(maxlen=PROCESSED_FRAMES)
        self.newest = -math.inf  #: time of the newest frame, with or without a ball [s]
        self.visible_at = -math.inf  #: time of the newest frame with the ball [s]
        self.ambiguous = False  #: whether the newest frame shows several balls
        self._configured, self._times = camera.rate, deque[float](maxlen=PROCESSED_FRAMES)

    @property
    def processing(self) -> float:
        """Median time from the arrival of a frame until the ball is found in it [s]; 0 before the first frame."""
        return sorted(self._processing)[len(self._processing) // 2] if self._processing else 0.0

    @property
    def wrong_rate(self) -> str:
        """Text that states that the frames are too far apart for an interpolation; empty if they are not."""
        if len(times := self._times) < PROCESSED_FRAMES:
            return ""
        period = (times[-1] - times[0]) / (len(times) - 1)
        if period <= MAX_GAP_FRAMES * self._period:
            return ""
        return f"sends {1.0 / period:.3g} frames/s, and its 'rate' is {self._configured:g}"

    @property
    def busy(self) -> bool:
        """Whether the computer takes too long to find the ball in the frames."""
        return self.processing > MAX_PROCESSING_FRAMES * self._period

    def add(self, time: float, pixel: Array | None, delay: float) -> None:
        """Add a frame, with the pixel of the ball (2,) or without a ball, sent `delay` after its exposure [s]."""
        if time <= self.newest:
            return  # frames of one camera arrive in their order, except after a restart of its process
        self.newest = time
        self._times.append(time)
        self._processing.append(delay - self._latency)
        if pixel is None:
            self._pixels.clear()
            return
        self.visible_at = time
        self._pixels.append(Pixel(time, pixel))

    def at(self, time: float) -> Array | None:
        """Return the ball's pixel (2,) at a time near the newest frames; None: no frames are near enough."""
        if len(self._pixels) < 2:
            return None
        after = next((i for i, pixel in enumerate(self._pixels) if pixel.time >= time), len(self._pixels) - 1)
        first, second = self._pixels[max(after, 1) - 1], self._pixels[max(after, 1)]
        gap = second.time - first.time
        ahead = max(time - second.time, first.time - time)
        if gap > MAX_GAP_FRAMES * self._period or ahead > MAX_AHEAD_FRAMES * self._period:
            return None
        return first.at + (time - first.time) / gap * (second.at - first.at)


class StereoTracker:
    """Driver of two cameras as a tracker; implements `Tracker`. `poll` never raises, whatever datagrams arrive."""

    def __init__(
        self,
        inbox: Inbox,
        cameras: Mapping[str, CameraFile],
        registration: RigidTransform | None = None,
        *,
        latency: float = 0.0,
        max_residual: float = 3.0,
        stale_after: float = HOLD_AFTER_S,
    ) -> None:
        """Create the driver.

        Args:
            inbox: receives the datagrams of the cameras' processes.
            cameras: two cameras with a lens and a pose, by name.
            registration: pose of the cameras' world frame in the robot's world frame; default: both are the same.
            latency: delay of the frames in addition to the `latency` of the cameras [s].
            max_residual: largest distance between a pixel and the computed position [pixel].
            stale_after: time without a position that is a HOLD; half of it is a WARN [s].
        """
        self._inbox, self._cameras = inbox, cameras
        self._views = {name: CameraView.of(*camera.view) for name, camera in cameras.items() if camera.view is not None}
        self._eyes = {name: Eye(camera) for name, camera in cameras.items()}
        self._first, self._second = cameras
        self._registration = registration or RigidTransform(np.eye(3), np.zeros(3))
        self._max_residual, self._stale_after = max_residual, stale_after
        # Driver and cameras' processes use the computer's monotonic clock, so their times do not drift apart.
        self._clock = SampleClock(1.0, 0.0, latency)
        self._good_time, self._problem = -math.inf, ""
        self._quality = Quality.SILENT  # of the newest frames
        self._unread = b""  # the newest datagram, if it is not a message of one of the two cameras
        self._gate, self._counts = JumpGate(), Counts()
        self._residual_square = self._deviation = 0.0
        self._lost = ""

    @property
    def port(self) -> int:
        """UDP port to which the cameras' processes send."""
        return self._inbox.port

    @property
    def condition(self) -> Condition:
        """CONNECTED after the first position; `trouble` reports later faults."""
        if self._lost:
            return Condition.FAULT
        return Condition.CONNECTED if self._good_time > -math.inf else Condition.CONNECTING

    def connect(self, now: float) -> None:  # noqa: ARG002 - the cameras' processes connect themselves
        """Receive datagrams again after the port was lost."""
        self._lost = ""

    def poll(self, now: float) -> TipReading | None:
        """Return the newest position that was computed since the last poll, or None."""
        if self._lost:
            return None
        try:
            datagrams = self._inbox.receive()
        except LinkError as error:
            self._lost = str(error)
            return None
        reading = None
        for datagram in datagrams:
            sighting = unpack(datagram)
            if sighting is None or sighting.camera not in self._eyes:
                self._counts.malformed += 1
                self._unread = datagram
                continue
            self._unread = b""
            self._clock.observe(sighting.sent, now)
            reading = self._take(sighting, self._clock.time(sighting.exposed), now) or reading
        return reading

    def trouble(self, now: float) -> DeviceFault | None:
        """Return a WARN if positions are late or if the cameras disagree, and a HOLD after `stale_after`."""
        age = now - self._good_time
        if age <= 0.5 * self._stale_after and not self._lost:
            apart = math.sqrt(self._residual_square)
            if apart < WARN_PIXELS:
                return None
            text = f"the lines of sight of the two cameras miss each other by {apart:.1f} pixels: calibrate the cameras"
            return DeviceFault(Severity.WARN, text)
        quality, reason = self._reason(now)
        busy = [f"camera {name} takes {1e3 * eye.processing:.0f} ms" for name, eye in self._eyes.items() if eye.busy]
        if busy and not self._lost:
            reason += (
                f"; this computer is too busy to find the ball in each picture in time ({' and '.join(busy)},"
                " usually less than 20 ms): close other programs, or reduce 'width' and 'height' of the camera"
            )
        because = f"do not track the tip{{since}}: {reason}"
        return sample_fault([Sampled("the cameras", quality, age, self._lost, because)], self._stale_after)

    def _reason(self, now: float) -> tuple[Quality, str]:
        """Return the quality of the newest frames, and why they give no position, with the camera's name."""
        if self._lost:
            return Quality.LOST, "their messages cannot be received"
        slow = " and ".join(f"camera {name} {eye.wrong_rate}" for name, eye in self._eyes.items() if eye.wrong_rate)
        if slow and all(now - eye.newest <= self._stale_after for eye in self._eyes.values()):
            return Quality.WRONG_RATE, f"{slow}: give it more light, or set 'rate'"
        for quality, problem, times in (
            (Quality.SILENT, "no frames arrive", {name: eye.newest for name, eye in self._eyes.items()}),
            (Quality.MISSING, "the ball is not visible", {name: eye.visible_at for name, eye in self._eyes.items()}),
        ):
            late = [f"camera {name}" for name, time in times.items() if now - time > 0.5 * self._stale_after]
            if late and quality is Quality.SILENT and self._unread:
                return Quality.UNREADABLE, f"{quoted(self._unread)} arrives, expected messages of {' and '.join(late)}"
            crowded = [f"camera {name}" for name, eye in self._eyes.items() if eye.ambiguous]
            if late and quality is Quality.MISSING and crowded:
                return quality, f"several balls of one colour are visible ({' and '.join(crowded)}): cover the others"
            if late:
                return quality, f"{problem} ({' and '.join(late)})"
        return self._quality, self._problem or "the positions are late"

    def details(self) -> Mapping[str, Any]:
        """Return cameras and counters."""
        return {
            "cameras": {name: camera.device for name, camera in self._cameras.items()},
            "residual_pixels": round(math.sqrt(self._residual_square), 3),
            "deviation_mm": round(1e3 * self._deviation, 4),
            "processing_ms": {name: round(1e3 * eye.processing, 1) for name, eye in self._eyes.items()},
            **vars(self._counts),
        }

    def close(self) -> None:
        """Close the port."""
        self._inbox.close()

    def _take(self, sighting: Sighting, time: float, now: float) -> TipReading | None:
        """Process a frame of a camera; return the ball's position if the frame is one of the first camera."""
        counts = self._counts
        counts.frames += 1
        if not now - 2.0 < time <= now + 1e-6:
            counts.malformed += 1
            return None
        pixel = np.array((sighting.column, sighting.row)) if sighting.visible else None
        self._eyes[sighting.camera].ambiguous = sighting.ambiguous
        self._eyes[sighting.camera].add(time, pixel, sighting.sent - sighting.exposed)
        if pixel is None:
            counts.hidden += 1
            return None
        if sighting.camera != self._first or time <= self._good_time:
            return None
        other = self._eyes[self._second].at(time)
        if other is None:
            counts.unpaired += 1
            self._quality, self._problem = Quality.STALE, APART
            return None
        return self._position(sighting.frame, time, np.stack((pixel, other)))

    def _position(self, frame: int, time: float, pixels: Array) -> TipReading | None:
        """Return the position of the ball from its pixels (2, 2) in both cameras, after the checks."""
        found = triangulate(list(self._views.values()), pixels)
        deviation = math.inf
        if found is not None:
            deviation = PIXEL_DEVIATION * math.sqrt(float(np.linalg.eigvalsh(found.covariance)[-1]))
        if found is None or deviation > MAX_DEVIATION_M:
            self._quality, self._problem = Quality.DISAGREEING, UNCERTAIN
            return None
        self._residual_square += RESIDUAL_WEIGHT * (found.residual**2 - self._residual_square)
        self._deviation = deviation
        if found.residual > self._max_residual:
            self._counts.disagreements += 1
            self._quality, self._problem = Quality.DISAGREEING, DISAGREE
            return None
        position = self._registration.apply(found.position)
        if not self._gate.passes(time, tuple((1e3 * position).tolist())):
            self._counts.jumps += 1
            self._quality, self._problem = Quality.JUMP, JUMP
            return None
        self._good_time, self._quality, self._problem = time, Quality.GOOD, ""
        self._counts.positions += 1
        return TipReading(frame, time, position)


class StereoFile(Strict):
    """Two cameras that see a coloured ball at the tip, as a tracker."""

    cameras: Annotated[tuple[Name, ...], Row]
    """names of two cameras of this file's tables `[cameras.NAME]`, each with `lens` and `pose`"""
    latency: Latency = 0.0
    """delay of the frames in addition to the `latency` of the cameras, from a calibration [s]"""
    max_residual: Annotated[float, Field(gt=0.0, le=50.0)] = 3.0
    """largest distance between the ball's pixel and the computed position, at most 50 [pixel]"""
    stale_after: Annotated[float, Field(ge=0.05, le=MAX_SILENCE_S)] = HOLD_AFTER_S
    """time without a position after which a motion ends in HOLD; half of it is a warning [s]"""
    mount: Mount = Mount()
    """pose of the cameras' world frame in the robot's world frame, from a registration"""
    views: Mapping[Name, CameraFile] = {}
    """do not write this key in a file: the station copies the tables of the cameras to it"""


def stereo(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], StereoTracker]:  # noqa: ARG001
    """Check the options, and return the function that opens a tracker of two cameras; raises ConfigError."""
    key = "devices.tracker"
    file = check(StereoFile, options, key)
    if len(file.cameras) < 2:
        raise ConfigError(f"{key}.cameras = {list(file.cameras)}: {ONE_CAMERA}")
    if len(set(file.cameras)) != 2:
        raise ConfigError(f"{key}.cameras = {list(file.cameras)}: expected the names of two different cameras")
    for name in file.cameras:
        if name not in file.views:
            raise ConfigError(f"{key}.cameras: there is no table [cameras.{name}]; there are {', '.join(file.views)}")
        if file.views[name].view is None:
            raise ConfigError(
                f"{key}.cameras: cameras.{name} needs 'lens' and 'pose' to measure the tip:"
                " 'ctr-station cameras calibrate' finds both"
            )
    cameras = {name: file.views[name] for name in file.cameras}
    if same := twins({name: None if camera.simulated else camera.device for name, camera in cameras.items()}):
        raise ConfigError(
            f"{key}.cameras: {' and '.join(same)} have the same device '{cameras[same[0]].device}'; give each its own"
        )
    registration = RigidTransform(file.mount.rotation, np.array(file.mount.position))
    return lambda: StereoTracker(
        DatagramInbox(),
        cameras,
        registration,
        latency=file.latency,
        max_residual=file.max_residual,
        stale_after=file.stale_after,
    )


def with_views(options: Mapping[str, Any], cameras: Mapping[str, CameraFile]) -> Mapping[str, Any]:
    """Return the options of a tracker; to those of a stereo tracker the tables of the cameras are added."""
    return {**options, "views": measuring(cameras)} if options["driver"] == "stereo" else options
