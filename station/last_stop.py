"""The last resort: stop the stages without the control process, straight through their ports."""

import time
from collections.abc import Sequence

from station.devices.links import LinkError, SerialLink
from station.devices.zaber import BAUD, GAP, Command, Message, encode

#: Device number 0 addresses every unit of a chain.
STOP = encode(Message(0, Command.STOP, 0))


def stop_stages(ports: Sequence[str]) -> str:
    """Tell every unit on these ports to stop, twice: what came of it, in words, and how long it took.

    Half a message may have been on its way: the units drop it after a silence, so the second stop comes
    after one. Every port is tried, whatever became of the others.
    """
    begin = time.monotonic()
    links: list[SerialLink] = []
    told: list[str] = []
    for port in ports:
        try:
            link = SerialLink(port, BAUD)
            links.append(link)
            link.write(STOP)
            told.append(f"the stages on {port} were told to stop")
        except LinkError as error:
            told.append(f"the stages on {port} cannot be told to stop ({error}): press the emergency stop")
    handed = time.monotonic() - begin
    time.sleep(len(STOP) * 10.0 / BAUD + 1.5 * GAP)
    for link in links:
        try:
            link.write(STOP)
        except LinkError as error:
            told.append(f"{link.name} has gone meanwhile ({error})")
        finally:
            link.close()
    return f"{'; '.join(told)} (bytes handed over {1e3 * handed:.0f} ms after it was noticed)" if told else ""
