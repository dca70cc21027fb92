"""`WS /api/setpoints`: a client streams setpoints of the tip while it is operator.

    {"controller": {"task": "position_and_direction"}}     first message: a `StreamAgreement`; {} uses the defaults
    {"tip": [0.0, 0.0, 0.002], "time": 12.34, "direction": [0.1, 0.0, 1.0]}
    {"velocity": [0.0, 0.0, 0.001]}
    {"end": true}

`tip` is in the `frame` of the first message, `direction` is always in the world frame.
"""

import asyncio
import contextlib
import json
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic import ValidationError
from starlette.types import Message

from core.control.setpoint_request import SetpointRequest
from core.errors import CtrError
from core.robot.robot import Array
from station.control.ring import PHASE, RUN
from station.control.task import Phase
from station.service.audit import Audit
from station.service.commands import StreamAgreement
from station.service.runs import RunRequest
from station.service.setpoint_stream import RateExceeded, SetpointRefused, SetpointStream
from station.service.supervisor import Supervisor
from web.access.identity import Role, Sender, sender_of
from web.access.lease import Lease, LeaseHeldError
from web.api.commands import commanding, permit_of
from web.api.refusals import close_reason, printable

#: Interval between two checks whether the streamed run continues [s].
RUN_POLL_INTERVAL_S = 0.02
#: Time within which a client must send the first message after it has connected [s].
FIRST_MESSAGE_TIMEOUT_S = 20.0
#: Largest number of answers queued for a client that does not read; the oldest are dropped first.
MAX_ANSWERS = 500
#: Close codes of the WebSocket (RFC 6455): normal end; refusal; messages that are too frequent or too long.
NORMAL_CLOSURE, POLICY_VIOLATION, MESSAGE_TOO_BIG = 1000, 1008, 1009
#: Close code of a client that has disconnected without a close frame (RFC 6455).
NOT_CLOSED = 1006


def setpoint_routes(supervisor: Supervisor, lease: Lease, audit: Audit) -> APIRouter:
    """Return the route `/api/setpoints`. Its client must be operator; it becomes operator if there is no operator."""
    router = APIRouter(prefix="/api")

    @router.websocket("/setpoints")
    async def setpoints(socket: WebSocket) -> None:
        await socket.accept()
        who, run = sender_of(socket), None
        try:
            agreement, run = await _start_run(socket, supervisor, lease, who)
            # Logged before the answer is sent, because the run has started even if the client has disconnected by now.
            audit.write(str(who), f"setpoints of run {run.id}", who.where, "started")
            await socket.send_json({"run_id": run.id, "warnings": run.start.warnings})
            await _wait_until_ready(socket, supervisor, lease, who, run)
            await _follow_messages(socket, supervisor, lease, who, agreement, run)
        except _Refused as error:
            await _close(socket, {"error": str(error)}, error.code)
        except (WebSocketDisconnect, RuntimeError):
            return  # the client has disconnected
        finally:
            if run is not None:
                supervisor.send_setpoint(run, None)
                audit.write(str(who), f"setpoints of run {run.id}", who.where, "ended")

    return router


class _Refused(CtrError):
    """The station ends the stream of setpoints; the text is the reason."""

    def __init__(self, text: str, code: int = POLICY_VIOLATION) -> None:
        super().__init__(text)
        self.code = code


async def _start_run(
    socket: WebSocket, supervisor: Supervisor, lease: Lease, who: Sender
) -> tuple[StreamAgreement, RunRequest]:
    """Start the streamed run that the client's first message specifies."""
    if who.role is not Role.OPERATOR:
        raise _Refused("viewers may only view and press STOP; this needs the operators' token")
    try:
        first = await asyncio.wait_for(socket.receive(), FIRST_MESSAGE_TIMEOUT_S)
        permit = supervisor.permit(permit_of(socket).gone)  # issued now: this message requests the motion
        agreement = StreamAgreement.model_validate(_object(first), strict=False)
        async with commanding(lease, who, permit) as permit:
            outcome = await asyncio.to_thread(supervisor.send, agreement, permit)
    except TimeoutError:
        raise _Refused(
            f"no message for {FIRST_MESSAGE_TIMEOUT_S:g} s; the first message starts the run, {{}} uses the defaults"
        ) from None
    except ValidationError as error:
        first = error.errors()[0]
        raise _Refused(f"{'.'.join(map(str, first['loc'])) or 'message'}: {first['msg']}") from None
    except CtrError as error:
        raise _Refused(str(error)) from None
    return agreement, outcome.started


