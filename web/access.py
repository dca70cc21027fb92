"""Who may talk to the station: exact hosts, same origin, JSON only, small bodies, a token beyond loopback.

Plain ASGI, so that the same checks stand before HTTP requests and websockets.
"""

import contextlib
import hmac
import ipaddress
import json
import secrets
from http.cookies import SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: Largest request body [bytes].
BODY_LIMIT = 64 * 1024
COOKIE = "ctr_station"
CHANGES = ("POST", "PUT", "PATCH", "DELETE")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def new_token() -> str:
    """A token nobody guesses."""
    return secrets.token_urlsafe(24)


class _TooLargeError(Exception):
    """The body goes on beyond the limit."""


class Access:
    """Refuses what does not come from the station's own page or from a script that may."""

    def __init__(self, app: ASGIApp, host: str, port: int, token: str | None) -> None:
        self._app = app
        self._token = token
        if is_loopback(host):
            self._hosts: set[str] | None = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]")}
        elif host in ("0.0.0.0", "::"):  # noqa: S104 - compared, not bound
            self._hosts = None  # any name of this machine; the token's cookie belongs to one of them
        else:
            self._hosts = {f"{host}:{port}"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await _refuse(scope, send, *refusal)
        elif self._token is not None and not self._has_token(headers):
            await self._ask_for_token(scope, send)
        elif scope["type"] == "http":
            await self._with_limit(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        host, origin = headers.get("host", ""), headers.get("origin")
        if self._hosts is not None and host not in self._hosts:
            return 403, f"host '{host}' is not this station's; use {sorted(self._hosts)[0]}"
        # Scripts send no origin; a browser always does where it matters.
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return 403, f"requests from pages of '{origin}' are refused"
        foreign = headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none")
        follows_link = headers.get("sec-fetch-mode") == "navigate" and scope.get("method") == "GET"
        if foreign and not follows_link:
            return 403, "requests from other sites are refused"
        if scope["type"] == "http" and scope["method"] in CHANGES:
            kind, length = headers.get("content-type"), headers.get("content-length", "0")
            if kind is None and length not in ("", "0"):
                return 415, "the body must be application/json; set the content-type header"
            if kind is not None and kind.split(";")[0].strip().lower() != "application/json":
                return 415, f"content-type '{kind}' is not application/json"
            if length.isdigit() and int(length) > BODY_LIMIT:
                return 413, f"the body has {length} bytes; at most {BODY_LIMIT} are taken"
        return None

    def _has_token(self, headers: Headers) -> bool:
        cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        bearer = headers.get("authorization", "").removeprefix("Bearer ")
        return any(
            hmac.compare_digest(given.encode(), str(self._token).encode())
            for given in (cookie.value if cookie else "", bearer)
        )

    async def _ask_for_token(self, scope: Scope, send: Send) -> None:
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if scope["type"] == "http" and hmac.compare_digest(given.encode(), str(self._token).encode()):
            cookie = f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict"
            await _answer(send, 303, {"location": scope["path"], "set-cookie": cookie}, b"")
        else:
            await _refuse(
                scope, send, 401, "open the address with ?token=... printed at the start, or send it as a bearer token"
            )

    async def _with_limit(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Stop reading a body that is longer than it may be or than it said."""
        taken = 0

        async def limited() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > BODY_LIMIT:
                raise _TooLargeError
            return message

        async def watched(message: Message) -> None:
            # Whatever the application makes of the broken body, the answer is ours.
            if taken <= BODY_LIMIT:
                await send(message)

        with contextlib.suppress(_TooLargeError):
            await self._app(scope, limited, watched)
        if taken > BODY_LIMIT:
            await _refuse(scope, send, 413, f"the body is larger than {BODY_LIMIT} bytes")


async def _refuse(scope: Scope, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
        return
    await _answer(send, status, {"content-type": "application/json"}, json.dumps({"error": reason}).encode())


async def _answer(send: Send, status: int, headers: dict[str, Any], body: bytes) -> None:
    lines = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    lines.append((b"content-length", str(len(body)).encode()))
    await send({"type": "http.response.start", "status": status, "headers": lines})
    await send({"type": "http.response.body", "body": body})
