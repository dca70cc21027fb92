"""The gateway process: polls the telemetry ring and sends the values to the clients of all protocols.

The gateway reads the ring in the same way as the recorder, without any effect on the control loop. It sends targets
for the robot to the station process, which accepts or discards them. The station process sends a `StationInfo` at each
change of its state, and None to end the gateway process.
"""

import asyncio
import contextlib
import os
import signal
from collections.abc import Awaitable, Callable
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Protocol

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.child_process import takes_message
from station.control.clock import StationClock
from station.control.guard import Rank, watching
from station.control.realtime import move_off_core, set_process_name
from station.control.ring import Ring
from station.control.telemetry import Channels
from web.access.gate import is_loopback
from web.access.identity import Tokens
from web.gateway.options import GatewayError, GatewayOptions, ListenAddress
from web.gateway.snapshot import Snapshot, SnapshotReader, StationInfo


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


class CrtkMessage(NamedTuple):
    """Message from gateway to station: a client of ROS 2 has sent a command, or is present."""

    name: str  #: name of the command in CRTK, or 'present'
    client: str  #: id of the client's Zenoh session; empty: unknown
    node: str  #: name of the client's node
    may_operate: bool  #: whether the client may become operator: only on loopback, because Zenoh has no passwords
    received: float  #: time of receipt in the gateway, by the station's clock [s]
    sent: float | None = None  #: time by the sender's clock [s]; None: the sender gave none
    values: tuple[float, ...] = ()  #: position or velocity of the tip or of the joints, SI units
    direction: tuple[float, ...] | None = None  #: direction of the tip in the world, unit vector
    text: str = ""

    @property
    def ends(self) -> bool:
        """Whether the command is a motion with an end (`move_*` or `home`), during which the robot is busy."""
        return self.name.startswith("move_") or self.text == "home"

    @property
    def stops(self) -> bool:
        """Whether the command stops the robot, for every sender; it must not be lost."""
        return self.name == "hold" or self.text in {"pause", "disable"}


class CrtkText(NamedTuple):
    """Message from station to gateway: a text for the clients of ROS 2."""

    topic: str  #: 'error' or 'warning'
    text: str


class GatewayNote(NamedTuple):
    """Message from gateway to station: an event for the log, such as a refused client."""

    text: str


#: Largest number of notes of a gateway; clients cause them, and must not fill the log.
MAX_NOTES = 100
#: Rate at which the gateway polls the telemetry ring [1/s].
POLL_RATE_HZ = 50.0


class Outlet(Protocol):
    """Server of one protocol."""

    @property
    def needs_scene(self) -> bool:
        """Whether a client needs the robot's shape, which takes a solution of the model."""
        ...

    def publish(self, snapshot: Snapshot) -> None:
        """Send a snapshot to the clients; never waits."""
        ...

    async def close(self) -> None:
        """End the server and disconnect its clients."""
        ...


def run_gateway(setup: GatewaySetup, ring_name: str, pipe: Connection, parent: int) -> None:
    """Run the gateway process until the station process ends it."""
    set_process_name("ctr-gateway")
    move_off_core(setup.core, [os.getpid()])
    with (
        watching(ring_name, len(Channels(setup.robot.robot())), Rank.GATEWAY, setup.clock, parent) as ring,
        contextlib.suppress(EOFError, ConnectionError),  # the station process has ended
    ):
        asyncio.run(_Gateway(setup, ring, pipe).run(parent))


