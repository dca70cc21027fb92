"""Access checks of every connection: known host name, same origin, JSON, small body, and a token for other computers.

The checks are an ASGI middleware, so they apply to HTTP requests and WebSockets alike. For an accepted connection they
store its sender as `who` in the state of the ASGI scope.
"""

import contextlib
import ipaddress
import json
import socket
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from station.config.motions import MAX_TABLE_BYTES
from station.control.commands import Stop
from web.access.identity import Role, Tokens, sender

#: Largest body of a request, and of a request with a motion [bytes]. The check of a body delays STOP.
MAX_BODY_BYTES, MAX_MOTION_BYTES = 64 * 1024, MAX_TABLE_BYTES
#: Starts of the paths whose requests contain a motion.
MOTION_PATHS = ("/api/start", "/api/queue", "/api/trajectory", "/api/waypoints/check", "/api/experiments/")
COOKIE = "ctr_station"
CHANGING_METHODS = ("POST", "PUT", "PATCH", "DELETE")
#: Path at which a page checks that its STOP would be accepted.
STOP_CHECK = f"{Stop.path()}/check"
#: Paths to which viewers may send POST requests: STOP, its check, and queries whose parameters are in a body.
VIEWER_PATHS = (Stop.path(), STOP_CHECK, "/api/model/solve", "/api/calibration/exchange")
#: Reason that is sent to a client without a token.
ACCESS_HINT = "a token is required: open the address with ?token=... that the station prints, or send a bearer token"
FRAME_DESTINATIONS = ("iframe", "frame", "embed", "object")


def is_loopback(host: str) -> bool:
    """Return whether only this computer can reach `host`."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class _TooLargeError(Exception):
    """A request's body exceeds the limit."""


