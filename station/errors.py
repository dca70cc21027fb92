"""What goes wrong between a script and a station."""

from core.errors import CtrError


class StationError(CtrError):
    """The station does not answer, or answers with something else than it should."""
