"""Command-line options of the gateway; they are checked before the station starts."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import NamedTuple

from core.errors import CtrError

LOOPBACK = "127.0.0.1"
#: Default ports of OpenIGTLink, of Foxglove, and of a Zenoh router for ROS 2.
IGTL_PORT, FOXGLOVE_PORT, ZENOH_PORT = 18944, 8765, 7447


class GatewayError(CtrError):
    """A protocol of the gateway cannot be served."""


class ListenAddress(NamedTuple):
    """Address on which a server of the gateway listens."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True)
class GatewayOptions:
    """Protocols that the gateway serves, and their addresses; none by default."""

    igtl: ListenAddress | None = None
    foxglove: ListenAddress | None = None
    lsl: bool = False
    ros2: ListenAddress | None = None
    namespace: str = "CTR"  #: namespace of the robot's topics in ROS 2
    origins: tuple[str, ...] = ()  #: origins of web pages that may connect to Foxglove, in addition to Foxglove's

    def __bool__(self) -> bool:
        """Whether the gateway serves any protocol."""
        return bool(self.igtl or self.foxglove or self.lsl or self.ros2)

    def check(self) -> None:
        """Check that the package of each protocol is installed.

        Raises:
            GatewayError: a package is missing; the text names what to install.
        """
        for name, package in (("igtl", "pyigtl"), ("lsl", "pylsl"), ("ros2", "zenoh")):
            if getattr(self, name) and find_spec(package) is None:
                raise GatewayError(f"--{name} needs the package {package}: pip install 'ctr-station[{name}]'")


def address_of(text: str) -> ListenAddress:
    """Parse the address `[HOST:]PORT`; the default host is loopback.

    Raises:
        ValueError: the text has no valid port.
    """
    host, _, port = text.rpartition(":")
    number = int(port)
    if not 0 <= number <= 65535:
        raise ValueError(f"{port} is outside 0 ... 65535")
    return ListenAddress(host.strip("[]") or LOOPBACK, number)
