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
from enum import StrEnum
from typing import Annotated, Any, NamedTuple, Protocol

import numpy as np
from pydantic import Field

from core.calibration.rigid_transform import RigidTransform
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import ConfigError, Name, NotNegative, Row, Strict, check
from station.devices.cameras import ONE_CAMERA, CameraFile, measuring
from station.devices.config import Mount
from station.devices.interfaces import Condition, DeviceFault, Severity, TipReading
from station.devices.jump_gate import JumpGate
from station.devices.links.link import DatagramInbox, LinkError
from station.devices.projection import CameraView
from station.devices.stereo.sighting import Sighting, unpack
from station.devices.stereo.triangulation import triangulate

#: Time without a position after which a motion ends in HOLD [s]: ten frames of a camera with 30 Hz.
HOLD_AFTER_S = 0.34
#: Largest time from the second camera's newest frame to the extrapolated pixel, and largest time between two of its
#: frames for an interpolation or extrapolation, in frames.
MAX_AHEAD_FRAMES, MAX_GAP_FRAMES = 1.6, 3.5
#: Standard deviation of a pixel coordinate of the ball [pixel].
PIXEL_DEVIATION = 0.1
#: Largest standard deviation of a position in its most uncertain direction [m].
MAX_DEVIATION_M = 1e-3
#: Weight of a new value in the mean square of the residuals, and RMS from which on a warning is shown [pixel].
RESIDUAL_WEIGHT, WARN_PIXELS = 0.05, 1.0


class Problem(StrEnum):
    """Why the newest frames gave no position."""

    NONE = ""
    SILENT = "no frames arrive"
    HIDDEN = "the ball is not visible"
    APART = "the pictures of the two cameras are too far apart in time"
    DISAGREE = "the two cameras do not see the ball at the same place; was a camera moved? Calibrate the cameras again"
    UNCERTAIN = "the lines of sight of the two cameras are nearly parallel; move the cameras apart"
    JUMP = "the positions jumped; is something else of the ball's colour in the picture?"


class Inbox(Protocol):
    """Receiver of datagrams."""

    port: int  #: UDP port on this computer; 0 in memory

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

    time: float  #: by the loop's clock [s]
    at: Array  #: (2,) column and row


