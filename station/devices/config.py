"""The `[devices]` part of a station file: the driver of each device, and the driver's options.

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
from station.devices.aurora.settings import AuroraSettings
from station.devices.netft.protocol import RDT_PORT
from station.devices.netft.sensors import NetftSettings
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
        """Whether frames may have a target's position: those of an Aurora with a second coil, or of a custom driver."""
        return self.tracker["driver"] != "aurora" or bool(self.tracker.get("target"))


def _is_either(value: object) -> object:
    if value != "virtual" and not isinstance(value, Mapping | BenchFile):
        raise ValueError("expected 'virtual', or tables of stages, tracker and sensors")
    return value


#: The virtual lab, or a bench.
DevicesFile = Annotated[
    Annotated[Literal["virtual"], Tag("virtual")] | Annotated[BenchFile, Tag("bench")],
    Discriminator(lambda value: "virtual" if value == "virtual" else "bench"),
    BeforeValidator(_is_either),
]


class Mount(Strict):
    """Pose of a device's frame in another frame."""

    position: Vector = (0.0, 0.0, 0.0)
    """position of its origin [m]"""
    rotation_vector: Vector = (0.0, 0.0, 0.0)
    """axis times angle [rad]"""

    @property
    def rotation(self) -> Array:
        """Rotation matrix (3, 3) from its axes to those of the other frame."""
        return Base(self.position, self.rotation_vector).rotation


class StageFile(Strict):
    """One Zaber unit."""

    port: Serial | None = None
    """port of this stage alone; default: the chain's port"""
    device: Annotated[int, Field(ge=1, le=254)]
    """its number on the chain"""
    home_at: float | None = None
    """joint position at its home sensor; default: 0 of a rotation, the end where a translation counts 0 [rad or m]"""
    backwards: bool = False
    """its count increases when the joint's position decreases"""
    home_speed: Positive | None = None
    """default: a quarter of the joint's speed [rad/s or m/s]"""
    device_id: Annotated[int, Field(ge=0)] | None = None
    """device id that the unit must report"""
    serial: Annotated[int, Field(ge=0)] | None = None
    """serial number that the unit must report"""


class ZaberFile(Strict):
    """Zaber T-series stages: one chain, or a port for each."""

    port: Serial | None = None
    """of the chain"""
    joints: Mapping[Name, StageFile] = {}
    """the unit of each joint; default: numbered from the computer in the robot's order"""
    deadline: Annotated[float, Field(ge=0.02, le=10.0)] = LineSettings.deadline
    """for a reply, from the start of its request; a stage without two replies in a row is lost [s]"""


class AuroraFile(Strict):
    """NDI Aurora."""

    port: Serial
    tool: str = ""
    """serial number of the tip's coil, as the unit reports it; "": the first tool"""
    target: str = ""
    """serial number of a second coil, on the target of the motion `follow`; "": no second coil"""
    baud: int = AuroraSettings.baud
    """rate to switch to; must be supported by the unit [bit/s]"""
    frame_rate: Annotated[float, Field(gt=0.0, le=1000.0)] = AuroraSettings.frame_rate
    """[1/s]"""
    latency: NotNegative = AuroraSettings.latency
    """shortest time from a measurement to the arrival of its reply at 115200 baud [s]"""
    always_tx: bool = False
    """request frames as text, for very old firmware"""
    fault_bits: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """port status bits that invalidate a measurement, in addition to those of the volume"""
    mount: Mount = Mount()
    """pose of the field generator in the world, from a registration"""
    coil_to_tip: float = 0.0
    """distance from the coil to the robot's tip along the coil's axis [m]"""


class ForceBoxFile(Strict):
    """One ATI Net F/T box."""

    host: Annotated[str, Field(min_length=1)]
    """name or address"""
    rdt_port: TcpPort = RDT_PORT
    """UDP port of its datagrams"""
    http_port: TcpPort = 80
    """TCP port of its configuration page"""
    serial: str | None = None
    """serial number of the calibration that the box must report; default: any"""
    mount: Mount = Mount()
    """pose of the sensor's frame at its tube's proximal end, where x is the tube's alpha = 0 and z its axis"""


class NetftFile(Strict):
    """ATI Net F/T boxes, one for each tube."""

    tubes: Mapping[Name, ForceBoxFile]
    stale_after: Positive = NetftSettings.stale_after
    """time without a usable record until a sensor is stale [s]"""
    latency: NotNegative = NetftSettings.latency
    """time from the measurement to the Ethernet [s]"""
    ranges: Annotated[tuple[Positive, Positive, Positive, Positive, Positive, Positive], Row] = NetftSettings.ranges  # pyright: ignore[reportAssignmentType] - six numbers
    """Fx Fy Fz Tx Ty Tz of the calibration, if the page has none [N, N m]"""


class CardFile(Strict):
    """One ATI sensor on an NI card."""

    channels: Annotated[str, Field(min_length=1)]
    """six differential inputs in the order of the gauges, as NI names them: Dev1/ai0:5"""
    calibration: str
    """ATI's .cal file"""
    serial: str | None = None
    """serial number of the sensor that the file must contain; default: any"""
    mount: Mount = Mount()
    """pose of the sensor's frame at its tube's proximal end, where x is the tube's alpha = 0 and z its axis"""


class NidaqFile(Strict):
    """ATI sensors on NI cards, one for each tube."""

    tubes: Mapping[Name, CardFile]
    rate: Annotated[float, Field(ge=100.0, le=100_000.0)] = 5000.0
    """sampling rate of each input [1/s]"""
    stale_after: Positive = 0.05
    """time without a usable sample until a sensor is stale [s]"""


Part = TypeVar("Part")


def in_order(parts: Mapping[str, Part], names: Sequence[str], key: str) -> list[Part]:
    """Return the parts in the robot's order.

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
