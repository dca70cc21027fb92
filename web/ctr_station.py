"""Entry point of `ctr-station`, installed as the module `ctr_station`; it first checks for name clashes.

`core`, `station` and `web` are common package names, so packages of other projects may have the same names. This module
imports none of these packages before it has checked that they belong to ctr-station. As a mark of ownership, the first
line of each package contains "ctr-station".
"""

import sys
from importlib.util import find_spec
from pathlib import Path

OWN_PACKAGES = ("core", "station", "web")


def main() -> None:
    """Exit with status 2 if a package belongs to another project, otherwise run `web.cli`."""
    for name in OWN_PACKAGES:
        spec = find_spec(name)
        found = None if spec is None else spec.origin
        if found is None or "ctr-station" not in Path(found).read_text(encoding="utf-8", errors="replace"):
            sys.stderr.write(
                f"ctr-station: the package '{name}' found at {found or 'no location'} belongs to another project;"
                " install ctr-station in a separate environment (pipx install, or python3 -m venv), and leave"
                " PYTHONPATH empty\n"
            )
            sys.exit(2)
    try:
        from web.cli import main as commands

        commands()
    except KeyboardInterrupt:  # Ctrl-C while the imports run, which take seconds on a busy computer
        sys.stderr.write("ctr-station: interrupted\n")
        sys.exit(130)
