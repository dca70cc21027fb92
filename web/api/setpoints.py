"""`WS /api/setpoints`: somebody outside leads the tip, message by message, as long as they hold the lease.

    {"controller": {"task": "position_and_direction"}}     first what one agrees to, `LeadIn`; {} will do
    {"tip": [0.0, 0.0, 0.002], "time": 12.34, "direction": [0.1, 0.0, 1.0]}
    {"velocity": [0.0, 0.0, 0.001]}
    {"end": true}

The tip is told in the `frame` of the beginning, a direction always in the world.
"""

import asyncio
import contextlib
import json
import math
from typing import Any

import numpy as np
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import ValidationError
from starlette.types import Message

from core.errors import CtrError
from core.robot.robot import Array
from station.control.ring import PHASE, RUN, STATE
from station.control.states import State
from station.control.task import Phase
from station.service.audit import Audit
from station.service.leader import Leader, LeadIn, NotTaken, TooFast
from station.service.start import Run
from station.service.station_service import StationService
from web.access.identity import Who, who_of
from web.access.lease import HeldError, Lease
from web.access.tokens import Role
from web.api.commands import commanding
from web.api.readable import presentable

#: Between two looks at whether the run goes on [s].
LOOK = 0.02
#: Whoever connects has to begin within this time [s].
PATIENCE = 20.0
#: The longest reason that a socket can be closed with [bytes].
LONGEST = 123
#: What a socket is closed with: all is said, somebody may not, or more came than may.
DONE, NOT_ALLOWED, TOO_MUCH = 1000, 1008, 1009


def setpoint_routes(service: StationService, lease: Lease, audit: Audit) -> APIRouter:
    """The one route, for whoever holds the lease or takes it because nobody does."""
    router = APIRouter(prefix="/api")

    @router.websocket("/setpoints")
    async def setpoints(socket: WebSocket) -> None:
        await socket.accept()
        who, run = who_of(socket), None
        try:
            asked, run = await _begin(socket, service, lease, who)
            audit.write(str(who), f"setpoints of run {run.id}", who.where, "begun")
            await _ready(service, lease, who, run)
            await _lead(socket, service, lease, who, asked, run)
        except _Refused as error:
            await _close(socket, {"error": str(error)}, error.code)
        except (WebSocketDisconnect, RuntimeError):
            return  # the other side has gone
        finally:
            if run is not None:
                service.lead(run, None)
                audit.write(str(who), f"setpoints of run {run.id}", who.where, "ended")

    return router


class _Refused(CtrError):
    """Nothing is taken any more."""

    def __init__(self, text: str, code: int = NOT_ALLOWED) -> None:
        super().__init__(text)
        self.code = code


async def _begin(socket: WebSocket, service: StationService, lease: Lease, who: Who) -> tuple[LeadIn, Run]:
    """The first message starts the run."""
    if who.role is not Role.OPERATOR:
        raise _Refused("viewers may look and press STOP; this needs the operators' token")
    try:
        first = await asyncio.wait_for(socket.receive(), PATIENCE)
        asked = LeadIn.model_validate(_object(first), strict=False)
        with commanding(lease, who):
            run = await asyncio.to_thread(service.start_led, asked)
    except TimeoutError:
        raise _Refused(f"nothing was said for {PATIENCE:g} s; the first message begins the run, {{}} will do") from None
    except ValidationError as error:
        first = error.errors()[0]
        raise _Refused(f"{'.'.join(map(str, first['loc'])) or 'message'}: {first['msg']}") from None
    except CtrError as error:
        raise _Refused(str(error)) from None
    await socket.send_json({"run_id": run.id, "warnings": run.start.warnings})
    return asked, run


async def _ready(service: StationService, lease: Lease, who: Who, run: Run) -> None:
    """Wait until the tip may be led; it rests for the tare meanwhile."""
    while not moves(service, run):
        # The answer to the start may come before the loop's first word of it.
        if over(service, run) and service.supervisor.status().state is not State.RUNNING:
            status = service.supervisor.status()
            raise _Refused(f"the run has ended before it moved: {status.state.name} {status.cause}".strip(), DONE)
        lease.renew(who.client)
        await asyncio.sleep(LOOK)


async def _lead(socket: WebSocket, service: StationService, lease: Lease, who: Who, asked: LeadIn, run: Run) -> None:
    """Message by message, until one side has had enough."""
    supervisor = service.supervisor
    now, row = supervisor.bench.clock.now, _row(service)
    start = supervisor.channels.of(row, "tip_desired").copy()
    leader = Leader(asked, start, now())
    told = {"ready": True, "tip": start.tolist(), "time": float(row[0])}
    if asked.points:
        told["direction"] = supervisor.channels.of(row, "direction_desired").tolist()
    await socket.send_json(told)
    heard, left = now(), False
    watch = asyncio.create_task(until_over(service, run))
    try:
        while True:
            hearing = asyncio.create_task(socket.receive())
            await asyncio.wait([hearing, watch], return_when=asyncio.FIRST_COMPLETED)
            if not hearing.done():
                hearing.cancel()
                break
            refused = ""
            try:
                leader.count(now())
                message = _object(hearing.result())
                if len(message) == 1 and message.get("end") is True:
                    service.lead(run, None)
                    left = True
                    continue
                lease.keep(who.client, who.name)
                service.lead(run, _wish(leader, message, now()))
                heard = now()
            except TooFast as error:
                raise _Refused(str(error), TOO_MUCH) from None
            except (NotTaken, HeldError) as error:
                refused = str(error)
            await socket.send_json(_answer(service, run, asked, refused))
    finally:
        watch.cancel()
    status = supervisor.status()
    # The loop counts from another moment of the same message; whose time was over has spoken just now.
    silent = "" if left or now() - heard < 0.5 * asked.end else f"nothing that counts was said for {asked.end:g} s"
    await _close(socket, {"ended": status.state.name, "cause": status.cause or silent}, DONE)


