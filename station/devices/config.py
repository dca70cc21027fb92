"""The table `[devices]` of a station file: the driver of each device, and the driver's options.

```toml
[devices.stages]
driver = "zaber"
port = "/dev/ttyUSB0"

[devices.tracker]
driver = "aurora"
port = "/dev/ttyUSB1"

[devices.sensors]
driver = "netft"
tubes.inner.host = "192.168.1.11"
tubes.outer.host = "192.168.1.12"
```
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag

from core.robot.robot import Array, Base
from station.config.strict import ConfigError, Name, NotNegative, Positive, Row, Strict, Vector
from station.devices.ati.netft import NetftSettings
from station.devices.ati.protocol import RDT_PORT
from station.devices.aurora.dialogue import AuroraSettings
from station.devices.zaber.chain import LineSettings

#: pyserial's name of a port: /dev/ttyUSB0, COM3, socket://host:port.
Serial = Annotated[str, Field(min_length=1)]
TcpPort = Annotated[int, Field(ge=1, le=65535)]


def _names_a_driver(options: Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(options.get("driver"), str):
        raise ValueError("'driver' is missing: the name of a driver, in quotes")
    return options


#: Table of one device: `driver` names the driver, the other keys are the driver's options.
Options = Annotated[Mapping[str, Any], AfterValidator(_names_a_driver)]


class BenchFile(Strict):
    """The devices of a bench."""

    stages: Options
    """`driver` and the driver's options"""
    tracker: Options
    """`driver` and the driver's options"""
    sensors: Options
    """`driver` and the driver's options"""

    @property
    def can_measure_target(self) -> bool:
        """Whether the tracker may measure a target: true for an Aurora with a second coil and for custom drivers."""
        return self.tracker["driver"] != "aurora" or bool(self.tracker.get("target"))


def _is_either(value: object) -> object:
    if value != "virtual" and not isinstance(value, Mapping | BenchFile):
        raise ValueError("expected 'virtual', or tables of stages, tracker and sensors")
    return value


#: Value of `devices` in a station file: "virtual" for the virtual lab, or the tables of a bench.
DevicesFile = Annotated[
    Annotated[Literal["virtual"], Tag("virtual")] | Annotated[BenchFile, Tag("bench")],
    Discriminator(lambda value: "virtual" if value == "virtual" else "bench"),
    BeforeValidator(_is_either),
]


class Mount(Strict):
    """Pose of a device's frame in another frame."""

    position: Vector = (0.0, 0.0, 0.0)
    """position of the device frame's origin [m]"""
    rotation_vector: Vector = (0.0, 0.0, 0.0)
    """orientation of the device's frame: rotation axis times angle [rad]"""

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3) from the axes of the device's frame to those of the other frame."""
        return Base(self.position, self.rotation_vector).rotation


class StageFile(Strict):
    """One Zaber unit."""

    port: Serial | None = None
    """port of this stage alone; default: the chain's port"""
    device: Annotated[int, Field(ge=1, le=254)]
    """device number of the unit on the chain"""
    home_at: float | None = None
    """joint position at the home sensor [rad or m]; default: 0 for a rotation, and for a translation the end of the
    travel at which the unit counts 0"""
    backwards: bool = False
    """whether the unit's count increases when the joint's position decreases"""
    home_speed: Positive | None = None
    """speed of homing [rad/s or m/s]; default: a quarter of the joint's speed"""
    device_id: Annotated[int, Field(ge=0)] | None = None
    """device id that the unit must report"""
    serial: Annotated[int, Field(ge=0)] | None = None
    """serial number that the unit must report"""


class ZaberFile(Strict):
    """Zaber T-series stages on one chain, or with a separate port for each stage."""

    port: Serial | None = None
    """port of the chain"""
    joints: Mapping[Name, StageFile] = {}
    """the unit of each joint; default: device numbers 1, 2, ... in the order of the robot's joints"""
    deadline: Annotated[float, Field(ge=0.02, le=10.0)] = LineSettings.deadline
    """longest time from the start of a request to its reply [s]; a stage is lost after two missing replies in a row"""


