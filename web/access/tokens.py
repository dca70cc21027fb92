"""Access tokens for clients of other computers: one for operators, one for viewers."""

import hmac
import secrets
from enum import StrEnum
from typing import NamedTuple


class Role(StrEnum):
    """Permissions of a client."""

    OPERATOR = "operator"  #: every request; commands only with the operator's lease
    VIEWER = "viewer"  #: only view the station and send STOP


class Tokens(NamedTuple):
    """The two secret access tokens of one session of the station."""

    operator: str
    viewer: str

    def role(self, given: str) -> Role | None:
        """Return the role of a token, None if the token is invalid; the time does not depend on the token."""
        is_operator = hmac.compare_digest(given.encode(), self.operator.encode())
        is_viewer = hmac.compare_digest(given.encode(), self.viewer.encode())
        if is_operator:
            return Role.OPERATOR
        return Role.VIEWER if is_viewer else None


def new_tokens() -> Tokens:
    """Return new random access tokens."""
    return Tokens(secrets.token_urlsafe(24), secrets.token_urlsafe(24))
