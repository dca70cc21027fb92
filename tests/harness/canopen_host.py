"""A host with the library `canopen`: `python -m tests.harness.canopen_host PORT`.

It executes the lines of its input and prints a line of JSON for each: `read NODE INDEX SUBINDEX`, `write NODE INDEX
SUBINDEX VALUE SIZE`, `nmt NODE STATE`, `heartbeat NODE` (of
node 127, once, to all), `sync NODE` (the process data after a SYNC), `emergency NODE`
(the last error code). The library has threads, so it runs in its own process.
"""

import json
import sys
import time
from collections.abc import Sequence
from typing import Any

import canopen
from canopen.objectdictionary import ObjectDictionary

from tests.harness.waiting import NET


def main() -> None:
    """Execute the commands of the standard input until it ends."""
    network = canopen.Network()
    network.connect(
        interface="slcan", channel=f"socket://127.0.0.1:{sys.argv[1]}", bitrate=1_000_000, sleep_after_open=0.2
    )
    nodes = {number: canopen.RemoteNode(number, ObjectDictionary()) for number in (1, 2, 3)}
    for node in nodes.values():
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = NET  # the default is 0.3 s, for which a busy computer may delay the drives
    data: dict[int, str] = {}
    for number in nodes:
        network.subscribe(0x180 + number, lambda can_id, content, _: data.update({can_id - 0x180: content.hex()}))
    for line in sys.stdin:
        what, number, *rest = line.split()
        sys.stdout.write(json.dumps(_execute(network, nodes[int(number)], data, what, rest)) + "\n")
        sys.stdout.flush()


def _execute(network: Any, node: Any, data: dict[int, str], what: str, rest: Sequence[str]) -> Any:
    try:
        match what:
            case "read":
                return int.from_bytes(node.sdo.upload(int(rest[0], 16), int(rest[1])), "little")
            case "write":
                value, size = int(rest[2]), int(rest[3])
                node.sdo.download(int(rest[0], 16), int(rest[1]), value.to_bytes(size, "little", signed=value < 0))
                return "written"
            case "nmt":
                node.nmt.state = rest[0]
                return rest[0]
            case "sync":
                data.clear()
                network.sync.transmit()
                end = time.monotonic() + 10.0
                while node.id not in data and time.monotonic() < end:
                    time.sleep(0.01)
                return data.get(node.id, "")
            case "heartbeat":
                network.send_message(0x700 + 127, b"\x05")
                return "sent"
            case "emergency":
                if node.emcy.log:
                    return node.emcy.log[-1].code
                found = node.emcy.wait(timeout=10.0)
                return None if found is None else found.code
            case _:
                return f"unknown: {what}"
    except canopen.SdoAbortedError as error:
        return f"aborted 0x{error.code:08X}"


if __name__ == "__main__":
    main()
