"""Sender of a request and its role: the token gives the role; the client itself sends its identity and its name."""

import hmac
import re
import secrets
from enum import StrEnum
from typing import Any, NamedTuple
from urllib.parse import unquote

from starlette.datastructures import Headers
from starlette.types import Scope


class Role(StrEnum):
    """Permissions of a client."""

    OPERATOR = "operator"  #: every request; commands only with the operator's lease
    VIEWER = "viewer"  #: only view the station and send STOP


class Tokens(NamedTuple):
    """The two secret access tokens of one session of the station."""

    operator: str
    viewer: str

    def role(self, given: str) -> Role | None:
        """Return the role of a token, None if it is invalid; the time of the comparison reveals nothing of a token."""
        is_operator = hmac.compare_digest(given.encode(), self.operator.encode())
        is_viewer = hmac.compare_digest(given.encode(), self.viewer.encode())
        if is_operator:
            return Role.OPERATOR
        return Role.VIEWER if is_viewer else None


def new_tokens() -> Tokens:
    """Return new random access tokens."""
    return Tokens(secrets.token_urlsafe(24), secrets.token_urlsafe(24))


#: Names of the headers that distinguish the clients of one computer: a secret identity, and a display name
#: (percent-encoded UTF-8).
CLIENT_HEADER, NAME_HEADER = "x-ctr-client", "x-ctr-name"
MAX_NAME_CHARS = 40
_CLIENT = re.compile(r"[A-Za-z0-9_-]{8,64}")


class Sender(NamedTuple):
    """Sender of a request."""

    role: Role
    client: str  #: secret identity of the client; the operator's lease belongs to it
    name: str  #: display name of the client
    where: str  #: network address of the client

    def __str__(self) -> str:
        return f"{self.name} ({self.role})"


def sender(scope: Scope, headers: Headers, role: Role) -> Sender:
    """Return the sender of a request. All scripts of one computer that send no identity count as one client."""
    where = str(scope["client"][0]) if scope.get("client") else "unknown"
    # Only browsers send `sec-fetch-site`, so this header distinguishes pages from scripts in default names.
    kind = "page" if "sec-fetch-site" in headers else "script"
    given = headers.get(CLIENT_HEADER, "")
    client = given if is_client(given) else f"{kind} at {where}"
    return Sender(role, client, clean_name(unquote(headers.get(NAME_HEADER, ""))) or f"{kind} at {where}", where)


def is_client(text: str) -> bool:
    """Return whether a text is a valid identity of a client."""
    return _CLIENT.fullmatch(text) is not None


def clean_name(text: str) -> str:
    """Return a client's name as one printable line of limited length."""
    return "".join(letter for letter in text.strip() if letter.isprintable())[:MAX_NAME_CHARS]


def sender_of(connection: Any) -> Sender:
    """Return the sender of a request or WebSocket that `Access` has accepted."""
    return connection.scope["state"]["who"]
