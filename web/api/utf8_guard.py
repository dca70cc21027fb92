"""Guard against invalid Unicode: JSON can contain half of a surrogate pair, which UTF-8 cannot encode.

Files, logs and responses cannot contain half of a surrogate pair, so a request body that contains one is refused.
Python also represents a file name that is not UTF-8 by such halves, so every error text is made printable before it is
sent.
"""

import json
from collections.abc import Mapping

from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection, Request


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