class AuroraFile(Strict):
    """NDI Aurora tracker."""

    port: Serial
    """serial port of the tracker"""
    tool: str = ""
    """serial number of the coil at the tip, as the tracker reports it; "": the first tool"""
    target: str = ""
    """serial number of a second coil, on the target of the motion `follow`; "": no second coil"""
    baud: int = AuroraSettings.baud
    """baud rate to which the driver switches; the tracker must support this rate [bit/s]"""
    frame_rate: Annotated[float, Field(gt=0.0, le=1000.0)] = AuroraSettings.frame_rate
    """number of frames that the tracker measures per second [1/s]"""
    latency: NotNegative = AuroraSettings.latency
    """shortest time from a measurement to the arrival of the reply with this measurement at 115200 baud [s]"""
    always_tx: bool = False
    """request frames as text (TX), for very old firmware"""
    fault_bits: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """port status bits that invalidate a measurement, in addition to the two out-of-volume bits"""
    mount: Mount = Mount()
    """pose of the field generator in the world, from a registration"""
    coil_to_tip: float = 0.0
    """distance from the coil to the robot's tip along the coil's axis [m]"""


class ForceBoxFile(Strict):
    """One ATI Net F/T box."""

    host: Annotated[str, Field(min_length=1)]
    """host name or IP address of the box"""
    rdt_port: TcpPort = RDT_PORT
    """UDP port of its datagrams"""
    http_port: TcpPort = 80
    """TCP port of its configuration page"""
    serial: str | None = None
    """serial number of the calibration that the box must report; default: any"""
    mount: Mount = Mount()
    """pose of the sensor's frame in the frame at its tube's proximal end (x along alpha = 0, z along the tube)"""


class NetftFile(Strict):
    """ATI Net F/T boxes, one for each tube."""

    tubes: Mapping[Name, ForceBoxFile]
    stale_after: Positive = NetftSettings.stale_after
    """time without a usable record after which a sensor counts as stale [s]"""
    latency: NotNegative = NetftSettings.latency
    """time from a measurement until the box sends its record [s]"""
    ranges: Annotated[tuple[Positive, Positive, Positive, Positive, Positive, Positive], Row] = NetftSettings.ranges  # pyright: ignore[reportAssignmentType] - six numbers
    """calibrated ranges of Fx Fy Fz Tx Ty Tz, used if the box's configuration page has none [N, N m]"""


class CardFile(Strict):
    """One ATI sensor on an NI card."""

    channels: Annotated[str, Field(min_length=1)]
    """six differential inputs in the order of the gauges, as NI names them: Dev1/ai0:5"""
    calibration: str
    """path of ATI's .cal file for this sensor"""
    serial: str | None = None
    """serial number of the sensor that the .cal file must contain; default: any"""
    mount: Mount = Mount()
    """pose of the sensor's frame in the frame at its tube's proximal end (x along alpha = 0, z along the tube)"""


class NidaqFile(Strict):
    """ATI sensors on NI cards, one for each tube."""

    tubes: Mapping[Name, CardFile]
    rate: Annotated[float, Field(ge=100.0, le=100_000.0)] = 5000.0
    """sampling rate of each input [1/s]"""
    stale_after: Positive = 0.05
    """time without a usable sample after which a sensor counts as stale [s]"""


Part = TypeVar("Part")


def in_order(parts: Mapping[str, Part], names: Sequence[str], key: str) -> list[Part]:
    """Return the parts, which are joints' or tubes' tables by name, in the robot's order `names`.

    Raises:
        ConfigError: a part is missing, or the robot has no part of that name.
    """
    for name in parts:
        if name not in names:
            raise ConfigError(f"{key}.{name}: the robot has no such part; it has {', '.join(names)}")
    for name in names:
        if name not in parts:
            raise ConfigError(f"{key}.{name} is missing")
    return [parts[name] for name in names]
