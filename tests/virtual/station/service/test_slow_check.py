"""A STOP and a reset during the check of a motion on the model void the motion, although the state is READY."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import pytest

from station.config.motions import HoldMotion, Orders
from station.control.states import RefusedError, State
from tests.harness.played_station import PlayedStation, played_station
from tests.harness.virtual_station import VirtualStation, usual_case


@pytest.fixture(scope="module")
def played() -> Iterator[PlayedStation]:
    with played_station(VirtualStation(usual_case())) as station:
        yield station


def stop_and_reset(station: PlayedStation) -> None:
    station.supervisor.stop("stopped by a viewer, 'Anna'")
    assert station.state is State.STOPPED
    station.supervisor.reset()
    assert station.state is State.READY


class Joints(Mapping[str, float]):
    """Pose that calls a function when it is read, which happens after the first check of the state."""

    def __init__(self, joints: Mapping[str, float], meanwhile: Callable[[], None]) -> None:
        self._joints, self._meanwhile = joints, [meanwhile]

    def __getitem__(self, key: str) -> float:
        return self._joints[key]

    def __len__(self) -> int:
        return len(self._joints)

    def __iter__(self) -> Iterator[str]:
        while self._meanwhile:
            self._meanwhile.pop()()
        return iter(self._joints)


def rests(station: PlayedStation, refused: RefusedError) -> None:
    """Check that the robot is at rest and that the refusal names the STOP and has an instruction."""
    assert station.state is State.READY
    station.tick(50)
    assert station.state is State.READY
    assert "the station was stopped by a viewer, 'Anna' after this request arrived; check the robot" in str(refused)


def test_stop_and_reset_void_a_goto_that_is_being_checked(played: PlayedStation) -> None:
    played.settle()
    pose = Joints({"outer_rotation": 0.1}, lambda: stop_and_reset(played))
    with pytest.raises(RefusedError) as refused:
        played.service.go_to(pose)
    rests(played, refused.value)


def test_stop_and_reset_void_a_start_that_is_being_checked(
    played: PlayedStation, monkeypatch: pytest.MonkeyPatch
) -> None:
    played.settle()
    check = Orders.check

    def slow(*arguments: Any) -> None:
        check(*arguments)
        stop_and_reset(played)

    monkeypatch.setattr(Orders, "check", slow)
    with pytest.raises(RefusedError) as refused:
        played.service.start_motion(HoldMotion(), duration=1.0)
    rests(played, refused.value)
