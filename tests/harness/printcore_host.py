"""A host with Printrun's `printcore`: `python -m tests.harness.printcore_host PORT BAUD`.

It sends each line of its input, a list of G-code in JSON, as one print with line numbers and checksums. After the print
it writes the received lines as JSON. The library has threads, so it runs in its own process.
"""

import json
import sys
import time

from printrun.gcoder import LightGCode
from printrun.printcore import printcore


def main() -> None:
    """Print every list of the standard input until it ends."""
    host, received = printcore(), list[str]()
    host.addEventHandler(_Listener(received))
    host.connect(sys.argv[1], int(sys.argv[2]))
    while not host.online:
        time.sleep(0.01)
    for line in sys.stdin:
        received.clear()
        host.startprint(LightGCode(json.loads(line)))
        while host.printing or not host.clear:
            time.sleep(0.01)
        sys.stdout.write(f"{json.dumps(received)}\n")
        sys.stdout.flush()
    host.disconnect()


class _Listener:
    """Collects the received lines."""

    def __init__(self, received: list[str]) -> None:
        self._received = received

    def on_recv(self, line: str) -> None:
        self._received.append(line.strip())

    def __getattr__(self, name: str) -> object:
        return lambda *_: None


if __name__ == "__main__":
    main()
