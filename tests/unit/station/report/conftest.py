"""Recordings of synthetic rows."""

from tests.harness.recordings import channels, make_rows, open_writer, recorded

__all__ = ["channels", "make_rows", "open_writer", "recorded"]
