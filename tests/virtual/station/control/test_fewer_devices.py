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
from station.control.telemetry import stale_groups
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


def bench_with_one_sensor(at: str) -> VirtualStation:
    """Return a station in the gentle lab with a single force sensor: under the robot, or on a tube."""
    case = usual_case()
    lab = case.lab.model_copy(update={"sensors": case.lab.sensors.model_copy(update={"at": at})})
    robot = case.robot.sensed_at(at, "at")
    controller = default_controller(lab.present).controller(robot, lab.present)
    return VirtualStation(case._replace(robot=robot, lab=lab, controller=controller))


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


def test_a_tracker_alone_keeps_the_tip_on_its_path_and_its_deflection_shows_the_load() -> None:
    station = bench_without("sensors")
    assert np.abs(run(station, 7.0)).max() < 0.9e-3
    force, true = station.of("force_by_deflection")[-1], station.of("force_true")[-1]
    # The load of 0.2 N acts along x; there the tubes bend by 33 mm/N.
    assert np.linalg.norm(true) == pytest.approx(0.2, abs=1e-3)
    assert abs(force[0] - true[0]) < 0.03
    assert station.of("force_filtered")[-1] == pytest.approx(force)


def moving(*kinds: Kind, motion: CircleMotion = CIRCLE, duration: float = 60.0) -> VirtualStation:
    """Return a station that lacks these devices and whose motion has just started."""
    station = bench_without(*kinds).ready()
    station.loop.start(MotionTask(station.loop.controller, Orders(motion, station.case.robot.robot()), duration))
    station.until(lambda: station.loop.phase is Phase.MOVING)
    return station


def test_too_large_a_load_ends_a_run_without_force_sensors() -> None:
    station = moving("sensors")
    bound = station.loop.controller.limits.overload
    assert bound is not None
    station.lab.apply_load(RampLoad(times=(0.0, 5.0), magnitudes=(0.0, 1.5 * bound.newton)), station.now)
    station.until(lambda: station.state is not State.RUNNING, 20.0)
    assert station.state is State.HOLD
    assert "force on the tip" in station.loop.cause


def test_force_sensors_alone_compensate_the_load_as_the_model_predicts_it() -> None:
    errors = run(bench_without("tracker"), 7.0)
    # Without a tracker the error of the model remains; the load alone would move the tip by more than 6 mm.
    assert np.abs(errors - errors[0]).max() < 2e-3


def test_stages_alone_move_the_tip_by_the_unloaded_model() -> None:
    station = moving("tracker", "sensors", motion=CircleMotion(radius=0.005, period=6.0), duration=6.0)
    start = len(station.rows)
    station.until(lambda: station.state is not State.RUNNING, 20.0)
    assert station.state is State.READY
    assert 0.5 * np.ptp(station.of("tip_true")[start:], axis=0).max() == pytest.approx(CIRCLE.radius, rel=0.1)


@pytest.mark.parametrize("kinds", [("sensors",), ("tracker",), ("tracker", "sensors")])
def test_values_of_an_absent_device_have_no_meaning(kinds: tuple[Kind, ...]) -> None:
    station = bench_without(*kinds).ready()
    station.seconds(0.1)
    row, channels = station.rows[-1], station.loop.channels
    stale = stale_groups(channels, row)
    by_both = {"force", "force_filtered", "force_variance"}  # without sensors the deflection gives the force
    by_sensors = {"wrench_raw", "moment", "moment_mismatch", "force_estimated", "deflection", "deflection_rate"}
    by_tracker = {"tip_measured", "tip_time", "bias", "drift", "force_by_deflection", "target_measured"}
    assert stale & by_sensors == (by_sensors if "sensors" in kinds else set())
    assert stale & by_both == (by_both if "sensors" in kinds and "tracker" in kinds else set())
    assert stale & by_tracker == (by_tracker if "tracker" in kinds else set())
    assert channels.of(row, "trouble").tolist() == [0.0, *(ABSENT * (kind in kinds) for kind in ("tracker", "sensors"))]
    assert "joints" not in stale
    assert np.isfinite(row).all()


def test_a_tare_without_force_sensors_is_refused() -> None:
    station = bench_without("sensors").ready()
    with pytest.raises(RefusedError, match="no force sensors"):
        station.loop.tare(station.now)


def test_a_lost_tracker_ends_the_run_of_a_bench_without_sensors() -> None:
    station = moving("sensors")
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


def test_force_sensor_under_the_robot_measures_the_load_while_the_tip_follows_its_path() -> None:
    station = bench_with_one_sensor("robot")
    assert np.abs(run(station, 7.0)).max() < 0.9e-3
    force, true = station.of("force_filtered")[-500:], station.of("force_true")[-500:]
    assert np.linalg.norm(true[-1]) == pytest.approx(0.2, abs=1e-3)
    assert np.abs(force - true).max() < 0.03
    assert [c.name for c in station.loop.channels.all if c.name.startswith("wrench_raw")] == [
        f"wrench_raw.robot_{axis}" for axis in ("fx", "fy", "fz", "mx", "my", "mz")
    ]


def test_a_fault_of_the_sensor_under_the_robot_ends_the_run_until_a_reset_and_a_tare_zeroes_it() -> None:
    station = bench_with_one_sensor("robot").moving()
    station.fail("saturate", "robot")
    station.becomes(State.HOLD)
    assert "saturated" in station.loop.cause_details
    station.mend()
    station.seconds(0.5)
    station.loop.reset(station.now)
    station.becomes(State.READY)
    station.loop.tare(station.now, untouched=True)
    station.seconds(3.0)
    assert np.abs(station.of("force_filtered")[-1]).max() < 0.02


@pytest.mark.parametrize("at", ["inner", "outer"])
def test_a_sensor_on_one_tube_is_recorded_and_the_deflection_shows_the_load(at: str) -> None:
    station = bench_with_one_sensor(at)
    assert np.abs(run(station, 7.0)).max() < 0.9e-3
    row, channels = station.rows[-1], station.loop.channels
    assert channels.of(row, "force_filtered") == pytest.approx(channels.of(row, "force_by_deflection"))
    assert abs(channels.of(row, "force_filtered")[0] - channels.of(row, "force_true")[0]) < 0.03
    stale = stale_groups(channels, row)
    assert stale >= {"force_estimated", "moment", "deflection"}
    assert not stale & {"force", "force_filtered", "force_variance", "wrench_raw", "tip_measured"}
    with pytest.raises(RefusedError, match="no force sensors for the whole load"):
        station.loop.tare(station.now)
    assert np.abs(station.of("wrench_raw")[-1]).max() > 0.0
