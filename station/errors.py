"""Error of the client of a station."""

from core.errors import CtrError


class StationError(CtrError):
    """The station does not answer, refuses a request, or sends an unexpected response."""
