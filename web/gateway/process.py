"""The gateway's process: one look at the telemetry ring after the other, and what is seen to whoever listens.

It reads the ring as the recorder does, so the control loop knows nothing of it. What is asked of the robot goes to
the station process, which decides.
"""

import asyncio
import os
import select
import signal
from collections.abc import Awaitable, Callable
from multiprocessing.connection import Connection
from typing import Any, Protocol

from core.errors import CtrError
from core.robot.robot import Array
from station.control.realtime import leave, show_as
from station.control.ring import Ring
from station.control.telemetry import Channels
from web.access.gate import is_loopback
from web.gateway.messages import Problem, Ready, Setup, Target
from web.gateway.seen import Eyes, Look, Told
from web.gateway.wanted import Address, GatewayError

#: Looks a second.
RATE = 50.0


class Outlet(Protocol):
    """One protocol."""

    @property
    def watched(self) -> bool:
        """Whether anybody wants to see the robot."""
        ...

    def publish(self, look: Look) -> None:
        """Show it; never waits."""
        ...

    async def close(self) -> None:
        """End."""
        ...


def run_gateway(setup: Setup, ring_name: str, pipe: Connection, parent: int) -> None:
    """Main function of the gateway's process."""
    show_as("ctr-gateway")
    leave(setup.core, [os.getpid()])
    # Ctrl-C in a terminal reaches the whole group: the parent decides when we end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    robot = setup.robot.robot()
    ring = Ring(len(Channels(robot)), ring_name)
    try:
        asyncio.run(_Gateway(setup, ring, pipe).run(parent))
    except (EOFError, ConnectionError):
        return  # nobody is there any more
    finally:
        ring.close(remove=os.getppid() != parent)


class _Gateway:
    def __init__(self, setup: Setup, ring: Ring, pipe: Connection) -> None:
        robot = setup.robot.robot()
        channels = Channels(robot)
        self._setup, self._ring, self._pipe = setup, ring, pipe
        self._robot, self._channels = robot, channels
        self._eyes = Eyes(ring, robot, channels, setup.clock)
        self._told = Told()
        self._target: Target | None = None  # the newest
        self._room = select.poll()
        self._room.register(pipe.fileno(), select.POLLOUT)
        self._ended = False

    async def run(self, parent: int) -> None:
        """Serve until the parent says so or is gone."""
        loop, outlets = asyncio.get_running_loop(), list[Outlet]()
        loop.add_signal_handler(signal.SIGTERM, self._end)
        try:
            lines = await self._open(outlets)
        except CtrError as error:
            self._pipe.send(Problem(str(error)))
            for outlet in outlets:
                await outlet.close()
            return
        self._pipe.send(Ready(tuple(lines)))
        loop.add_reader(self._pipe.fileno(), self._hear)
        due = loop.time()
        try:
            while not self._ended and os.getppid() == parent:
                look = self._eyes.look(self._told, wanted=any(outlet.watched for outlet in outlets))
                for outlet in outlets:
                    outlet.publish(look)
                self._pass_on()
                # A computer that was asleep does not make up for what it missed.
                due = max(due + 1.0 / RATE, loop.time())
                await asyncio.sleep(due - loop.time())
        finally:
            loop.remove_reader(self._pipe.fileno())
            for outlet in outlets:
                await outlet.close()

    async def _open(self, outlets: list[Outlet]) -> list[str]:
        """Everything that is wanted; only what is wanted is imported."""
        wanted, lines = self._setup.wanted, list[str]()
        if wanted.igtl is not None:
            from web.gateway.igtl.server import IgtlServer

            igtl = IgtlServer(self._robot, self._aim)
            outlets.append(igtl)
            address = await _at("igtl", igtl.open, wanted.igtl)
            lines.append(f"OpenIGTLink is at {address}{_open_to(address)}")
        if wanted.foxglove is not None:
            from web.gateway.foxglove.server import FoxgloveServer

            tokens = self._setup.tokens
            foxglove = FoxgloveServer(self._robot, self._channels, tokens)
            outlets.append(foxglove)
            address = await _at("foxglove", foxglove.open, wanted.foxglove)
            lines.append(f"Foxglove is at ws://{address}/{f'?token={tokens.viewer}' if tokens else ''}")
        if wanted.lsl:
            from web.gateway.lsl import LslOutlet

            outlets.append(LslOutlet(self._robot, self._channels, self._setup.clock))
            lines.append("Lab Streaming Layer has the streams 'ctr-station' and 'ctr-station events'")
        if wanted.ros2 is not None:
            from web.gateway.ros2.publisher import Ros2Publisher

            publisher = Ros2Publisher(self._robot)
            outlets.append(publisher)
            lines.append(f"ROS 2 is {publisher.open(wanted.ros2)}{_open_to(wanted.ros2)}")
        return lines

    def _hear(self) -> None:
        try:
            while self._pipe.poll():
                told: Any = self._pipe.recv()
                if told is None:
                    self._end()
                    return
                self._told = told
        except (EOFError, OSError):
            self._end()

    def _aim(self, place: Array, sent: float | None) -> None:
        self._target = Target(place, sent)

    def _pass_on(self) -> None:
        """The newest target, if the station process takes it now: nobody here waits for it."""
        if self._target is not None and self._room.poll(0):
            self._pipe.send(self._target)
            self._target = None

    def _end(self) -> None:
        self._ended = True


async def _at(name: str, listen: Callable[[Address], Awaitable[Address]], address: Address) -> Address:
    """Where it listens.

    Raises:
        GatewayError: it cannot.
    """
    try:
        return await listen(address)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise GatewayError(f"--{name} {address} cannot be had: {reason}; choose another port") from None


def _open_to(address: Address) -> str:
    """Who gets in, where nobody can be asked for a token."""
    return "" if is_loopback(address.host) else ", open to everybody who reaches it"
