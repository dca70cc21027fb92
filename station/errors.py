"""Error that the Python client of a station raises."""

from core.errors import CtrError


class StationError(CtrError):
    """The station does not answer, refuses a request, or sends an unexpected response."""