async def _wait_until_ready(
    socket: WebSocket, supervisor: Supervisor, lease: Lease, who: Sender, run: RunRequest
) -> None:
    """Wait until the run accepts setpoints; meanwhile the tip rests and the force sensors are zeroed.

    Raises:
        WebSocketDisconnect: the client has disconnected; its lease is not renewed any longer.
    """
    gone = permit_of(socket).gone

    def client_is_connected() -> None:
        if gone is not None and gone():
            raise WebSocketDisconnect(NOT_CLOSED)
        lease.renew(who.client)

    if not await until_accepting(supervisor, run, client_is_connected):
        status = supervisor.status()
        raise _Refused(f"the run ended before it moved: {status.state.name} {status.cause}".strip(), NORMAL_CLOSURE)


async def _follow_messages(
    socket: WebSocket, supervisor: Supervisor, lease: Lease, who: Sender, agreement: StreamAgreement, run: RunRequest
) -> None:
    """Pass the client's setpoints on to the run until the run ends or the client disconnects."""
    now, row = supervisor.bench.clock.now, _row(supervisor)
    start = supervisor.channels.of(row, "tip_desired").copy()
    stream = SetpointStream(agreement, start, now())
    ready = {"ready": True, "tip": start.tolist(), "time": float(row[0])}
    if agreement.controls_direction:
        ready["direction"] = supervisor.channels.of(row, "direction_desired").tolist()
    await socket.send_json(ready)
    last_valid, end_sent = now(), False
    waiting, arrived, answers = list[Message](), asyncio.Event(), deque[str](maxlen=MAX_ANSWERS)
    watch = asyncio.create_task(until_over(run))
    watch.add_done_callback(lambda _: arrived.set())
    answered = asyncio.Event()
    tasks = [
        watch,
        asyncio.create_task(_receive(socket, waiting, arrived)),
        asyncio.create_task(_send_answers(socket, supervisor, run, agreement, answers, answered)),
    ]
    try:
        while True:
            await arrived.wait()
            arrived.clear()
            if watch.done():
                break
            batch, waiting[:] = tuple(waiting), ()
            try:
                setpoint, refusals, ends = _newest(stream, lease, who, batch, now(), end_sent)
            except RateExceeded as error:
                raise _Refused(str(error), MESSAGE_TOO_BIG) from None
            if ends:
                end_sent = True
                supervisor.send_setpoint(run, None)
            elif setpoint is not None:
                supervisor.send_setpoint(run, setpoint)
                last_valid = now()
            answers.extend(refusals)
            answered.set()
    finally:
        for task in tasks:
            task.cancel()
    status = supervisor.status()
    # The control loop measures the time without setpoints from a slightly different start, so half of the limit counts.
    timeout = agreement.end
    silent = "" if end_sent or now() - last_valid < 0.5 * timeout else f"no valid setpoint for {timeout:g} s"
    await _close(socket, {"ended": status.state.name, "cause": status.cause or silent}, NORMAL_CLOSURE)


async def _receive(socket: WebSocket, waiting: list[Message], arrived: asyncio.Event) -> None:
    """Append each received message to `waiting`, so that all messages that have arrived can be handled together."""
    while not waiting or waiting[-1]["type"] != "websocket.disconnect":
        waiting.append(await socket.receive())
        arrived.set()