class Access:
    """Refuses connections that come neither from the station's page nor from an authorised script."""

    def __init__(
        self,
        app: ASGIApp,
        host: str,
        port: int,
        tokens: Tokens | None,
        pages: frozenset[str] = frozenset(),
        hint: str = "",
    ) -> None:
        """Wrap `app`, and store the station's address and tokens.

        Args:
            app: the wrapped application.
            host, port: address of the station.
            tokens: access tokens, one of which every client needs; None: any client may connect and become operator.
            pages: origins of other web sites whose pages may connect.
            hint: appended to the reason if another origin is refused.
        """
        self._app = app
        self._tokens, self._pages, self._hint = tokens, pages, hint
        self._port = port
        # A browser shares cookies between all ports of a host, so two stations on one computer need different names.
        self._cookie = f"{COOKIE}_{port}"
        self._any_address = host in ("0.0.0.0", "::")  # noqa: S104 - compared, not bound
        names = {"127.0.0.1", "localhost", "[::1]"} if is_loopback(host) or self._any_address else {bracketed(host)}
        if self._any_address:
            names |= {socket.gethostname().lower(), socket.getfqdn().lower()}
        self._hosts = {f"{name}:{port}" for name in names}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check one connection, and pass it on or refuse it."""
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
            await self._require_token(scope, send)
            return
        scope.setdefault("state", {})["who"] = sender(scope, headers, role)
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
        elif role is Role.VIEWER and scope["method"] in CHANGING_METHODS and scope["path"] not in VIEWER_PATHS:
            await _refuse(scope, send, 403, "viewers may only view and press STOP; this needs the operators' token")
        else:
            await self._with_limit(scope, receive, _unframed(send))

    def refused(self, scope: Scope) -> tuple[int, str] | None:
        """Return HTTP status and reason if a read-only connection is refused; None: the connection is accepted.

        The token may be in the address, because some programs accept only an address.
        """
        headers = Headers(scope=scope)
        if refusal := self._refusal(scope, headers):
            return refusal
        tokens = self._tokens
        if tokens is None or self._role(tokens, headers) or tokens.role(_token_in(scope)):
            return None
        return 401, ACCESS_HINT

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        host, origin = headers.get("host", "").lower(), headers.get("origin")
        if not (host in self._hosts or (self._any_address and self._is_address(host))):
            return 403, f"host '{host}' is not this station's; use {sorted(self._hosts)[0]}"
        if origin in self._pages:
            return None
        # Scripts send no Origin header; a browser sends one with every request that another site could abuse.
        if origin is not None and origin not in (f"http://{host}", f"https://{host}"):
            return 403, f"requests from pages of '{origin}' are refused{self._hint}"
        foreign = headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none")
        follows_link = headers.get("sec-fetch-mode") == "navigate" and scope.get("method") == "GET"
        if foreign and not (follows_link and headers.get("sec-fetch-dest") not in FRAME_DESTINATIONS):
            return 403, "requests from other sites are refused"
        if scope["type"] == "http" and scope["method"] in CHANGING_METHODS:
            return _refused_body(headers, _max_bytes(scope))
        return None

    def _is_address(self, host: str) -> bool:
        """Return whether a host is an IP address with the station's port; an attack by DNS rebinding needs a name."""
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

    async def _require_token(self, scope: Scope, send: Send) -> None:
        given = _token_in(scope)
        if scope["type"] == "http" and self._tokens is not None and self._tokens.role(given):
            cookie = f"{self._cookie}={given}; Path=/; HttpOnly; SameSite=Strict"
            # Redirect to the path only, with one leading slash: after two slashes a browser expects another host, and
            # browsers read `/<tab>/` as two slashes.
            location = "/" + quote(scope["path"].lstrip("/\\"))
            await _answer(send, 303, {"location": location, "set-cookie": cookie, "cache-control": "no-store"}, b"")
        else:
            await _refuse(scope, send, 401, ACCESS_HINT)

    async def _with_limit(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the connection on, but stop reading a body that exceeds the limit or its announced length."""
        received, most = 0, _max_bytes(scope)

        async def limited() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > most:
                raise _TooLargeError
            return message

        async def watched(message: Message) -> None:
            # The answer to an oversized body is sent below, not by the application.
            if received <= most:
                await send(message)

        with contextlib.suppress(_TooLargeError):
            await self._app(scope, limited, watched)
        if received > most:
            await _refuse(scope, send, 413, f"the body is larger than {most} bytes")


def _max_bytes(scope: Scope) -> int:
    return MAX_MOTION_BYTES if scope["path"].startswith(MOTION_PATHS) else MAX_BODY_BYTES


def _refused_body(headers: Headers, most: int) -> tuple[int, str] | None:
    kind, length = headers.get("content-type"), headers.get("content-length", "0")
    if kind is None and length not in ("", "0"):
        return 415, "the body must be application/json; set the content-type header"
    if kind is not None and kind.split(";")[0].strip().lower() != "application/json":
        return 415, f"content-type '{kind}' is not application/json"
    if length.isdigit() and int(length) > most:
        return 413, f"the body has {length} bytes; at most {most} are allowed"
    return None


def _token_in(scope: Scope) -> str:
    """Return the access token in a request's address; empty if there is none."""
    return parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]


def bracketed(host: str) -> str:
    """Return a host as it is written in a URL: an IPv6 address in brackets, a name in lower case."""
    return f"[{host}]" if ":" in host else host.lower()


def _unframed(send: Send) -> Send:
    """Wrap `send` to add headers that forbid other sites to show the page in a frame, against clickjacking."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            headers.append("content-security-policy", "frame-ancestors 'self'")
            headers.append("x-content-type-options", "nosniff")
            headers.append("referrer-policy", "no-referrer")
        await send(message)

    return sending


async def _refuse(scope: Scope, send: Send, status: int, reason: str) -> None:
    # A WebSocket is refused by an HTTP response, because a close frame before the handshake has no reason.
    prefix = "websocket." if scope["type"] == "websocket" else ""
    body = json.dumps({"error": reason}).encode()
    await _answer(send, status, {"content-type": "application/json"}, body, prefix)


async def _answer(send: Send, status: int, headers: dict[str, str], body: bytes, prefix: str = "") -> None:
    lines = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    lines.append((b"content-length", str(len(body)).encode()))
    await send({"type": f"{prefix}http.response.start", "status": status, "headers": lines})
    await send({"type": f"{prefix}http.response.body", "body": body})
