"""Connection of the station process to the gateway: starts its process, sends it the state, and receives targets."""

import asyncio
import contextlib
import select
from collections.abc import Callable

from station.control.child_process import ChildProcess
from station.control.states import State
from station.service.audit import Audit
from station.service.station_service import StationService
from web.access.gate import is_loopback
from web.access.tokens import Tokens, new_tokens
from web.gateway.messages import GatewayProblem, GatewayReady, GatewaySetup, TargetMessage
from web.gateway.options import GatewayError, GatewayOptions
from web.gateway.process import run_gateway
from web.gateway.snapshot import StationInfo

#: Time limits for the gateway process to start and to end [s].
START_TIMEOUT_S, EXIT_TIMEOUT_S = 60.0, 5.0
#: Interval between two readings of the station's state [s].
POLL_INTERVAL_S = 0.1


class Gateway:
    """Handle of a station's gateway process."""

    def __init__(self, service: StationService, options: GatewayOptions, tokens: Tokens | None, audit: Audit) -> None:
        """Start the gateway process; protocols that support access tokens require the station's `tokens`.

        Raises:
            GatewayError: the package of a requested protocol is not installed.
        """
        options.check()
        supervisor = service.supervisor
        if options.foxglove is None or is_loopback(options.foxglove.host):
            tokens = None
        elif tokens is None:
            tokens = new_tokens()  # the page is on loopback and has no tokens, but Foxglove is not on loopback
        bench = supervisor.bench
        setup = GatewaySetup(options, bench.robot, bench.clock, bench.core, tokens)
        self.options = options
        self._service, self._audit = service, audit
        self._child = ChildProcess(run_gateway, setup, supervisor.ring.name, name="gateway")
        self._writable = select.poll()
        self._writable.register(self._child.pipe.fileno(), select.POLLOUT)
        self._sent: StationInfo | None = None
        self.problem = ""  #: why the gateway has ended; empty while it runs

    def wait_ready(self) -> tuple[str, ...]:
        """Wait until the gateway has started; return the served protocols and their addresses as lines of text.

        Raises:
            GatewayError: the gateway cannot serve a protocol, so its process was ended.
        """
        pipe, problem = self._child.pipe, f"the gateway did not start within {START_TIMEOUT_S:g} s"
        with contextlib.suppress(EOFError, OSError):
            if pipe.poll(START_TIMEOUT_S):
                match pipe.recv():
                    case GatewayReady(lines):
                        return lines
                    case GatewayProblem(text):
                        problem = text
                    case _:
                        pass
        self.close()
        raise GatewayError(problem)

    async def run(self, on_target: Callable[[TargetMessage], None]) -> None:
        """Send the station's state to the gateway and pass received targets to `on_target` until the gateway ends."""
        loop, gone, pipe = asyncio.get_running_loop(), asyncio.Event(), self._child.pipe

        def receive() -> None:
            newest: TargetMessage | None = None
            try:
                while pipe.poll():
                    message = pipe.recv()
                    newest = message if isinstance(message, TargetMessage) else newest
            except (EOFError, OSError):
                gone.set()
            if newest is not None:
                on_target(newest)

        loop.add_reader(pipe.fileno(), receive)
        try:
            while not gone.is_set():
                self._send_info()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(gone.wait(), POLL_INTERVAL_S)
            how = await asyncio.to_thread(self._child.ended, 1.0)
            self.problem = f"the gateway ended {how}: its clients receive no more data; restart the station"
            self._audit.write("station", "gateway", "", self.problem)
        finally:
            loop.remove_reader(pipe.fileno())

    def close(self) -> None:
        """End the gateway process."""
        self._child.close(EXIT_TIMEOUT_S)

    def _send_info(self) -> None:
        """Send the station's state if it has changed; never waits for a gateway that does not read."""
        status = self._service.supervisor.status()
        about = {} if status.run is None else status.run.start.about.get("settings", {})
        controller = about.get("controller") if status.state is State.RUNNING else None
        info = StationInfo(
            status.state, status.cause, gains_of(controller or self._service.settings.controller.model_dump())
        )
        if info != self._sent and self._writable.poll(0):
            self._sent = info
            self._child.send(info)


def gains_of(controller: dict[str, object], before: str = "controller") -> tuple[tuple[str, float | str | bool], ...]:
    """Return the dotted keys and values of a controller's parameters that are numbers, texts or switches."""
    found: list[tuple[str, float | str | bool]] = []
    for key, value in controller.items():
        if isinstance(value, dict):
            found += gains_of(value, f"{before}.{key}")
        elif isinstance(value, float | int | str):
            found.append((f"{before}.{key}", value))
    return tuple(found)
