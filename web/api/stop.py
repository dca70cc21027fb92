"""STOP over HTTP and over a WebSocket that a page keeps open for STOP alone, and a check that STOP would be accepted.

`WS /api/stop/socket`: the message `check` is answered by `{}`. Every other message is a STOP, even a malformed one; a
page sends `{"press": random text, "client": identity, "name": text}` and gets the outcome with the same text.
"""

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from fastapi import APIRouter, Depends, Request, Response, WebSocket, WebSocketDisconnect

from core.errors import CtrError
from station.control.commands import Stop
from station.service.audit import Audit
from station.service.supervisor import Supervisor
from web.access.audit_middleware import Repeats
from web.access.gate import STOP_CHECK
from web.access.identity import Sender, clean_name, is_client, sender_of
from web.access.lease import Lease
from web.api.commands import Commands, described, stopper
from web.api.schemas import StopCheckOut, StopOut

#: Text by which the audit log names a STOP that arrived over a WebSocket.
LOGGED = "STOP over the socket of a page"
#: Number of presses whose outcomes are remembered.
REMEMBERED_PRESSES = 256
#: Header of `POST /api/stop` with the random text that identifies a press.
PRESS_HEADER = "x-ctr-press"


class Stops:
    """Executes STOP for every client, and remembers who has sent the newest one.

    A page sends a press several times. A copy that arrives late must not stop a later motion, so only the first one is
    executed, and every copy gets the same answer.
    """

    def __init__(self, supervisor: Supervisor, lease: Lease, threads: ThreadPoolExecutor) -> None:
        """`threads` are reserved for STOP."""
        self._supervisor, self._lease, self._threads = supervisor, lease, threads
        self._client = self._cause = ""
        self._presses: dict[str, asyncio.Task[StopOut]] = {}

    async def send(self, who: Sender, press: str = "") -> StopOut:
        """Stop every axis, and return the outcome; `press` identifies the copies of one press (empty: no copies)."""
        if not is_client(press):
            return await self._execute(who)
        if press not in self._presses:
            self._presses[press] = task = asyncio.create_task(self._execute(who))
            task.add_done_callback(partial(self._done, press))
            while len(self._presses) > REMEMBERED_PRESSES:
                del self._presses[next(iter(self._presses))]
        # The press is executed even if the client of this copy disconnects.
        return await asyncio.shield(self._presses[press])

    def _done(self, press: str, task: asyncio.Task[StopOut]) -> None:
        """Forget a press that has failed, so that its next copy is executed."""
        if task.cancelled() or task.exception() is not None or not task.result().confirmed:
            self._presses.pop(press, None)

    async def _execute(self, who: Sender) -> StopOut:
        self._client, self._cause = who.client, f"stopped by {stopper(self._lease, who)}"
        stop = partial(self._supervisor.send, Stop(cause=self._cause))
        outcome = await asyncio.get_running_loop().run_in_executor(self._threads, stop)
        state = self._supervisor.status().state.name
        return StopOut(state=state, note=outcome.note, confirmed=outcome.confirmed)

    def own_cause(self, who: Sender) -> str:
        """Return the reported cause of the newest STOP if `who` has sent it; otherwise an empty text."""
        return self._cause if who.client == self._client else ""


def stop_routes(stops: Stops, of: Commands, audit: Audit) -> APIRouter:
    """Return the routes of STOP under /api."""
    router, repeats = APIRouter(), Repeats(audit)

    @router.post(
        Stop.path(),
        responses={202: {"model": StopOut, "description": "accepted with a note; see `confirmed` and `note`"}},
        dependencies=[Depends(of.renew_lease)],
        **described(Stop),
    )
    async def stop(request: Request, response: Response) -> StopOut:
        answer = await stops.send(sender_of(request), request.headers.get(PRESS_HEADER, ""))
        if answer.note:
            response.status_code = 202
        return answer

    @router.post(STOP_CHECK, summary="Check that a STOP of this client would be accepted")
    async def check() -> StopCheckOut:
        """Do nothing; a client for whom STOP is refused gets the same refusal here."""
        return StopCheckOut(accepted=True)

    @router.websocket(f"{Stop.path()}/socket")
    async def socket(socket: WebSocket) -> None:
        await socket.accept()
        try:
            while True:
                text = await socket.receive_text()
                repeats.sum_up()
                await socket.send_json({} if text == "check" else await _stop(stops, repeats, sender_of(socket), text))
        except (WebSocketDisconnect, RuntimeError, KeyError):
            return  # the client has disconnected, or has sent bytes instead of a text

    return router


async def _stop(stops: Stops, repeats: Repeats, who: Sender, text: str) -> dict[str, Any]:
    """Execute the STOP of a message, and return the answer to it."""
    message = _object(text)
    client, name = message.get("client"), message.get("name")
    if isinstance(client, str) and is_client(client):
        who = who._replace(client=client)
    if isinstance(name, str) and clean_name(name):
        who = who._replace(name=clean_name(name))
    press = message["press"] if isinstance(message.get("press"), str) else ""
    try:
        answer, outcome = (await stops.send(who, press)).model_dump(), "200"
    except CtrError as error:
        answer, outcome = {"error": str(error)}, str(error)
    repeats.add(str(who), str(who.role), LOGGED, who.where, outcome)
    return {"press": press, **answer}


def _object(text: str) -> dict[str, Any]:
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}