class _Gateway:
    def __init__(self, setup: GatewaySetup, ring: Ring, pipe: Connection) -> None:
        robot = setup.robot.robot()
        channels = Channels(robot)
        self._setup, self._ring, self._pipe = setup, ring, pipe
        self._robot, self._channels = robot, channels
        self._reader = SnapshotReader(ring, robot, channels, setup.clock)
        self._info = StationInfo()
        self._target: TargetMessage | None = None  # newest target that was not yet sent to the station process
        self._notes: dict[str, bool] = {}  # text of each note, and whether it was sent; in the order of the events
        self._ended = False
        self._report: Callable[[CrtkText], None] = lambda _: None  # publishes a text for clients of ROS 2

    async def run(self, parent: int) -> None:
        """Serve until the station process (`parent`) ends this process, or until the station process has ended."""
        loop, outlets = asyncio.get_running_loop(), list[Outlet]()
        loop.add_signal_handler(signal.SIGTERM, self._end)
        try:
            lines = await self._open(outlets)
        except CtrError as error:
            self._pipe.send(GatewayProblem(str(error)))
            for outlet in outlets:
                await outlet.close()
            return
        self._pipe.send(GatewayReady(tuple(lines)))
        loop.add_reader(self._pipe.fileno(), self._receive)
        due = loop.time()
        try:
            while not self._ended and os.getppid() == parent:
                with_scene = any(outlet.needs_scene for outlet in outlets)
                snapshot = self._reader.read(self._info, with_scene=with_scene)
                for outlet in outlets:
                    outlet.publish(snapshot)
                self._send_target()
                self._send_note()
                # Polls that were missed while the computer was suspended are not repeated.
                due = max(due + 1.0 / POLL_RATE_HZ, loop.time())
                await asyncio.sleep(due - loop.time())
        finally:
            loop.remove_reader(self._pipe.fileno())
            for outlet in outlets:
                await outlet.close()

    async def _open(self, outlets: list[Outlet]) -> list[str]:
        """Start the requested protocols and return their addresses as text; import only their packages."""
        options, lines = self._setup.options, list[str]()
        if options.igtl is not None:
            from web.gateway.igtl import IgtlServer

            igtl = IgtlServer(self._robot, self._take_target, self._note)
            outlets.append(igtl)
            address = await _listen("igtl", igtl.open, options.igtl)
            lines.append(f"OpenIGTLink is at {address}{_open_to(address)}")
        if options.foxglove is not None:
            from web.gateway.foxglove import FoxgloveServer

            tokens = self._setup.tokens
            foxglove = FoxgloveServer(self._robot, self._channels, tokens, options.origins, self._note)
            outlets.append(foxglove)
            address = await _listen("foxglove", foxglove.open, options.foxglove)
            lines.append(f"Foxglove is at ws://{address}/{f'?token={tokens.viewer}' if tokens else ''}")
        if options.lsl:
            from web.gateway.lsl import LslOutlet

            outlets.append(LslOutlet(self._robot, self._channels, self._setup.clock))
            lines.append("Lab Streaming Layer has the streams 'ctr-station' and 'ctr-station events'")
        if options.ros2 is not None:
            from web.gateway.ros2 import Ros2Outlet

            now = self._setup.clock.now
            ros2 = Ros2Outlet(self._setup.robot, self._channels, options.namespace, self._send, now, self._note)
            outlets.append(ros2)
            lines.append(f"ROS 2 is {ros2.open(options.ros2)}{_open_to(options.ros2)}")
            self._report = ros2.report
        return lines

    def _receive(self) -> None:
        try:
            while self._pipe.poll():
                info: Any = self._pipe.recv()
                if info is None:
                    self._end()
                    return
                if isinstance(info, CrtkText):
                    self._report(info)
                else:
                    self._info = info
        except (EOFError, OSError):
            self._end()

    def _take_target(self, position: Array, sent: float | None) -> None:
        self._target = TargetMessage(position, sent, self._setup.clock.now())

    def _send_target(self) -> None:
        """Send the newest target if the station process can take it now."""
        if self._target is not None and self._send(self._target):
            self._target = None

    def _note(self, text: str) -> None:
        """Queue a text for the station's log; a repeated text is not queued again."""
        if len(self._notes) < MAX_NOTES:
            self._notes.setdefault(text, False)

    def _send_note(self) -> None:
        """Send the oldest waiting note if the station process can take it now."""
        text = next((text for text, sent in self._notes.items() if not sent), None)
        if text is not None and self._send(GatewayNote(text)):
            self._notes[text] = True

    def _send(self, message: TargetMessage | CrtkMessage | GatewayNote) -> bool:
        """Send a message if the station process can take it now; return whether it was sent, and never wait."""
        if ready := takes_message(self._pipe):
            self._pipe.send(message)
        return ready

    def _end(self) -> None:
        self._ended = True


async def _listen(
    name: str, listen: Callable[[ListenAddress], Awaitable[ListenAddress]], address: ListenAddress
) -> ListenAddress:
    """Start a server of the gateway and return the address on which it listens.

    Raises:
        GatewayError: the port is not available.
    """
    try:
        return await listen(address)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise GatewayError(f"--{name} {address} is not available: {reason}; choose another port") from None


def _open_to(address: ListenAddress) -> str:
    """Return a warning text for a protocol without access tokens that listens beyond loopback; otherwise empty."""
    return "" if is_loopback(address.host) else ", open to every client that reaches it"
