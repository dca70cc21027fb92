"""The `[devices]` part of a station file: which driver has which device, and what it has to be told.

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
from station.devices.zaber.chain import Line

#: pyserial's name of a port: /dev/ttyUSB0, COM3, socket://host:port.
Serial = Annotated[str, Field(min_length=1)]
TcpPort = Annotated[int, Field(ge=1, le=65535)]


def _names_a_driver(options: Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(options.get("driver"), str):
        raise ValueError("'driver' is missing: the name of a driver, in quotes")
    return options


#: What one driver is told; `driver` names it, the rest is its own.
Options = Annotated[Mapping[str, Any], AfterValidator(_names_a_driver)]


class BenchFile(Strict):
    """A bench with devices of its own."""

    stages: Options
    """`driver` and what it has to be told"""
    tracker: Options
    """`driver` and what it has to be told"""
    sensors: Options
    """`driver` and what it has to be told"""

    @property
    def may_tell_target(self) -> bool:
        """Whether frames may have a target's place: an Aurora's with a second coil, any of a driver of one's own."""
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
    """Where a device's frame stands in another one."""

    position: Vector = (0.0, 0.0, 0.0)
    """of its origin [m]"""
    rotation_vector: Vector = (0.0, 0.0, 0.0)
    """axis times angle [rad]"""

    @property
    def rotation(self) -> Array:
        """(3, 3): from its axes to the other's."""
        return Base(self.position, self.rotation_vector).rotation


class StageFile(Strict):
    """One Zaber unit."""

    port: Serial | None = None
    """its own; none: it is on the chain's"""
    device: Annotated[int, Field(ge=1, le=254)]
    """its number on the chain"""
    home_at: float | None = None
    """joint position at its home sensor; none: 0 of a rotation, the end at which a translation counts 0 [rad or m]"""
    backwards: bool = False
    """its count rises where the joint's position falls"""
    home_speed: Positive | None = None
    """none: a quarter of the joint's speed [rad/s or m/s]"""
    device_id: Annotated[int, Field(ge=0)] | None = None
    """what the unit must say that it is"""
    serial: Annotated[int, Field(ge=0)] | None = None
    """number that the unit must have"""


class ZaberFile(Strict):
    """Zaber T-series stages: one chain, or a port for each."""

    port: Serial | None = None
    """of the chain"""
    joints: Mapping[Name, StageFile] = {}
    """the unit of each joint; none at all: numbered from the computer in the robot's order"""
    deadline: Annotated[float, Field(ge=0.02, le=10.0)] = Line.deadline
    """for a reply, from the start of its request; without two in a row a stage is lost [s]"""


class AuroraFile(Strict):
    """NDI Aurora."""

    port: Serial
    tool: str = ""
    """serial number of the tip's coil, as the unit tells it; "": the first tool"""
    target: str = ""
    """serial number of a second coil, on what the motion `follow` follows; "": there is none"""
    baud: int = AuroraSettings.baud
    """to change to; a rate that the unit has"""
    frame_rate: Annotated[float, Field(gt=0.0, le=1000.0)] = AuroraSettings.frame_rate
    """[1/s]"""
    latency: NotNegative = AuroraSettings.latency
    """from a measurement to the soonest arrival of its reply at 115200 baud [s]"""
    always_tx: bool = False
    """ask for frames as text: very old firmware"""
    fault_bits: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """port status bits that spoil a measurement, besides those of the volume"""
    mount: Mount = Mount()
    """of the field generator in the world, from a registration"""
    coil_to_tip: float = 0.0
    """from the coil to the robot's tip along the coil's axis [m]"""


class BoxFile(Strict):
    """One ATI Net F/T box."""

    host: Annotated[str, Field(min_length=1)]
    """name or address"""
    rdt_port: TcpPort = RDT_PORT
    """of its datagrams"""
    http_port: TcpPort = 80
    """of its configuration page"""
    serial: str | None = None
    """calibration that the box must have; none takes what is there"""
    mount: Mount = Mount()
    """of the sensor's frame at its tube's proximal end, where x is the tube's alpha = 0 and z its axis"""


class NetftFile(Strict):
    """ATI Net F/T boxes, one for each tube."""

    tubes: Mapping[Name, BoxFile]
    stale_after: Positive = NetftSettings.stale_after
    """without a usable record [s]"""
    latency: NotNegative = NetftSettings.latency
    """from the event to the Ethernet [s]"""
    ranges: Annotated[tuple[Positive, Positive, Positive, Positive, Positive, Positive], Row] = NetftSettings.ranges  # pyright: ignore[reportAssignmentType] - six numbers
    """Fx Fy Fz Tx Ty Tz of the calibration, for a page that tells none [N, N m]"""


class CardFile(Strict):
    """One ATI sensor on an NI card."""

    channels: Annotated[str, Field(min_length=1)]
    """six differential inputs in the order of the gauges, as NI names them: Dev1/ai0:5"""
    calibration: str
    """ATI's .cal file"""
    serial: str | None = None
    """that the file must be for; none takes what it says"""
    mount: Mount = Mount()
    """of the sensor's frame at its tube's proximal end, where x is the tube's alpha = 0 and z its axis"""


class NidaqFile(Strict):
    """ATI sensors on NI cards, one for each tube."""

    tubes: Mapping[Name, CardFile]
    rate: Annotated[float, Field(ge=100.0, le=100_000.0)] = 5000.0
    """samples of each input [1/s]"""
    stale_after: Positive = 0.05
    """without a usable sample [s]"""


Part = TypeVar("Part")


def in_order(parts: Mapping[str, Part], names: Sequence[str], key: str) -> list[Part]:
    """The parts in the robot's order.

    Raises:
        ConfigError: one is missing, or the robot has none of that name.
    """
    for name in parts:
        if name not in names:
            raise ConfigError(f"{key}.{name}: the robot has no such part; it has {', '.join(names)}")
    for name in names:
        if name not in parts:
            raise ConfigError(f"{key}.{name} is missing")
    return [parts[name] for name in names]
