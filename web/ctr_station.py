"""The command's first step, installed as the module `ctr_station`: `core`, `station` and `web` are common names.

Where another package of such a name is found instead of ours, before it or written over it, nothing of ours can be
relied on; so this file imports nothing of ours until it has looked. Ours name themselves in their first line.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

OURS = ("core", "station", "web")


def main() -> None:
    """Entry point of `ctr-station`: refuses at once, or goes on to `web.cli`."""
    for name in OURS:
        spec = find_spec(name)
        found = None if spec is None else spec.origin
        if found is None or "ctr-station" not in Path(found).read_text(encoding="utf-8", errors="replace"):
            sys.stderr.write(
                f"ctr-station: the package '{name}' found at {found or 'no place'} is not its own; give ctr-station an"
                " environment of its own (pipx install, or python3 -m venv), and leave PYTHONPATH empty\n"
            )
            sys.exit(2)
    from web.cli import main as commands

    commands()
