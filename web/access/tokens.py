"""Who is let in beyond loopback: one token for operators, one for viewers."""

import hmac
import secrets
from enum import StrEnum
from typing import NamedTuple


class Role(StrEnum):
    """What somebody may do."""

    OPERATOR = "operator"  #: everything, once they hold the lease
    VIEWER = "viewer"  #: look, and STOP


class Tokens(NamedTuple):
    """The two secrets of one session."""

    operator: str
    viewer: str

    def role(self, given: str) -> Role | None:
        """The role that a token gives; None for a token that is none. Takes as long whatever was given."""
        is_operator = hmac.compare_digest(given.encode(), self.operator.encode())
        is_viewer = hmac.compare_digest(given.encode(), self.viewer.encode())
        if is_operator:
            return Role.OPERATOR
        return Role.VIEWER if is_viewer else None


def new_tokens() -> Tokens:
    """Tokens nobody guesses."""
    return Tokens(secrets.token_urlsafe(24), secrets.token_urlsafe(24))