def _wish(leader: Leader, message: dict[str, Any], now: float) -> Any:
    with contextlib.suppress(OverflowError):  # a whole number that is no float any more
        match message:
            case {"tip": [*place], **more} if set(more) <= {"time", "direction"} and _numbers(place):
                sent, pointing = more.get("time", 0.0), more.get("direction", [])
                if isinstance(pointing, list) and _numbers([sent, *pointing]) and math.isfinite(float(sent)):
                    return leader.place(
                        tuple(map(float, place)), now,
                        float(sent) if "time" in more else None,
                        tuple(map(float, pointing)) if "direction" in more else None,
                    )  # fmt: skip
            case {"velocity": [*velocity]} if len(message) == 1 and _numbers(velocity):
                return leader.velocity(tuple(map(float, velocity)), now)
            case _:
                pass
    raise NotTaken(
        '{"tip": [x, y, z]} [m], with "time" [s] by a clock of your own and "direction": [x, y, z] in the world if you'
        ' like, {"velocity": [x, y, z]} [m/s] or {"end": true} is what may be said;'
        " what was asked before it stands"
    )


def _numbers(values: list[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _object(heard: Message) -> dict[str, Any]:
    """What a socket has heard.

    Raises:
        NotTaken: not a JSON object.
        WebSocketDisconnect: the other side has gone.
    """
    if heard["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(heard["code"])
    if heard.get("text") is None:
        raise NotTaken("a JSON object is needed, not bytes; what was asked before it stands")
    try:
        message = json.loads(heard["text"])
    except (ValueError, RecursionError) as error:
        raise NotTaken(f"not JSON: {error}; what was asked before it stands") from None
    if not isinstance(message, dict):
        raise NotTaken("a JSON object is needed; what was asked before it stands")
    return message


def _answer(service: StationService, run: Run, asked: LeadIn, refused: str) -> dict[str, Any]:
    """What a tip is doing that is led; of its direction where that is controlled."""
    of, row = service.supervisor.channels.of, _row(service)
    desired, measured = of(row, "tip_desired"), of(row, "tip_measured")
    pointing = ("direction_measured", "direction_desired") if asked.points else ()
    return {
        "time": float(row[0]),
        "measured": measured.tolist(),
        "estimated": of(row, "tip_estimated").tolist(),
        "desired": desired.tolist(),
        "force": of(row, "force").tolist(),
        "error": (measured - desired).tolist(),
        **{group: of(row, group).tolist() for group in pointing},
        "held_back": _held_back(service, run, row),
        "refused": refused,
    }


def _held_back(service: StationService, run: Run, row: Array) -> str:
    """What keeps the tip from where it is asked to be, in words; empty when nothing does."""
    of = service.supervisor.channels.of
    sigma = float(of(row, "sigma")[-1])
    limits, floor = run.start.task.controller.limits, run.start.task.controller.aim.floor
    singular = [f"singular pose, sigma {1e3 * sigma:.2g} of {1e3 * floor:g} mm/s"] * (sigma < floor)
    return ", ".join((*singular, *limits.active(of(row, "joints"), of(row, "at_bound"), np.zeros(0))))


def _row(service: StationService) -> Array:
    row = service.supervisor.ring.latest()
    if row is None:
        raise _Refused("there is no telemetry")
    return row


def moves(service: StationService, run: Run) -> bool:
    """Whether the tip of a run may be led now."""
    counters = service.supervisor.ring.counters
    return int(counters[RUN]) == run.number and int(counters[PHASE]) == Phase.MOVING


def over(service: StationService, run: Run) -> bool:
    """Whether a run is not on: it has ended, or the loop has not said a word of it yet."""
    counters = service.supervisor.ring.counters
    return int(counters[RUN]) != run.number or int(counters[STATE]) != State.RUNNING


async def until_over(service: StationService, run: Run) -> None:
    """Wait until a run that may be led has ended."""
    while not over(service, run):
        await asyncio.sleep(LOOK)


async def _close(socket: WebSocket, last: dict[str, str], code: int) -> None:
    told = {key: presentable(text) for key, text in last.items()}
    await socket.send_json(told)
    await socket.close(code, told.get("error", "").encode()[:LONGEST].decode(errors="ignore"))
