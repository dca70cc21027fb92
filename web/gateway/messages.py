"""Messages between the station process and the gateway process.

The station process sends a `StationInfo` at each change of its state. It sends None to end the gateway process.
"""

from typing import NamedTuple

from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.clock import StationClock
from web.access.tokens import Tokens
from web.gateway.options import GatewayOptions


class GatewaySetup(NamedTuple):
    """Arguments of the gateway process."""

    options: GatewayOptions
    robot: RobotFile
    clock: StationClock
    core: int | None  #: index of the control loop's processor core, which the gateway does not use
    tokens: Tokens | None  #: access tokens, which clients need if the protocol supports tokens; None on loopback


class GatewayReady(NamedTuple):
    """Message from gateway to station, sent once: the gateway now serves all requested protocols."""

    lines: tuple[str, ...]  #: served protocols and their addresses, as text


class GatewayProblem(NamedTuple):
    """Message from gateway to station instead of `GatewayReady`: why the gateway cannot serve."""

    text: str


class TargetMessage(NamedTuple):
    """Message from gateway to station: a client has sent a target for the tip."""

    position: Array  #: target position (3,), world frame [m]
    sent: float | None  #: time by the sender's clock [s]; None: the sender gave none
    received: float  #: time of receipt in the gateway, by the station's clock [s]
