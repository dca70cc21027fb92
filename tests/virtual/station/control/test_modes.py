"""A motion leaves nothing that changes the next one: jog, run and stream move the tip as if they were the first."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from core.robot.robot import Array
from station.config.controllers import ControllerFile
from station.config.loads import RampLoad
from station.config.motions import HoldMotion, Orders
from station.control.states import State
from station.control.task import MotionTask, Phase
from tests.harness.ideal_station import BENCHES, IdealStation, Kind

Mode = Callable[[IdealStation], None]
#: Largest difference of two places of the tip that are the same [m]: the approach to a pose ends 0.1 mm before it.
SAME_M = 2e-4


def _run(station: IdealStation, file: ControllerFile) -> None:
    controller = file.controller(station.case.robot, station.present)
    station.loop.start(MotionTask(controller, Orders(HoldMotion(), station.case.robot.robot()), 1.0))
    station.end()


def _soft(station: IdealStation) -> None:
    _run(station, station.file.model_copy(update={"stiffness": (30.0, 30.0, 1000.0)}))


def _paper(station: IdealStation) -> None:
    _run(station, ControllerFile(transport_delay=0.02))


def _unloaded(station: IdealStation) -> None:
    _run(station, ControllerFile(strategy="unloaded_jacobian"))


def _stopped(station: IdealStation) -> None:
    controller = ControllerFile(strategy="unloaded_jacobian").controller(station.case.robot, station.present)
    station.loop.start(MotionTask(controller, Orders(HoldMotion(), station.case.robot.robot()), 5.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    station.loop.stop(station.now)
    station.seconds(0.3)
    station.loop.reset(station.now)


def _pressed(station: IdealStation) -> None:
    station.loop.start(station.pressing((1.0, 0.0, 0.0), 0.2, 1.0))
    station.end()


def _streamed(station: IdealStation) -> None:
    station.stream(np.array([0.0, 0.0, 2e-3]), 1.0)
    station.end()
    station.request = lambda _: None


def _jogged(station: IdealStation) -> None:
    station.jog("tip", (0.0, 0.0, 1e-3), 2.0)


def _gone(station: IdealStation) -> None:
    station.loop.start(station.going(station.case.start + np.array([0.1, 0.0, 0.001])))
    station.end()


def _nothing(station: IdealStation) -> None:
    pass


ANY_BENCH: tuple[Mode, ...] = (_soft, _pressed, _streamed, _jogged, _gone)  #: modes of every bench


def _load(station: IdealStation) -> None:
    station.lab.apply_load(RampLoad(times=(0.0, 0.5), magnitudes=(0.0, 0.15)), station.now)
    station.seconds(1.0)


def _jog_under_load(station: IdealStation) -> None:
    _load(station)
    _jogged(station)


def _hold_under_load(station: IdealStation) -> None:
    station.loop.start(station.holding(2.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    _load(station)
    station.end()


def _stream_under_load(station: IdealStation) -> None:
    station.stream(np.array([0.0, 0.0, 2e-3]), 2.0)
    _load(station)
    station.end()


def moved(first: Mode, second: Mode, without: Sequence[Kind]) -> Array:
    """Return how the second mode moves the true tip from the start pose (3,) [m]."""
    station = IdealStation(without)
    first(station)
    station.jog("pose", tuple(station.case.start), 3.0)  # a goto would bring its own controller
    station.loop.tare(station.now, untouched=True)
    station.seconds(2.0)
    begin = station.lab.advance(station.now).tip.copy()
    second(station)
    assert station.state is State.READY, station.loop.cause
    return station.lab.advance(station.now).tip - begin


def different(second: Mode, modes: Sequence[Mode], without: Sequence[Kind]) -> dict[str, Array]:
    """Return the modes after which the second one moves the tip elsewhere than alone, with the way (3,) [mm]."""
    alone = moved(_nothing, second, without)
    ways = {first.__name__: 1e3 * (moved(first, second, without) - alone) for first in modes}
    return {name: way for name, way in ways.items() if np.linalg.norm(way) > 1e3 * SAME_M}


@pytest.mark.parametrize("second", [_jog_under_load, _hold_under_load, _stream_under_load, _pressed])
def test_a_motion_moves_the_tip_as_if_it_were_the_first(second: Mode) -> None:
    assert different(second, (*ANY_BENCH, _paper, _unloaded, _stopped), ()) == {}


@pytest.mark.parametrize("without", BENCHES[1:])
def test_a_jog_moves_the_tip_as_if_it_were_first_without_tracker_or_sensors(without: Sequence[Kind]) -> None:
    assert different(_jog_under_load, ANY_BENCH, without) == {}
