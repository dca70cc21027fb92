"""Third-party clients of a gateway: a Zenoh session and an OpenIGTLink client."""

from collections.abc import Iterator
from contextlib import contextmanager

import zenoh
from pyigtl import OpenIGTLinkClient

from tests.harness.serving import Served


def zenoh_session(port: int, mode: str = "client", way: str = "connect") -> zenoh.Session:
    """Return a Zenoh session that connects only to this port and discovers no other peers."""
    config = zenoh.Config()
    config.insert_json5("mode", f'"{mode}"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5(f"{way}/endpoints", f'["tcp/127.0.0.1:{port}"]')
    return zenoh.open(config)


@contextmanager
def igtl_client(station: Served) -> Iterator[OpenIGTLinkClient]:
    """Yield an OpenIGTLink client connected to the port that the station has printed."""
    (line,) = [
        line for line in station.said.read_text().splitlines() if line.startswith("OpenIGTLink is at 127.0.0.1:")
    ]
    client = OpenIGTLinkClient("127.0.0.1", int(line.rpartition(":")[2]))
    yield client
    client.stop()
