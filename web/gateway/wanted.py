"""What of the gateway is wanted, as the command line says it, and what is refused about it before anything starts."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import NamedTuple

from core.errors import CtrError

LOOPBACK = "127.0.0.1"
#: Ports that the other side knows: of OpenIGTLink, of Foxglove, and of a Zenoh router as ROS 2 has it.
IGTL, FOXGLOVE, ZENOH = 18944, 8765, 7447


class GatewayError(CtrError):
    """A part of the gateway that cannot be had."""


class Address(NamedTuple):
    """Where to listen."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


@dataclass(frozen=True)
class Wanted:
    """What is to be served; nothing by default."""

    igtl: Address | None = None
    foxglove: Address | None = None
    lsl: bool = False
    ros2: Address | None = None

    def __bool__(self) -> bool:
        """Whether it is anything at all."""
        return bool(self.igtl or self.foxglove or self.lsl or self.ros2)

    def check(self) -> None:
        """See that what each needs is installed.

        Raises:
            GatewayError: it is not; the text says what to install.
        """
        for name, package in (("igtl", "pyigtl"), ("lsl", "pylsl"), ("ros2", "zenoh")):
            if getattr(self, name) and find_spec(package) is None:
                raise GatewayError(f"--{name} needs the package {package}: pip install 'ctr-station[{name}]'")


def address_of(text: str) -> Address:
    """`[HOST:]PORT`, on loopback unless a host is named.

    Raises:
        ValueError: not a port.
    """
    host, _, port = text.rpartition(":")
    number = int(port)
    if not 0 <= number <= 65535:
        raise ValueError(f"{port} is outside 0 ... 65535")
    return Address(host.strip("[]") or LOOPBACK, number)
