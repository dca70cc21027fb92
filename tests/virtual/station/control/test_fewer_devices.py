"""The control loop on benches without a tracker, without force sensors, and with stages alone."""

from typing import Literal

import numpy as np
import pytest

from station.config.controllers import Present, default_controller
from station.config.loads import RampLoad
from station.config.motions import CircleMotion, Orders
from station.control.loop import ControlLoop
from station.control.states import RefusedError, State
from station.control.task import MotionTask, Phase
from station.control.telemetry import FORCE_CHANNELS, SENSOR_CHANNELS, TRACKER_CHANNELS, stale_groups
from station.devices.interfaces import ABSENT
from tests.harness.virtual_station import VirtualStation, usual_case

Kind = Literal["tracker", "sensors"]
CIRCLE = CircleMotion(radius=0.005, period=10.0)


def bench_without(*kinds: Kind) -> VirtualStation:
    """Return a station in the gentle lab that lacks these devices, with the controller for such a bench."""
    case = usual_case()
    present = Present("tracker" not in kinds, "sensors" not in kinds)
    controller = default_controller(present).controller(case.robot, present)
    return VirtualStation(case._replace(lab=case.lab.leaving_out(kinds), controller=controller))


def run(station: VirtualStation, seconds: float) -> np.ndarray:
    """Run a circle under a load that grows within 5 s; return the true errors (ticks, 3) after 2 s [m]."""
    station.ready()
    orders = Orders(CIRCLE, station.case.robot.robot())
    station.loop.start(MotionTask(station.loop.controller, orders, seconds))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    start = len(station.rows)
    station.lab.apply_load(RampLoad(times=(0.0, 5.0), magnitudes=(0.0, 0.2)), station.now)
    station.until(lambda: station.state is not State.RUNNING, 20.0)
    assert station.state is State.READY, station.loop.cause
    rows = np.array(station.rows[start + 1000 :])
    rows = rows[station.loop.channels.of(rows, "phase")[:, 0] == Phase.MOVING]
    return station.loop.channels.of(rows, "tip_true") - station.loop.channels.of(rows, "tip_desired")


def test_a_tracker_alone_keeps_the_tip_on_its_path_under_a_load() -> None:
    errors = run(bench_without("sensors"), 10.0)
    assert np.abs(errors).max() < 0.9e-3


def test_without_force_sensors_the_deflection_shows_the_load() -> None:
    station = bench_without("sensors")
    run(station, 10.0)
    force, true = station.of("force_by_deflection")[-1], station.of("force_true")[-1]
    # The load of 0.2 N acts along x; there the tubes bend by 33 mm/N.
    assert np.linalg.norm(true) == pytest.approx(0.2, abs=1e-3)
    assert abs(force[0] - true[0]) < 0.03
    assert station.of("force_filtered")[-1] == pytest.approx(force)


def test_too_large_a_load_ends_a_run_without_force_sensors() -> None:
    station = bench_without("sensors").ready()
    bound = station.loop.controller.limits.overload
    assert bound is not None
    station.loop.start(MotionTask(station.loop.controller, Orders(CIRCLE, station.case.robot.robot()), 60.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    station.lab.apply_load(RampLoad(times=(0.0, 5.0), magnitudes=(0.0, 1.5 * bound.newton)), station.now)
    station.until(lambda: station.state is not State.RUNNING, 20.0)
    assert station.state is State.HOLD
    assert "force on the tip" in station.loop.cause


def test_force_sensors_alone_compensate_the_load_as_the_model_predicts_it() -> None:
    errors = run(bench_without("tracker"), 10.0)
    # Without a tracker the error of the model remains; the load alone would move the tip by more than 6 mm.
    assert np.abs(errors - errors[0]).max() < 2e-3


def test_stages_alone_move_the_tip_by_the_unloaded_model() -> None:
    station = bench_without("tracker", "sensors").ready()
    orders = Orders(CIRCLE, station.case.robot.robot())
    station.loop.start(MotionTask(station.loop.controller, orders, 10.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    start = len(station.rows)
    station.until(lambda: station.state is not State.RUNNING, 20.0)
    assert station.state is State.READY
    true = station.of("tip_true")[start:]
    radius = 0.5 * np.ptp(true, axis=0).max()
    assert radius == pytest.approx(CIRCLE.radius, rel=0.1)


@pytest.mark.parametrize("kinds", [("sensors",), ("tracker",), ("tracker", "sensors")])
def test_values_of_an_absent_device_have_no_meaning(kinds: tuple[Kind, ...]) -> None:
    station = bench_without(*kinds).ready()
    station.seconds(0.1)
    row, channels = station.rows[-1], station.loop.channels
    stale = stale_groups(channels, row)
    assert (stale >= SENSOR_CHANNELS - FORCE_CHANNELS) == ("sensors" in kinds)
    assert (stale >= FORCE_CHANNELS) == ("sensors" in kinds and "tracker" in kinds)
    assert (stale >= TRACKER_CHANNELS) == ("tracker" in kinds)
    assert channels.of(row, "trouble").tolist() == [0.0, *(ABSENT * (kind in kinds) for kind in ("tracker", "sensors"))]
    assert "joints" not in stale
    assert np.isfinite(row).all()


def test_a_tare_without_force_sensors_is_refused() -> None:
    station = bench_without("sensors").ready()
    with pytest.raises(RefusedError, match="no force sensors"):
        station.loop.tare(station.now)


def test_a_lost_tracker_ends_the_run_of_a_bench_without_sensors() -> None:
    station = bench_without("sensors").ready()
    station.loop.start(MotionTask(station.loop.controller, Orders(CIRCLE, station.case.robot.robot()), 60.0))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    station.fail("lose_tool", "tracker")
    station.until(lambda: station.state is not State.RUNNING, 20.0)
    assert station.state is State.HOLD
    assert "tracker" in station.loop.cause


def test_a_loop_that_starts_a_jog_without_a_tracker_reports_the_models_tip_as_setpoint() -> None:
    station = bench_without("tracker", "sensors").ready()
    loop: ControlLoop = station.loop
    loop.jog(station.now, "joints", np.array([0.0, 0.0, -0.002]))
    station.seconds(0.2)
    row = station.rows[-1]
    model = loop.channels.of(row, "tip_estimated")
    np.testing.assert_allclose(loop.channels.of(row, "tip_desired"), model, atol=1e-9)
