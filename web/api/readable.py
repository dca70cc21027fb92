"""Texts on their way in and out: JSON can spell what is no text, a lone half of a surrogate pair.

No file, no log and no answer takes one, so it is refused at the door, wherever in a body it stands. A file's name
that is not UTF-8 reaches Python as such halves too, so every reason is made presentable on its way out.
"""

import json
from collections.abc import Mapping

from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection, Request


async def readable(connection: HTTPConnection) -> None:
    """Dependency of every route: refuse a body with a text that is none.

    Raises:
        HTTPException: 422, with the half; 400 when the sender has gone before the body was whole.
    """
    if not isinstance(connection, Request):
        return
    try:
        if not await connection.body():
            return
    except ClientDisconnect:
        raise HTTPException(400, "the body was broken off") from None
    try:
        texts = json.dumps(await connection.json(), ensure_ascii=False)
    except (ValueError, RecursionError):
        return  # not JSON: the route says so
    try:
        texts.encode()
    except UnicodeEncodeError as error:
        half = texts[error.start].encode("unicode_escape").decode()
        raise HTTPException(422, f"the body has {half} in a text: half of a surrogate pair; leave it out") from None


def presentable(text: str) -> str:
    """The same text, halves of surrogate pairs and bytes of a file's name that are none shown as numbers."""
    return text.encode(errors="backslashreplace").decode()


def refusal(reason: str, status: int, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """The answer to a request that was refused."""
    return JSONResponse({"error": presentable(reason)}, status, headers)
