"""The station process's side of the gateway: starts it, tells it what the ring does not have, and hears of targets."""

import asyncio
import contextlib
import select
from collections.abc import Callable

from station.control.child import Child
from station.control.states import State
from station.service.audit import Audit
from station.service.station_service import StationService
from web.access.gate import is_loopback
from web.access.tokens import Tokens, new_tokens
from web.gateway.messages import Problem, Ready, Setup, Target
from web.gateway.process import run_gateway
from web.gateway.seen import Told
from web.gateway.wanted import GatewayError, Wanted

#: It has so long to begin, and to end [s].
START_TIME, END_TIME = 60.0, 5.0
#: Between two looks at the station's state [s].
LOOK = 0.1


class Gateway:
    """One gateway process of a station."""

    def __init__(self, service: StationService, wanted: Wanted, tokens: Tokens | None, audit: Audit) -> None:
        """Start it; with the station's `tokens`, if it has any, where they can be demanded.

        Raises:
            GatewayError: a package is missing.
        """
        wanted.check()
        supervisor = service.supervisor
        if wanted.foxglove is None or is_loopback(wanted.foxglove.host):
            tokens = None
        elif tokens is None:
            tokens = new_tokens()  # the station's own page is on loopback and has none
        bench = supervisor.bench
        setup = Setup(wanted, bench.robot, bench.clock, bench.core, tokens)
        self.wanted = wanted
        self._service, self._audit = service, audit
        self._child = Child(run_gateway, setup, supervisor.ring.name, name="gateway")
        self._room = select.poll()
        self._room.register(self._child.pipe.fileno(), select.POLLOUT)
        self._told: Told | None = None

    def wait_ready(self) -> tuple[str, ...]:
        """What it serves, and where, for a person.

        Raises:
            GatewayError: it cannot; the process has ended.
        """
        pipe, problem = self._child.pipe, f"the gateway did not start within {START_TIME:g} s"
        with contextlib.suppress(EOFError, OSError):
            if pipe.poll(START_TIME):
                match pipe.recv():
                    case Ready(lines):
                        return lines
                    case Problem(text):
                        problem = text
                    case _:
                        pass
        self.close()
        raise GatewayError(problem)

    async def run(self, on_target: Callable[[Target], None]) -> None:
        """Keep it informed, and pass on what it hears; until cancelled, or until it is gone."""
        loop, gone, pipe = asyncio.get_running_loop(), asyncio.Event(), self._child.pipe

        def hear() -> None:
            try:
                while pipe.poll():
                    message = pipe.recv()
                    if isinstance(message, Target):
                        on_target(message)
            except (EOFError, OSError):
                gone.set()

        loop.add_reader(pipe.fileno(), hear)
        try:
            while not gone.is_set():
                self._tell()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(gone.wait(), LOOK)
            how = await asyncio.to_thread(self._child.ended, 1.0)
            self._audit.write("station", "gateway", "", f"ended {how}; it comes back with the next start")
        finally:
            loop.remove_reader(pipe.fileno())

    def close(self) -> None:
        """End the process."""
        self._child.close(END_TIME)

    def _tell(self) -> None:
        """What is new; never waits for a gateway that stands still."""
        status = self._service.supervisor.status()
        about = {} if status.run is None else status.run.start.about.get("settings", {})
        controller = about.get("controller") if status.state is State.RUNNING else None
        told = Told(status.state, status.cause, gains_of(controller or self._service.settings.controller.model_dump()))
        if told != self._told and self._room.poll(0):
            self._told = told
            self._child.tell(told)


def gains_of(controller: dict[str, object], before: str = "controller") -> tuple[tuple[str, float | str | bool], ...]:
    """Every number, word and switch of a controller, by name."""
    found: list[tuple[str, float | str | bool]] = []
    for key, value in controller.items():
        if isinstance(value, dict):
            found += gains_of(value, f"{before}.{key}")
        elif isinstance(value, float | int | str):
            found.append((f"{before}.{key}", value))
    return tuple(found)
