"""The fallback stop of a process without free file descriptors, on simulated stages that move."""

import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from station.config.robots import RobotFile
from station.control.clock import REAL_TIME_CLOCK
from station.devices.links.link import SerialLink
from station.devices.zaber.protocol import BAUD, MESSAGE_TIME_S, ZaberCommand, ZaberMessage, encode
from station.service.fallback_stop import FallbackStop
from tests.harness.watched_lab import WatchedLab


@contextmanager
def no_descriptors() -> Iterator[None]:
    """Take every file descriptor that this process may open."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(int(file.name) for file in Path("/proc/self/fd").iterdir())
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 1, limits[1]))
    taken: list[int] = []
    try:
        with suppress(OSError):
            while True:
                taken.append(os.open(os.devnull, os.O_RDONLY))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        for file in taken:
            os.close(file)


def test_stages_are_stopped_by_a_process_without_free_descriptors(paper: RobotFile) -> None:
    with WatchedLab() as lab:
        stop = FallbackStop({"driver": "zaber", "port": lab.endpoints["zaber"]}, paper, REAL_TIME_CLOCK)
        link = SerialLink(lab.endpoints["zaber"], BAUD)
        for device in (1, 2, 3):
            link.write(encode(ZaberMessage(device, ZaberCommand.MOVE_SPEED, -500)))
            time.sleep(2 * MESSAGE_TIME_S)
        link.close()
        try:
            with no_descriptors():
                stopped = stop(10.0)
            assert stopped.confirmed, stopped.text
            assert stopped.text.startswith("3 stages on ")
            assert not lab.moving()
        finally:
            stop.close(10.0)
