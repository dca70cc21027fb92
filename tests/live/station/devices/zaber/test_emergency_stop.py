"""The last stop on simulated stages that really move, in a process of their own."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from station.control.clock import REAL_TIME
from station.devices.interfaces import NotStopped
from station.devices.links.link import SerialLink
from station.devices.zaber.emergency_stop import Units, stop_stages
from station.devices.zaber.protocol import BAUD, MESSAGE_TIME, SIZE, Command, Message, Status, decode, encode
from station.devices.zaber.shifts import IGNORED
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
        link.write(encode(Message(device, Command.MOVE_SPEED, -500)))
        time.sleep(2 * MESSAGE_TIME)
    time.sleep(0.05)
    assert lab.notes()[-1].statuses == (22, 22, 22)
    return link


def test_every_unit_is_told_and_says_that_it_stops(lab: WatchedLab) -> None:
    set_going(lab).close()
    begin = time.monotonic()
    said = stop_stages(units(lab), REAL_TIME)

    assert said.startswith(f"3 stages on {lab.endpoints['zaber']} stop, told ")
    assert lab.told(begin) > 0.0


def test_a_port_that_a_dying_process_still_has_is_tried_until_it_is_free(lab: WatchedLab) -> None:
    link = set_going(lab)
    release = threading.Timer(0.3, link.close)
    release.start()
    said = stop_stages(units(lab), REAL_TIME)
    release.join()

    assert said.startswith("3 stages on")
    assert not lab.notes()[-1].moving


def test_half_a_message_before_it_does_not_swallow_the_stop(lab: WatchedLab) -> None:
    link = set_going(lab)
    link.write(b"\x02\x16\x00")
    link.close()
    assert stop_stages(units(lab), REAL_TIME).startswith("3 stages on")
    assert not lab.notes()[-1].moving


def test_of_what_cannot_be_stopped_a_person_is_told(lab: WatchedLab) -> None:
    set_going(lab).close()
    with pytest.raises(NotStopped) as raised:
        stop_stages({"/dev/not-there": {1}, **units(lab)}, REAL_TIME)

    said = str(raised.value)
    assert "the stages on /dev/not-there cannot be told to stop" in said
    assert "press the emergency stop" in said
    assert "3 stages on" in said
    assert not lab.notes()[-1].moving
    assert stop_stages({}, REAL_TIME) == ""


def test_units_that_home_and_obey_no_stop_are_reset(lab: WatchedLab) -> None:
    link = SerialLink(lab.endpoints["zaber"], BAUD)
    for device in (1, 3):
        link.write(encode(Message(device, Command.HOME, IGNORED)))
        time.sleep(2 * MESSAGE_TIME)
    until(lambda: lab.notes()[-1].statuses == (1, 0, 1))
    link.close()
    said = stop_stages(units(lab), REAL_TIME)

    assert said.startswith("3 stages on")
    assert said.endswith("number 1, 3 homed and was reset: home again")
    assert not lab.notes()[-1].moving


@contextmanager
def chain(third: float | None) -> Iterator[str]:
    """The port of units 1 and 2, which answer at once, and of 3, which does so after `third` [s], or never."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            host, _ = server.accept()
            with host, suppress(OSError):  # the other end goes when it has heard enough
                while data := host.recv(SIZE, socket.MSG_WAITALL):
                    if decode(data).command != Command.STATUS:
                        continue
                    for unit in (1, 2, 3):
                        if unit == 3:
                            if third is None:
                                break
                            time.sleep(third)
                        host.sendall(encode(Message(unit, Command.STATUS, Status.STOPPING)))

        thread = threading.Thread(target=answer)
        thread.start()
        yield f"socket://127.0.0.1:{server.getsockname()[1]}"
        thread.join()


def test_a_unit_that_answers_late_is_waited_for() -> None:
    with chain(third=0.08) as port:
        assert stop_stages({port: {1, 2, 3}}, REAL_TIME).startswith("3 stages on")


def test_a_unit_that_says_nothing_is_not_taken_for_stopped() -> None:
    said = "number 3 was told to stop and does not say so: press the emergency stop"
    with chain(third=None) as port, pytest.raises(NotStopped, match=said):
        stop_stages({port: {1, 2, 3}}, REAL_TIME, patience=0.5)