class Eye:
    """The newest frames of one camera."""

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._pixels: deque[Pixel] = deque(maxlen=4)
        self.newest = -math.inf  #: time of the newest frame, with or without a ball [s]
        self.visible_at = -math.inf  #: time of the newest frame with the ball [s]

    def add(self, time: float, pixel: Array | None) -> None:
        """Add a frame, with the pixel of the ball (2,) or without a ball."""
        if time <= self.newest:
            return  # frames of one camera arrive in their order, except after a restart of its process
        self.newest = time
        if pixel is None:
            self._pixels.clear()
            return
        self.visible_at = time
        self._pixels.append(Pixel(time, pixel))

    def at(self, time: float) -> Array | None:
        """Return the pixel (2,) at a time near the newest frames; None: no frames are near enough."""
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
            registration: pose of the cameras' world in the robot's; default: the same.
            latency: time by which the exposures are earlier than the cameras' settings say [s].
            max_residual: largest distance between a pixel and the computed position [pixel].
            stale_after: time without a position that is a HOLD; half of it is a WARN [s].
        """
        self._inbox, self._cameras, self._latency = inbox, cameras, latency
        self._views = {name: CameraView.of(*camera.view) for name, camera in cameras.items() if camera.view is not None}
        self._eyes = {name: Eye(camera.rate) for name, camera in cameras.items()}
        self._first, self._second = cameras
        self._registration = registration or RigidTransform(np.eye(3), np.zeros(3))
        self._max_residual, self._stale_after = max_residual, stale_after
        self._offset = math.inf  # loop's clock minus the station's clock [s]
        self._opened: float | None = None
        self._good_time, self._problem = -math.inf, Problem.SILENT
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

    def connect(self, now: float) -> None:
        """Nothing to do: the cameras' processes connect themselves."""
        self._opened = now if self._opened is None else self._opened

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
                continue
            # Both clocks are the computer's monotonic one. A datagram can be late but never early, so the smallest
            # difference is the best estimate of the constant offset.
            self._offset = min(self._offset, now - sighting.sent)
            reading = self._take(sighting, sighting.exposed + self._offset - self._latency, now) or reading
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
        severity = Severity.HOLD if self._lost or age > self._stale_after else Severity.WARN
        since = "" if math.isinf(age) else f", for {age:.2f} s"
        return DeviceFault(severity, f"the cameras do not track the tip{since}: {self._words(now)}", self._lost)

    def _words(self, now: float) -> str:
        """Return what is wrong and with which camera."""
        if self._lost:
            return "their messages cannot be received"
        for problem, times in (
            (Problem.SILENT, {name: eye.newest for name, eye in self._eyes.items()}),
            (Problem.HIDDEN, {name: eye.visible_at for name, eye in self._eyes.items()}),
        ):
            if late := [name for name, time in times.items() if now - time > 0.5 * self._stale_after]:
                return f"{problem} ({' and '.join(f'camera {name}' for name in late)})"
        return self._problem or "the positions are late"

    def details(self) -> Mapping[str, Any]:
        """Return cameras and counters."""
        return {
            "cameras": {name: camera.device for name, camera in self._cameras.items()},
            "residual_pixels": round(math.sqrt(self._residual_square), 3),
            "deviation_mm": round(1e3 * self._deviation, 4),
            **vars(self._counts),
        }

    def close(self) -> None:
        """Close the port."""
        self._inbox.close()

    def _take(self, sighting: Sighting, time: float, now: float) -> TipReading | None:
        """Process a frame of a camera; return a position if it is one of the first camera."""
        counts = self._counts
        counts.frames += 1
        if not now - 2.0 < time <= now + 1e-6:
            counts.malformed += 1
            return None
        pixel = np.array((sighting.column, sighting.row)) if sighting.visible else None
        self._eyes[sighting.camera].add(time, pixel)
        if pixel is None:
            counts.hidden += 1
            return None
        if sighting.camera != self._first or time <= self._good_time:
            return None
        other = self._eyes[self._second].at(time)
        if other is None:
            counts.unpaired += 1
            self._problem = Problem.APART
            return None
        return self._position(sighting.frame, time, np.stack((pixel, other)))

    def _position(self, frame: int, time: float, pixels: Array) -> TipReading | None:
        """Return the position of the ball from its pixels (2, 2) in both cameras, after the checks."""
        found = triangulate(list(self._views.values()), pixels)
        deviation = math.inf
        if found is not None:
            deviation = PIXEL_DEVIATION * math.sqrt(float(np.linalg.eigvalsh(found.covariance)[-1]))
        if found is None or deviation > MAX_DEVIATION_M:
            self._problem = Problem.UNCERTAIN
            return None
        self._residual_square += RESIDUAL_WEIGHT * (found.residual**2 - self._residual_square)
        self._deviation = deviation
        if found.residual > self._max_residual:
            self._counts.disagreements += 1
            self._problem = Problem.DISAGREE
            return None
        position = self._registration.apply(found.position)
        if not self._gate.passes(time, tuple((1e3 * position).tolist())):
            self._counts.jumps += 1
            self._problem = Problem.JUMP
            return None
        self._good_time, self._problem = time, Problem.NONE
        self._counts.positions += 1
        return TipReading(frame, time, position)


class StereoFile(Strict):
    """Two cameras that see a coloured ball at the tip, as a tracker."""

    cameras: Annotated[tuple[Name, ...], Row]
    """names of two cameras of this file's tables `[cameras.NAME]`, each with `lens` and `pose`"""
    latency: NotNegative = 0.0
    """time by which the exposures are earlier than the `latency` of the cameras says, from a calibration [s]"""
    max_residual: Annotated[float, Field(gt=0.0, le=50.0)] = 3.0
    """largest distance between the ball's pixel and the computed position, at most 50 [pixel]"""
    stale_after: Annotated[float, Field(ge=0.05, le=10.0)] = HOLD_AFTER_S
    """time without a position after which a motion ends in HOLD; half of it is a warning [s]"""
    mount: Mount = Mount()
    """pose of the cameras' world in the robot's, from a registration"""
    views: Mapping[Name, CameraFile] = {}
    """not for files: the station copies the tables of the cameras to this key"""


def stereo(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], StereoTracker]:  # noqa: ARG001
    """Return the opener of a tracker of two cameras; raises ConfigError."""
    key = "devices.tracker"
    file = check(StereoFile, options, key)
    if len(file.cameras) < 2:
        raise ConfigError(f"{key}.cameras = {list(file.cameras)}: {ONE_CAMERA}")
    if len(set(file.cameras)) != 2:
        raise ConfigError(f"{key}.cameras = {list(file.cameras)}: expected the names of two different cameras")
    for name in file.cameras:
        if name not in file.views:
            raise ConfigError(f"{key}.cameras: there is no table [cameras.{name}]; it has {', '.join(file.views)}")
        if file.views[name].view is None:
            raise ConfigError(
                f"{key}.cameras: cameras.{name} needs 'lens' and 'pose' to measure the tip:"
                " 'ctr-station cameras calibrate' finds both"
            )
    cameras = {name: file.views[name] for name in file.cameras}
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
    """Return the options of a tracker; those of a stereo tracker with the cameras' tables."""
    return {**options, "views": measuring(cameras)} if options["driver"] == "stereo" else options
