"""Answers to refused requests: errors of the station, invalid values, and invalid Unicode.

JSON can contain half of a surrogate pair; files, logs and responses cannot. A request body with such a half is refused.
Python also represents a file name that is not UTF-8 by such halves, so every error text is made printable before it is
sent.
"""

import json
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError, WebSocketRequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection

from core.errors import CtrError
from station.config.strict import error_lines, key_of
from station.control.states import RefusedError

#: Largest length of the reason in a WebSocket's close frame [bytes] (RFC 6455).
MAX_CLOSE_REASON_BYTES = 123


async def require_utf8(connection: HTTPConnection) -> None:
    """Dependency of every route: refuse a body with invalid Unicode.

    Raises:
        HTTPException: status 422 with the invalid half; 400 if the client disconnected before the body was complete.
    """
    if not isinstance(connection, Request):
        return
    try:
        if not await connection.body():
            return
    except ClientDisconnect:
        raise HTTPException(400, "the connection was closed before the body was complete") from None
    try:
        texts = json.dumps(await connection.json(), ensure_ascii=False)
    except (ValueError, RecursionError):
        return  # the route itself refuses a body that is not JSON
    try:
        texts.encode()
    except UnicodeEncodeError as error:
        half = texts[error.start].encode("unicode_escape").decode()
        raise HTTPException(422, f"the body has {half} in a text: half of a surrogate pair; remove it") from None


def printable(text: str) -> str:
    """Return the text with halves of surrogate pairs replaced by escape sequences."""
    return text.encode(errors="backslashreplace").decode()


def refusal(reason: str, status: int, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """Return the response to a refused request."""
    return JSONResponse({"error": printable(reason)}, status, headers)


def close_reason(text: str) -> str:
    """Return the text cut to the length of a WebSocket's close reason."""
    return text.encode()[:MAX_CLOSE_REASON_BYTES].decode(errors="ignore")


def answer_errors(app: FastAPI) -> None:
    """Make the application answer every error of a request with its reason."""

    @app.exception_handler(RequestValidationError)
    def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        # The response omits the input: JSON cannot represent a NaN in it.
        return refusal(_reason(error), 422)

    @app.exception_handler(WebSocketRequestValidationError)
    async def invalid_socket(socket: WebSocket, error: WebSocketRequestValidationError) -> None:
        # The connection is refused by an HTTP response, because a close frame before the handshake has no reason.
        reason = "; ".join(error_lines(error.errors(), lambda loc: _field(loc, None), "field"))
        await socket.send_denial_response(refusal(reason, 422))

    @app.exception_handler(RefusedError)
    def refused(_request: Request, error: RefusedError) -> JSONResponse:
        return refusal(str(error), 409)

    @app.exception_handler(CtrError)
    def wrong(_request: Request, error: CtrError) -> JSONResponse:
        return refusal(str(error), 422)

    @app.exception_handler(HTTPException)
    def other(request: Request, error: HTTPException) -> JSONResponse:
        unknown = error.detail in ("Not Found", "Method Not Allowed")  # by Starlette, if no route fits
        what = f"there is no {request.method} {request.url.path}; /api/docs lists all requests"
        return refusal(what if unknown else str(error.detail), error.status_code, error.headers)


def _reason(error: RequestValidationError) -> str:
    """Return all validation errors of a request in one line: fields, values, and what was expected."""
    errors = error.errors()
    if errors[0]["type"] == "json_invalid":
        return f"the body is not JSON: {errors[0].get('ctx', {}).get('error', '')}"
    return "; ".join(error_lines(errors, lambda loc: _field(loc, error.body), "field"))


def _field(loc: tuple[int | str, ...], body: Any) -> str:
    """Return the location of a field in a request, counted from one, such as `trajectory.points, row 1, number 4`."""
    *parts, last = key_of(loc[1:] if loc[:1] in (("body",), ("query",)) else loc, body).split(".")
    number = [f"number {int(last) + 1}"] if last.isdecimal() else []
    name = ".".join(parts if number else (*parts, last))
    head, _, row = name.rpartition(".")
    if number and row.isdecimal():
        return f"{head}, row {int(row) + 1}, {number[0]}"
    return ", ".join((name, *number)) or "body"
