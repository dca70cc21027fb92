"""The command `ctr-station`."""

import sys

from station.cli import execute, parser


def main() -> None:
    """Entry point."""
    top, _commands = parser()
    sys.exit(execute(top, None))
