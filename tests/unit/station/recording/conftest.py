"""Rows of a robot at rest, and recordings of them."""

from tests.harness.recordings import channels, make_rows, open_writer, recorded

__all__ = ["channels", "make_rows", "open_writer", "recorded"]
