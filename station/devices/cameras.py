"""The tables `[cameras.NAME]` of a station file, and the check that the extra `camera` is installed."""

import importlib.util
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from station.config.strict import ConfigError, Latency, Name, Row, Strict, Vector
from station.devices.config import Mount

#: Value of `device` for a camera that the virtual lab simulates.
SIMULATED = "simulated"
#: Python modules of the extra `camera`.
MODULES = ("cv2", "av")
#: Largest number of cameras of a station; each uses a process.
MAX_CAMERAS = 4
#: Error text: why a single camera is not a tracker.
ONE_CAMERA = (
    "one camera alone cannot track the tip: the distance of the tip from the camera would be uncertain by several"
    " millimetres; add a second camera"
)
#: Largest number of bits that a video uses for a pixel of a frame.
VIDEO_BITS_PER_PIXEL = 0.15

Pixels = Annotated[float, Field(gt=0.0, le=1e5)]
#: Columns or rows of a frame.
FrameSize = Annotated[int, Field(ge=64, le=4096, multiple_of=2)]
#: Bounds of the distortion coefficients. Long lenses have large ones, because their normalised radius is small.
Radial2 = Annotated[float, Field(ge=-5.0, le=5.0)]
Radial4 = Annotated[float, Field(ge=-100.0, le=100.0)]
Radial6 = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Tangential = Annotated[float, Field(ge=-0.5, le=0.5)]


class LensFile(Strict):
    """Lens of a camera, in OpenCV's model: pinhole with radial and tangential distortion."""

    focal: Annotated[tuple[Pixels, Pixels], Row]
    """focal lengths along the rows and along the columns, above 0 [pixel]"""
    centre: Annotated[tuple[Pixels, Pixels], Row]
    """point of the picture on the optical axis: column and row, above 0 [pixel]"""
    distortion: Annotated[tuple[Radial2, Radial4, Tangential, Tangential, Radial6], Row] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 of OpenCV; their magnitudes are at most 5, 100, 0.5, 0.5 and 1000 [-]"""


class SimulationFile(Strict):
    """Errors of a simulated camera, compared with an ideal one; the station does not know these values."""

    noise: Annotated[float, Field(ge=0.0, le=50.0)] = 2.0
    """standard deviation of the noise of a pixel, of 255 grey levels [level]"""
    latency: Latency = 0.040
    """time from the exposure to the arrival of a frame, at most 1 [s]"""
    dropped: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """fraction of the frames that do not arrive, at most 1 [-]"""
    ball: Annotated[float, Field(ge=0.0, le=0.02)] = 0.003
    """diameter of the ball at the tip, at most 0.02; 0: no ball [m]"""
    focal_error: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0
    """relative difference of the true focal lengths from those of `lens`, at most 0.1 [-]"""
    position_error: Vector = (0.0, 0.0, 0.0)
    """difference of the true position from that of `pose`, in the world [m]"""
    rotation_error: Vector = (0.0, 0.0, 0.0)
    """rotation from the camera's frame at its true pose to that at `pose`: axis times angle [rad]"""


class CameraFile(Strict):
    """A camera that views the robot."""

    device: Annotated[str, Field(min_length=1, max_length=200)] = SIMULATED
    """`simulated`: the virtual lab renders the frames; otherwise the stable path of a USB camera, which `ls
    /dev/v4l/by-id` lists, or of a video file"""
    width: FrameSize = 640
    """columns of a frame, an even number"""
    height: FrameSize = 480
    """rows of a frame, an even number"""
    rate: Annotated[float, Field(ge=1.0, le=120.0)] = 30.0
    """frames per second, at most 120 [1/s]"""
    latency: Latency = 0.040
    """time from the exposure to the arrival of a frame, which the station subtracts, at most 1 [s]"""
    lens: LensFile | None = None
    """result of a calibration of the lens. A USB camera without `lens` shows no overlay; a simulated camera has by
    default a focal length of one picture width and no distortion"""
    pose: Mount | None = None
    """pose of the camera in the world: its x axis is along the rows, its y axis along the columns, and its z axis
    points at the robot. A USB camera without `pose` shows no overlay; a simulated one is 0.4 m from the robot"""
    ball: Literal["green", "red", "blue"] = "green"
    """colour of the ball at the tip, if the camera tracks the tip"""
    simulation: SimulationFile | None = None
    """noise, latency and losses of a simulated camera"""

    @model_validator(mode="after")
    def _simulation_of_a_simulated_camera(self) -> Self:
        if self.simulation is not None and not self.simulated:
            raise ValueError(f"the table simulation needs device = '{SIMULATED}'; remove it for a real camera")
        return self

    @property
    def simulated(self) -> bool:
        """Whether the virtual lab renders the frames."""
        return self.device == SIMULATED

    @property
    def view(self) -> tuple[LensFile, Mount] | None:
        """Lens and pose; None if they are not known."""
        if self.simulated:
            default = LensFile(focal=(self.width, self.width), centre=(0.5 * self.width, 0.5 * self.height))
            return self.lens or default, self.pose or SIDE_POSE
        return None if self.lens is None or self.pose is None else (self.lens, self.pose)

    @property
    def video_bit_rate(self) -> float:
        """Largest bit rate of the camera's video [bit/s]."""
        return VIDEO_BITS_PER_PIXEL * self.width * self.height * self.rate


#: Each component of the rotation vector of a third of a turn about (1, 1, 1) [rad].
_THIRD_TURN = 2.0 * math.pi / math.sqrt(27.0)
#: Default pose of a simulated camera: its optical axis is along the world's y; its picture has z to the right, x down.
SIDE_POSE = Mount(position=(0.02, -0.4, 0.13), rotation_vector=(-_THIRD_TURN, -_THIRD_TURN, -_THIRD_TURN))

CamerasFile = Annotated[Mapping[Name, CameraFile], Field(max_length=MAX_CAMERAS)]


class CalibratedView(Strict):
    """Calibrated lens and pose of a camera."""

    lens: LensFile
    """lens of the camera"""
    pose: Mount
    """pose of the camera in the world"""


def measuring(
    cameras: Mapping[str, CameraFile], calibrated: Mapping[str, CalibratedView] = MappingProxyType({})
) -> dict[str, CameraFile]:
    """Return the cameras as a driver may know them: with calibrated lenses and poses, and without simulated errors."""
    return {
        name: camera.model_copy(
            update={"simulation": None}
            | ({"lens": calibrated[name].lens, "pose": calibrated[name].pose} if name in calibrated else {})
        )
        for name, camera in cameras.items()
    }


def check_cameras(cameras: Mapping[str, CameraFile], *, virtual: bool) -> None:
    """Check that the cameras can be opened on a station with a virtual lab (`virtual`) or with real devices.

    Raises:
        ConfigError: the extra `camera` is not installed, or a simulated camera has no virtual lab.
    """
    for name, camera in cameras.items():
        if missing := [module for module in MODULES if importlib.util.find_spec(module) is None]:
            raise ConfigError(
                f"cameras.{name}: cameras need the extra 'camera', but the module '{missing[0]}' is not installed:"
                " pip install 'ctr-station[camera]'"
            )
        if camera.simulated and not virtual:
            raise ConfigError(
                f"cameras.{name}.device = '{SIMULATED}': real devices have no simulated camera;"
                " give the path of a USB camera from /dev/v4l/by-id"
            )
