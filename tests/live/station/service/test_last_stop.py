"""The last stop when this process is at the end of its means, on simulated stages that really move."""

import os
import resource
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from station.config.robots import RobotFile
from station.control.clock import REAL_TIME
from station.devices.links.link import SerialLink
from station.devices.zaber.protocol import BAUD, MESSAGE_TIME, Command, Message, encode
from station.service.last_stop import LastStop
from tests.harness.watched_lab import WatchedLab


@contextmanager
def no_descriptors() -> Iterator[None]:
    """Somebody has taken all that this process may have."""
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


def test_stages_are_stopped_by_a_process_that_can_open_nothing_more(paper: RobotFile) -> None:
    with WatchedLab() as lab:
        stop = LastStop({"driver": "zaber", "port": lab.endpoints["zaber"]}, paper, REAL_TIME)
        link = SerialLink(lab.endpoints["zaber"], BAUD)
        for device in (1, 2, 3):
            link.write(encode(Message(device, Command.MOVE_SPEED, -500)))
            time.sleep(2 * MESSAGE_TIME)
        link.close()
        try:
            with no_descriptors():
                stopped = stop()
            assert stopped.seen, stopped.text
            assert stopped.text.startswith("3 stages on ")
            assert not lab.moving()
        finally:
            stop.close()


def test_of_stages_that_cannot_be_reached_nobody_says_that_they_stop(paper: RobotFile) -> None:
    stop = LastStop({"driver": "zaber", "port": "/dev/not-there"}, paper, REAL_TIME)
    stopped = stop()
    stop.close()
    assert not stopped.seen
    assert stopped.text.startswith("the stages on /dev/not-there cannot be told to stop")
