"""The station's side of the gateway: starts its process, sends it the state, and follows its targets in a run.

An operator starts a run whose tip follows targets of OpenIGTLink or ROS 2, and must stay operator. A target is refused
if there is no such run, if the operator's lease has expired, or if another client is operator. Without targets the tip
comes to rest and the run ends.
"""

import asyncio
import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from fastapi import APIRouter, Depends, Request

from core.control.setpoint_request import SetpointRequest
from station.control.child_process import ChildProcess, takes_message
from station.control.states import RefusedError, State
from station.service.audit import Audit
from station.service.commands import StreamAgreement
from station.service.permits import Permit
from station.service.runs import RunRequest
from station.service.setpoint_stream import SetpointRefused, SetpointStream
from station.service.supervisor import Supervisor
from web.access.gate import is_loopback
from web.access.identity import Sender, Tokens, new_tokens, sender_of
from web.access.lease import Lease
from web.api.commands import Commands, Permitted
from web.api.control import run_out
from web.api.schemas import StartOut
from web.api.setpoints import until_accepting, until_over
from web.gateway.options import GatewayError, GatewayOptions
from web.gateway.process import (
    CrtkMessage,
    GatewayNote,
    GatewayProblem,
    GatewayReady,
    GatewaySetup,
    TargetMessage,
    run_gateway,
)
from web.gateway.snapshot import StationInfo

if TYPE_CHECKING:
    from web.gateway.crtk_commands import CrtkCommands

#: Time limits for the gateway process to start and to end [s].
START_TIMEOUT_S, EXIT_TIMEOUT_S = 60.0, 5.0
#: Interval between two readings of the station's state [s].
POLL_INTERVAL_S = 0.1


class Gateway:
    """Gateway process of a station: this class starts the process, exchanges messages with it and ends it."""

    def __init__(self, supervisor: Supervisor, options: GatewayOptions, tokens: Tokens | None, audit: Audit) -> None:
        """Start the gateway process; protocols that support access tokens require the station's `tokens`.

        Raises:
            GatewayError: the package of a requested protocol is not installed.
        """
        options.check()
        if options.foxglove is None or is_loopback(options.foxglove.host):
            tokens = None
        elif tokens is None:
            tokens = new_tokens()  # the page is on loopback and has no tokens, but Foxglove is not on loopback
        bench = supervisor.bench
        setup = GatewaySetup(options, bench.robot, bench.clock, bench.core, tokens)
        self.options = options
        self._supervisor, self._audit = supervisor, audit
        self._child = ChildProcess(run_gateway, setup, supervisor.ring.name, name="gateway")
        self._sent: StationInfo | None = None
        self.problem = ""  #: why the gateway has ended; empty while it runs

    def wait_ready(self) -> tuple[str, ...]:
        """Wait until the gateway has started; return the served protocols and their addresses as lines of text.

        Raises:
            GatewayError: the gateway cannot serve a protocol, so its process was ended.
        """
        pipe, problem = self._child.pipe, f"the gateway did not start within {START_TIMEOUT_S:g} s; try again"
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

    async def run(self, on_target: Callable[[TargetMessage], None], commands: "CrtkCommands") -> None:
        """Send the station's state to the gateway and pass on its targets and commands until the gateway ends."""
        loop, gone, pipe = asyncio.get_running_loop(), asyncio.Event(), self._child.pipe

        def receive() -> None:
            newest: TargetMessage | None = None
            try:
                while pipe.poll():
                    message = pipe.recv()
                    newest = message if isinstance(message, TargetMessage) else newest
                    if isinstance(message, CrtkMessage):
                        commands.receive(message)
                    if isinstance(message, GatewayNote):
                        self._audit.refused("gateway", "client", "", message.text)
            except (EOFError, OSError):
                gone.set()
                commands.changed.set()
            if newest is not None:
                on_target(newest)

        loop.add_reader(pipe.fileno(), receive)
        try:
            while not gone.is_set():
                self._send_info(commands.busy, commands.moves)
                while commands.texts and takes_message(self._child.pipe):
                    self._child.send(commands.texts.popleft())
                commands.changed.clear()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(commands.changed.wait(), POLL_INTERVAL_S)
            how = await asyncio.to_thread(self._child.ended, 1.0)
            self.problem = f"the gateway ended {how}: its clients receive no more data; restart the station"
            self._audit.write("station", "gateway", "", self.problem)
        finally:
            loop.remove_reader(pipe.fileno())

    def close(self) -> None:
        """End the gateway process."""
        self._child.close(EXIT_TIMEOUT_S)

    def _send_info(self, busy: bool, moves: int) -> None:
        """Send the station's state if it has changed; never waits for a gateway that does not read."""
        status = self._supervisor.status()
        about = {} if status.run is None else status.run.start.about.get("settings", {})
        controller = about.get("controller") if status.state is State.RUNNING else None
        info = StationInfo(
            status.state, status.cause, gains_of(controller or self._supervisor.settings.controller.model_dump()),
            busy, moves,
        )  # fmt: skip
        if info != self._sent and takes_message(self._child.pipe):
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


