"""Between the station process and the gateway's. Station -> gateway: `Told`, or None to end."""

from typing import NamedTuple

from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.clock import StationClock
from web.access.tokens import Tokens
from web.gateway.wanted import Wanted


class Setup(NamedTuple):
    """What the gateway's process is told when it starts."""

    wanted: Wanted
    robot: RobotFile
    clock: StationClock
    core: int | None  #: the control loop's processor, which it keeps off
    tokens: Tokens | None  #: demanded where that can be; None: on loopback, nobody is asked


class Ready(NamedTuple):
    """Gateway -> station, once: everything is served."""

    lines: tuple[str, ...]  #: where, for a person


class Problem(NamedTuple):
    """Gateway -> station, in its place: why not."""

    text: str


class Target(NamedTuple):
    """Gateway -> station: somebody wants the tip there."""

    place: Array  #: (3,) in the world [m]
    sent: float | None  #: by the sender's clock [s]