async def _send_answers(
    socket: WebSocket,
    supervisor: Supervisor,
    run: RunRequest,
    agreement: StreamAgreement,
    answers: deque[str],
    answered: asyncio.Event,
) -> None:
    """Answer every message of the client. A client that does not read its answers delays only this task."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError, _Refused):  # no client or no telemetry
        while True:
            await answered.wait()
            answered.clear()
            tip = _tip_out(supervisor, run, agreement)
            while answers:
                await socket.send_json({**tip, "refused": answers.popleft()})


def _newest(
    stream: SetpointStream, lease: Lease, who: Sender, batch: Sequence[Message], now: float, end_sent: bool
) -> tuple[SetpointRequest | None, list[str], bool]:
    """Return the newest setpoint of a batch of messages, the refusals, and whether a message ends the run.

    Raises:
        RateExceeded: the messages arrive faster than allowed.
        WebSocketDisconnect: the client has disconnected.
    """
    setpoint, refusals, ends = None, list[str](), False
    for each in batch:
        stream.count(now)
        try:
            message = _object(each)
            if len(message) == 1 and message.get("end") is True:
                ends = True
                continue
            if end_sent or ends:
                raise SetpointRefused('{"end": true} was sent before; the run ends')
            lease.keep(who.client, who.name)
            setpoint = _setpoint_request(stream, message, now)
            refusals.append("")
        except (SetpointRefused, LeaseHeldError) as error:
            refusals.append(str(error))
    return setpoint, refusals, ends


def _setpoint_request(stream: SetpointStream, message: dict[str, Any], now: float) -> SetpointRequest:
    with contextlib.suppress(OverflowError):  # an integer that is too large for a float
        match message:
            case {"tip": [*position], **more} if set(more) <= {"time", "direction"} and _numbers(position):
                sent, direction = more.get("time", 0.0), more.get("direction", [])
                if isinstance(direction, list) and _numbers([sent, *direction]) and math.isfinite(float(sent)):
                    return stream.position(
                        tuple(map(float, position)), now,
                        float(sent) if "time" in more else None,
                        tuple(map(float, direction)) if "direction" in more else None,
                    )  # fmt: skip
            case {"velocity": [*velocity]} if len(message) == 1 and _numbers(velocity):
                return stream.velocity(tuple(map(float, velocity)), now)
            case _:
                pass
    raise SetpointRefused(
        'send {"tip": [x, y, z]} [m], optionally with "time" [s] of your clock and "direction": [x, y, z] in the world;'
        ' or {"velocity": [x, y, z]} [m/s]; or {"end": true}; the previous setpoint stays in effect'
    )


def _numbers(values: list[Any]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _object(received: Message) -> dict[str, Any]:
    """Return the JSON object of a received message.

    Raises:
        SetpointRefused: the message is not a JSON object.
        WebSocketDisconnect: the client has disconnected.
    """
    if received["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(received["code"])
    if received.get("text") is None:
        raise SetpointRefused("a JSON object is needed, not bytes; the previous setpoint stays in effect")
    try:
        message = json.loads(received["text"])
    except (ValueError, RecursionError) as error:
        raise SetpointRefused(f"not JSON: {error}; the previous setpoint stays in effect") from None
    if not isinstance(message, dict):
        raise SetpointRefused("a JSON object is needed; the previous setpoint stays in effect")
    return message


def _tip_out(supervisor: Supervisor, run: RunRequest, agreement: StreamAgreement) -> dict[str, Any]:
    """Return tip, force and error of a streamed run, and the tip's directions if the direction is controlled."""
    of, row = supervisor.channels.of, _row(supervisor)
    desired, measured = of(row, "tip_desired"), of(row, "tip_measured")
    directions = ("direction_measured", "direction_desired") if agreement.controls_direction else ()
    return {
        "time": float(row[0]),
        "measured": measured.tolist(),
        "estimated": of(row, "tip_estimated").tolist(),
        "desired": desired.tolist(),
        "force": of(row, "force").tolist(),
        "error": (measured - desired).tolist(),
        **{group: of(row, group).tolist() for group in directions},
        "held_back": _limiting_reason(supervisor, run, row),
    }


def _limiting_reason(supervisor: Supervisor, run: RunRequest, row: Array) -> str:
    """Return the names of the limits that keep the tip from its setpoint; empty if no limit is active."""
    of = supervisor.channels.of
    sigma = float(of(row, "sigma")[-1])
    limits, floor = run.start.task.controller.limits, run.start.task.controller.aim.floor
    singular = [f"singular pose, sigma {1e3 * sigma:.2g} of {1e3 * floor:g} mm/s"] * (sigma < floor)
    return ", ".join((*singular, *limits.active(of(row, "joints"), of(row, "at_bound"), np.zeros(0))))


def _row(supervisor: Supervisor) -> Array:
    row = supervisor.ring.latest()
    if row is None:
        raise _Refused("there is no telemetry before the stages are homed")
    return row


async def until_accepting(
    supervisor: Supervisor, run: RunRequest, meanwhile: Callable[[], None] = lambda: None
) -> bool:
    """Wait until a streamed run accepts setpoints; return False if the run, or its control process, has ended before.

    `meanwhile` is called at each check and may end the wait by an exception.
    """
    ring = supervisor.ring
    while not run.end.done():
        # Right after the start, the control loop may not yet report the run.
        if int(ring.counters[RUN]) == run.number and int(ring.counters[PHASE]) == Phase.MOVING:
            return True
        meanwhile()
        await asyncio.sleep(RUN_POLL_INTERVAL_S)
    return False


async def until_over(run: RunRequest) -> None:
    """Wait until a streamed run, or its control process, has ended."""
    while not run.end.done():
        await asyncio.sleep(RUN_POLL_INTERVAL_S)


async def _close(socket: WebSocket, last: dict[str, str], code: int) -> None:
    message = {key: printable(text) for key, text in last.items()}
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the client has disconnected
        await socket.send_json(message)
        await socket.close(code, close_reason(message.get("error", "")))