class TargetStream(NamedTuple):
    """The run that follows targets now."""

    run: RunRequest
    stream: SetpointStream
    client: str  #: identity of the client that started the run
    since: float  #: time from which the run accepts targets; earlier ones are discarded [s]


class TargetStreams:
    """Starts runs that follow targets, one at a time; all methods run in the event loop of the web server."""

    def __init__(self, supervisor: Supervisor, lease: Lease, audit: Audit) -> None:
        self._supervisor, self._lease, self._audit = supervisor, lease, audit
        self._current: TargetStream | None = None
        self._source = ""  # the first sender of a target in this run
        self._tasks: set[asyncio.Task[None]] = set()

    def receive(self, target: TargetMessage) -> None:
        """Pass a received target of OpenIGTLink on to the current run."""
        with contextlib.suppress(RefusedError, SetpointRefused):  # OpenIGTLink has no answer to a target
            stream = self.current("OpenIGTLink", target.received).stream
            position: tuple[float, ...] = tuple(target.position.tolist())
            self.send(stream.position(position, target.received, target.sent))

    def current(self, source: str, received: float) -> TargetStream:
        """Return the run that accepts a target of `source`, received at this time [s].

        Two programs must not move one tip: the first that sends a target controls it until `release`.

        Raises:
            RefusedError: no run accepts this target; the text has the reason and what to do.
        """
        current = self._current
        if current is None or received < current.since:
            raise RefusedError(
                "no run for external targets is active; an operator starts one on the page (Run, external target) or"
                " with POST /api/gateway/target"
            )
        if not self._lease.holds(current.client):
            raise RefusedError("the client that started the run for external targets is not operator any longer")
        if self._source not in ("", source):
            raise RefusedError("another program sends the targets of this run; end that program")
        self._source = source
        return current

    def send(self, setpoint: SetpointRequest) -> None:
        """Send a setpoint to the current run."""
        if self._current is not None:
            self._supervisor.send_setpoint(self._current.run, setpoint)

    def release(self, source: str) -> None:
        """Let another program send targets if `source` has sent them so far."""
        self._source = "" if self._source == source else self._source

    async def start(self, who: Sender, agreement: StreamAgreement, permit: Permit) -> RunRequest:
        """Start a run whose tip follows targets.

        Raises:
            RefusedError: the station's state does not allow a run.
            CtrError: the controller of the run is invalid.
        """
        # Targets are in the world frame, so the frame of the agreement is overwritten.
        agreement = agreement.model_copy(update={"frame": "world"})
        run = (await asyncio.to_thread(self._supervisor.send, agreement, permit)).started
        self._audit.write(str(who), f"targets of run {run.id}", who.where, "started")
        task = asyncio.create_task(self._follow(run, who, agreement))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return run

    async def _follow(self, run: RunRequest, who: Sender, agreement: StreamAgreement) -> None:
        supervisor = self._supervisor
        try:
            if not await until_accepting(self._supervisor, run):
                return
            row = supervisor.ring.latest()
            if row is not None:
                start = supervisor.channels.of(row, "tip_desired").copy()
                now = supervisor.bench.clock.now()
                self._source = ""
                self._current = TargetStream(run, SetpointStream(agreement, start, now), who.client, now)
            await until_over(run)
        finally:
            self._current = None
            self._supervisor.send_setpoint(run, None)
            self._audit.write(str(who), f"targets of run {run.id}", who.where, "ended")


def gateway_routes(targets: TargetStreams, of: Commands) -> APIRouter:
    """Return the route that starts a run for targets."""
    router = APIRouter(prefix="/api/gateway", tags=["gateway"], dependencies=[Depends(of.renew_lease)])

    @router.post("/target", status_code=202, summary="Start a run that follows external targets", **of.command)
    async def target(agreement: StreamAgreement, request: Request, permit: Permitted) -> StartOut:
        """Start a run whose tip follows targets of OpenIGTLink or ROS 2, while the client stays operator."""
        return run_out(await targets.start(sender_of(request), agreement, permit))

    return router
