"""Who may talk to the station: exact hosts, same origin, JSON only, small bodies, a token beyond loopback.

Plain ASGI, so that the same checks stand before HTTP requests and websockets. What is let through
carries its sender (`who`) in the scope's state.
"""

import contextlib
import ipaddress
import json
import socket
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from web.access.identity import sender
from web.access.tokens import Role, Tokens

#: Largest request body [bytes].
BODY_LIMIT = 64 * 1024
COOKIE = "ctr_station"
CHANGES = ("POST", "PUT", "PATCH", "DELETE")
#: What viewers may send beside questions: STOP, and questions that need a body.
FOR_VIEWERS = ("/api/stop", "/api/model/solve", "/api/calibration/exchange")
#: What whoever has no token is told.
BRING_ONE = "open the address with ?token=... printed at the start, or send it as a bearer token"
FRAMES = ("iframe", "frame", "embed", "object")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _TooLargeError(Exception):
    """The body goes on beyond the limit."""


class Access:
    """Refuses what does not come from the station's own page or from a script that may."""

    def __init__(
        self, app: ASGIApp, host: str, port: int, tokens: Tokens | None, pages: frozenset[str] = frozenset()
    ) -> None:
        """Where the station listens, and who may.

        Args:
            app: what is behind.
            host, port: where it is reached.
            tokens: demanded from everybody; without them everybody is operator.
            pages: origins of others whose pages may connect, too.
        """
        self._app = app
        self._tokens, self._pages = tokens, pages
        self._port = port
        # Cookies know no ports: two stations on one machine must not take each other's.
        self._cookie = f"{COOKIE}_{port}"
        self._any_address = host in ("0.0.0.0", "::")  # noqa: S104 - compared, not bound
        names = {"127.0.0.1", "localhost", "[::1]"} if is_loopback(host) or self._any_address else {_bracketed(host)}
        if self._any_address:
            names |= {socket.gethostname().lower(), socket.getfqdn().lower()}
        self._hosts = {f"{name}:{port}" for name in names}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await _refuse(scope, send, *refusal)
            return
        role = Role.OPERATOR if self._tokens is None else self._role(self._tokens, headers)
        if role is None:
            await self._ask_for_token(scope, send)
            return
        scope.setdefault("state", {})["who"] = sender(scope, headers, role)
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
        elif role is Role.VIEWER and scope["method"] in CHANGES and scope["path"] not in FOR_VIEWERS:
            await _refuse(scope, send, 403, "viewers may look and press STOP; this needs the operators' token")
        else:
            await self._with_limit(scope, receive, _unframed(send))

    def refused(self, scope: Scope) -> tuple[int, str] | None:
        """Why a connection that is to be looked at only is refused, and with which status; None: it is let in.

        Its token may be in its address: some programs are given an address and nothing else.
        """
        headers = Headers(scope=scope)
        if refusal := self._refusal(scope, headers):
            return refusal
        tokens = self._tokens
        if tokens is None or self._role(tokens, headers) or tokens.role(_token_in(scope)):
            return None
        return 401, BRING_ONE

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        host, origin = headers.get("host", "").lower(), headers.get("origin")
        if not (host in self._hosts or (self._any_address and self._is_address(host))):
            return 403, f"host '{host}' is not this station's; use {sorted(self._hosts)[0]}"
        if origin in self._pages:
            return None
        # Scripts send no origin; a browser always does where it matters.
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return 403, f"requests from pages of '{origin}' are refused"
        foreign = headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none")
        follows_link = headers.get("sec-fetch-mode") == "navigate" and scope.get("method") == "GET"
        if foreign and not (follows_link and headers.get("sec-fetch-dest") not in FRAMES):
            return 403, "requests from other sites are refused"
        if scope["type"] == "http" and scope["method"] in CHANGES:
            return _refused_body(headers)
        return None

    def _is_address(self, host: str) -> bool:
        """A number and our port: unlike a name it cannot be made to point here by somebody else."""
        name, _, port = host.rpartition(":")
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return False
        return port == str(self._port)

    def _role(self, tokens: Tokens, headers: Headers) -> Role | None:
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            cookie = None
        bearer = headers.get("authorization", "").removeprefix("Bearer ")
        return (tokens.role(cookie.value) if cookie else None) or tokens.role(bearer)

    async def _ask_for_token(self, scope: Scope, send: Send) -> None:
        given = _token_in(scope)
        if scope["type"] == "http" and self._tokens is not None and self._tokens.role(given):
            cookie = f"{self._cookie}={given}; Path=/; HttpOnly; SameSite=Strict"
            # Only the path, as it came, and only one slash: an address that begins with two is another host's, and
            # browsers take `/<tab>/` for two.
            location = "/" + quote(scope["path"].lstrip("/\\"))
            await _answer(send, 303, {"location": location, "set-cookie": cookie, "cache-control": "no-store"}, b"")
        else:
            await _refuse(scope, send, 401, BRING_ONE)

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


def _refused_body(headers: Headers) -> tuple[int, str] | None:
    kind, length = headers.get("content-type"), headers.get("content-length", "0")
    if kind is None and length not in ("", "0"):
        return 415, "the body must be application/json; set the content-type header"
    if kind is not None and kind.split(";")[0].strip().lower() != "application/json":
        return 415, f"content-type '{kind}' is not application/json"
    if length.isdigit() and int(length) > BODY_LIMIT:
        return 413, f"the body has {length} bytes; at most {BODY_LIMIT} are taken"
    return None


def _token_in(scope: Scope) -> str:
    """That an address brings along; empty without."""
    return parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host.lower()


def _unframed(send: Send) -> Send:
    """No page of another site shows ours in a frame, where clicks could be led astray."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.append("content-security-policy", "frame-ancestors 'self'")
            headers.append("x-content-type-options", "nosniff")
            headers.append("referrer-policy", "no-referrer")
        await send(message)

    return sending


async def _refuse(scope: Scope, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason[:120]})
        return
    await _answer(send, status, {"content-type": "application/json"}, json.dumps({"error": reason}).encode())


async def _answer(send: Send, status: int, headers: dict[str, str], body: bytes) -> None:
    lines = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    lines.append((b"content-length", str(len(body)).encode()))
    await send({"type": "http.response.start", "status": status, "headers": lines})
    await send({"type": "http.response.body", "body": body})
