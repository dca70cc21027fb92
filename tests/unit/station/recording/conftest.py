"""Fixtures with telemetry rows of a robot at rest, and with recordings of such rows."""

from tests.harness.recordings import channels, make_rows, open_writer, recorded

__all__ = ["channels", "make_rows", "open_writer", "recorded"]
