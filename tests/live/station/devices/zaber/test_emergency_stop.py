"""The emergency stop on moving simulated stages, in a separate process."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from station.control.clock import REAL_TIME_CLOCK
from station.devices.interfaces import NotStopped
from station.devices.links.link import SerialLink
from station.devices.zaber.emergency_stop import Units, stop_stages
from station.devices.zaber.protocol import (
    BAUD,
    MESSAGE_BYTES,
    MESSAGE_TIME_S,
    NO_DATA,
    ZaberCommand,
    ZaberMessage,
    ZaberStatus,
    decode,
    encode,
)
from tests.harness.waiting import until
from tests.harness.watched_lab import WatchedLab


@pytest.fixture(scope="module")
def lab() -> Iterator[WatchedLab]:
    with WatchedLab() as lab:
        yield lab


def units(lab: WatchedLab) -> Units:
    return {lab.endpoints["zaber"]: {1, 2, 3}}


def set_going(lab: WatchedLab) -> SerialLink:
    link = SerialLink(lab.endpoints["zaber"], BAUD)
    for device in (1, 2, 3):
        link.write(encode(ZaberMessage(device, ZaberCommand.MOVE_SPEED, -500)))
        time.sleep(2 * MESSAGE_TIME_S)
    until(lambda: lab.notes()[-1].statuses == (22, 22, 22))
    return link


def test_emergency_stop_retries_a_port_until_a_dying_process_releases_it(lab: WatchedLab) -> None:
    link = set_going(lab)
    release = threading.Timer(0.3, link.close)
    release.start()
    result = stop_stages(units(lab), REAL_TIME_CLOCK)
    release.join()

    assert result.startswith("3 stages on")
    assert not lab.notes()[-1].moving


def test_emergency_stop_reports_stages_that_cannot_be_stopped(lab: WatchedLab) -> None:
    set_going(lab).close()
    with pytest.raises(NotStopped) as raised:
        stop_stages({"/dev/not-there": {1}, **units(lab)}, REAL_TIME_CLOCK)

    result = str(raised.value)
    assert "the stages on /dev/not-there cannot be commanded to stop" in result
    assert "press the emergency stop" in result
    assert "3 stages on" in result
    assert not lab.notes()[-1].moving
    assert stop_stages({}, REAL_TIME_CLOCK) == ""


def test_emergency_stop_resets_homing_units_that_ignore_a_stop(lab: WatchedLab) -> None:
    link = SerialLink(lab.endpoints["zaber"], BAUD)
    for device in (1, 3):
        link.write(encode(ZaberMessage(device, ZaberCommand.HOME, NO_DATA)))
        time.sleep(2 * MESSAGE_TIME_S)
    until(lambda: lab.notes()[-1].statuses == (1, 0, 1))
    link.close()
    result = stop_stages(units(lab), REAL_TIME_CLOCK)

    assert result.startswith("3 stages on")
    assert result.endswith("number 1, 3 homed and was reset: home again")
    assert not lab.notes()[-1].moving


@contextmanager
def chain(third: float | None) -> Iterator[str]:
    """Yield the port of a chain: units 1 and 2 answer at once, unit 3 after `third` [s], or never if None."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            host, _ = server.accept()
            with host, suppress(OSError):  # the host closes the connection when it has received enough
                while data := host.recv(MESSAGE_BYTES, socket.MSG_WAITALL):
                    if decode(data).command != ZaberCommand.STATUS:
                        continue
                    for unit in (1, 2, 3):
                        if unit == 3:
                            if third is None:
                                break
                            time.sleep(third)
                        host.sendall(encode(ZaberMessage(unit, ZaberCommand.STATUS, ZaberStatus.STOPPING)))

        thread = threading.Thread(target=answer)
        thread.start()
        yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        thread.join()


def test_emergency_stop_waits_for_a_unit_that_answers_late() -> None:
    with chain(third=0.08) as port:
        assert stop_stages({port: {1, 2, 3}}, REAL_TIME_CLOCK).startswith("3 stages on")


def test_silent_unit_does_not_count_as_stopped() -> None:
    result = "number 3 was commanded to stop and has not confirmed: press the emergency stop"
    with chain(third=None) as port, pytest.raises(NotStopped, match=result):
        stop_stages({port: {1, 2, 3}}, REAL_TIME_CLOCK, patience=0.5)
