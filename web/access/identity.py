"""Who sent a request, as far as that can be known: role by token, identity and name as they say themselves."""

import re
from typing import Any, NamedTuple
from urllib.parse import unquote

from starlette.datastructures import Headers
from starlette.types import Scope

from web.access.tokens import Role

#: A page or a script that wants to be told apart from others of its machine sends an identity that
#: nobody else knows, and a name for people (percent-encoded UTF-8).
CLIENT, NAME = "x-ctr-client", "x-ctr-name"
LONGEST_NAME = 40
_CLIENT = re.compile(r"[A-Za-z0-9_-]{8,64}")


class Who(NamedTuple):
    """The sender."""

    role: Role
    client: str  #: identity; holds the lease
    name: str  #: for people
    where: str  #: address

    def __str__(self) -> str:
        return f"{self.name} ({self.role})"


def sender(scope: Scope, headers: Headers, role: Role) -> Who:
    """Who sent this; without an identity all scripts of one machine are one."""
    where = str(scope["client"][0]) if scope.get("client") else "unknown"
    # Browsers say where a fetch comes from, scripts do not.
    kind = "page" if "sec-fetch-site" in headers else "script"
    given = headers.get(CLIENT, "")
    client = given if is_client(given) else f"{kind} at {where}"
    return Who(role, client, clean_name(unquote(headers.get(NAME, ""))) or f"{kind} at {where}", where)


def is_client(text: str) -> bool:
    """Whether this can be an identity."""
    return _CLIENT.fullmatch(text) is not None


def clean_name(text: str) -> str:
    """A name that can be shown: one line, printable, not too long."""
    return "".join(letter for letter in text.strip() if letter.isprintable())[:LONGEST_NAME]


def who_of(connection: Any) -> Who:
    """The sender of a request or websocket that has come through `access`."""
    return connection.scope["state"]["who"]
