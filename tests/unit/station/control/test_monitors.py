"""Monitors that end a motion: a sudden snap, a stalled or overloaded tip, and late ticks of the control loop."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from core.control.estimation import Estimate
from core.control.sensors import FusedLoad
from core.control.step import ControllerState, Tick
from core.control.trajectories import Setpoint
from core.control.velocity_ik import SIGMA_FLOOR_M_S
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.keep_out import KeepOut
from core.robot.regions import Region
from station.config.controllers import ControllerFile
from station.config.robots import load_robot
from station.control.monitors import (
    CONFIRMING_FRAMES,
    FURTHER_RISE_N,
    MIN_ERROR_M,
    OVERLOAD_TIME_S,
    RELIEF_RISE_N,
    RELIEF_TIME_S,
    STALL_TIME_S,
    UNBLOCKED_TIME_S,
    ForceMonitor,
    Margins,
    OverrunLimits,
    Overruns,
    ProgressMonitor,
    SnapMonitor,
)
from station.devices.interfaces import DeviceFault, Severity

HOUR = 3600


@pytest.fixture(scope="module")
def statics() -> Statics:
    return Statics(load_robot("paper").robot())


class Drifting:
    """Robot at rest whose force sensors drift: the tip of the model moves with the drift, the tracked tip stays."""

    def __init__(self, statics: Statics, rate: float) -> None:
        joints = np.array([0.0, 1.5708, -0.1])
        free = statics.solve(joints, np.zeros(6))
        loaded = statics.solve(joints, pure_force(np.array([0.1, 0.0, 0.0])), free)
        nothing = np.zeros(3)
        self._free, self._bent, self._rate = free.tip, loaded.tip, rate
        memory = ControllerState(Estimate(loaded, free, np.zeros(1)), free.tip, free.tip)
        self._tick = Tick(
            nothing, FusedLoad(nothing, nothing), nothing, Setpoint(nothing, nothing), nothing, nothing, nothing, memory
        )
        self.monitor = SnapMonitor(Margins(), ControllerFile().controller(load_robot("paper")))

    def frame(self, now: float, jump: float = 0.0) -> DeviceFault | None:
        """Check a tracker frame at `now` [s] whose tip has jumped by `jump` along z [m].

        The drift is applied to the tracked tip with the opposite sign; only the difference to the model counts.
        """
        tip = self._free - np.array([self._rate * now, 0.0, -jump])
        return self.monitor.check(
            self._tick._replace(memory=self._tick.memory._replace(tip=tip)), True, now, np.zeros(3)
        )


def test_eight_hours_of_sensor_drift_do_not_count_as_a_snap(statics: Statics) -> None:
    # Two sensors drift by 5 mN a minute on three axes. With 42 mm/N that is 0.5 mm a minute, and 250 mm at the end.
    robot = Drifting(statics, 0.5e-3 / 60.0)

    assert not any(robot.frame(float(now)) for now in range(8 * HOUR))


def test_snap_after_an_hour_of_sensor_drift_causes_stop(statics: Statics) -> None:
    robot = Drifting(statics, 0.5e-3 / 60.0)
    for now in range(HOUR):
        assert robot.frame(float(now)) is None

    found = [robot.frame(HOUR + 0.025 * frame, jump=0.035) for frame in range(CONFIRMING_FRAMES)]

    assert found[:-1] == [None] * (CONFIRMING_FRAMES - 1)
    assert found[-1] is not None
    assert found[-1].severity is Severity.STOP
    assert "tracker and model has changed by 35 mm" in found[-1].text


def test_lasting_tip_jump_does_not_become_the_reference_of_the_snap_monitor(statics: Statics) -> None:
    robot = Drifting(statics, 0.0)
    robot.frame(0.0)

    found = [robot.frame(float(now), jump=0.035) for now in range(1, 200)]

    assert all(found[CONFIRMING_FRAMES - 1 :])


FRAME = 0.025


@pytest.fixture
def limits(paper):
    return paper.limits()


def tick(error: float, sigma: float = 0.01, at_bound=(0.0, 0.0, 0.0), joints=(0.0, 1.0, -0.1), desired=0.0) -> Tick:
    tip = np.array([0.0, 0.0, 0.2 + desired + error])
    estimate = SimpleNamespace(observed=SimpleNamespace(tip=tip), loaded=SimpleNamespace(joints=np.array(joints)))
    memory = SimpleNamespace(estimate=estimate, origin=np.array([0.0, 0.0, 0.2]))
    setpoint = Setpoint(np.array([0.0, 0.0, desired]), np.zeros(3))
    made = SimpleNamespace(
        memory=memory, setpoint=setpoint, sigma=np.array([0.02, 0.01, sigma]),
        at_bound=np.array(at_bound), at_row=np.zeros(0),
    )  # fmt: skip
    return cast(Tick, made)


def watch(limits, seconds: float, make) -> tuple[float, str]:
    """Return time [s] and text when the monitor ends the motion, or `seconds` and no text if it never does."""
    stall = ProgressMonitor()
    for number in range(round(seconds / FRAME)):
        text = stall.check(number * FRAME, make(number * FRAME), limits)
        if text:
            return number * FRAME, text
    return seconds, ""


STUCK = SIGMA_FLOOR_M_S / 5.0


def test_singular_pose_that_lasts_five_seconds_ends_the_motion(limits):
    time, text = watch(limits, 20.0, lambda _: tick(2e-3, STUCK))

    assert STALL_TIME_S == 5.0
    assert time == pytest.approx(5.0, abs=2 * FRAME)
    assert "singular pose, sigma 0.1 of 0.5 mm/s" in text
    assert "2 mm from its setpoint" in text
    assert "5 s" in text
    assert "\n" not in text


def test_region_on_the_path_of_the_setpoint_is_the_reason_of_a_stalled_motion(limits):
    ball = KeepOut(Region("ball", "sphere", (0.0, 0.0, 0.2, 0.004)))
    inside = replace(limits, others=(ball,))
    reason = "the path leads through the region 'ball': the tip is 2 mm from its setpoint"
    assert watch(inside, 20.0, lambda _: tick(2e-3, STUCK))[1].startswith(reason)
    # The setpoint leaves the region on its other side after one second.
    assert watch(inside, 20.0, lambda time: tick(2e-3, STUCK, desired=0.0 if time < 1.0 else 0.02))[1].startswith(
        reason
    )


def test_joint_that_stays_at_its_end_of_travel_ends_the_motion_and_is_named(limits):
    _, text = watch(limits, 20.0, lambda _: tick(2e-3, at_bound=(0.0, 0.0, 1.0), joints=(0.0, 1.0, -0.0051)))

    assert text.startswith("the tip is 2 mm from its setpoint and has not come nearer for 5 s")
    assert text.endswith("(travel of inner_translation (-0.005 m))")


@pytest.mark.parametrize(
    "make",
    [
        lambda _: tick(MIN_ERROR_M / 2, STUCK),  # the tip is close enough to its setpoint
        lambda _: tick(5e-3),  # the tip is far away, but no limit is active
        lambda _: tick(5e-3, at_bound=(1.0, 0.0, 0.0)),  # a joint is at its top speed
        lambda time: tick(20e-3 * np.exp(-time / 20.0), STUCK),  # the tip slowly comes nearer
        lambda time: tick(5e-3, STUCK if time % 4.0 < 3.0 else 0.01),  # the pose is singular for only 3 s at a time
        lambda time: tick(5e-3 if time % 4.0 < 3.9 else 0.0, STUCK),  # the tip returns to its setpoint again and again
    ],
)
def test_temporary_stall_does_not_end_a_motion(limits, make):
    assert watch(limits, 20.0, make)[1] == ""


def test_short_time_without_an_active_limit_does_not_restart_the_stall_time(limits):
    _, text = watch(limits, 20.0, lambda time: tick(5e-3, STUCK if time % 1.0 > UNBLOCKED_TIME_S / 2 else 0.01))

    assert text


def bear(limits, seconds: float, force, relieves: bool = False) -> tuple[float, str]:
    """Return time [s] and text when the monitor ends a motion under a force along x, or `seconds` and no text."""
    monitor = ForceMonitor()
    monitor.update(0.0, np.array([force(0.0), 0.0, 0.0]), limits.overload)
    assert monitor.begin(jog=relieves) == ""
    for number in range(1, round(seconds / 0.002)):
        now = number * 0.002
        monitor.update(now, np.array([force(now), 0.0, 0.0]), limits.overload)
        if text := monitor.check(now):
            return now, text
    return seconds, ""


def test_tip_force_above_the_strength_of_tubes_and_sensors_ends_the_motion(limits):
    time, text = bear(limits, 2.0, lambda now: -1.2 if now >= 1.0 - 1e-9 else 0.0)

    # The mean of a step to 1.2 N reaches 0.94 N after ln(1.2 / 0.26) time constants.
    assert time == pytest.approx(1.0 + OVERLOAD_TIME_S * np.log(1.2 / 0.26), abs=0.01)
    assert "N is above 0.94 N (the moment range of a base sensor): take the load off" in text
    assert "\n" not in text


def test_short_overload_and_a_tip_force_below_the_bound_do_not_end_the_motion(limits):
    assert bear(limits, 5.0, lambda now: 2.0 if 0.1 <= now % 0.5 < 0.15 else 0.0)[1] == ""
    assert bear(limits, 5.0, lambda _: 0.93)[1] == ""


def test_jog_above_the_bound_continues_only_while_the_force_falls(limits):
    assert bear(limits, 5.0, lambda now: 1.5 - 0.1 * now, relieves=True)[1] == ""
    time, text = bear(limits, 5.0, lambda _: 1.2, relieves=True)
    assert time == pytest.approx(RELIEF_TIME_S, abs=0.02)
    assert text
    time, _ = bear(limits, 5.0, lambda now: 1.2 + 0.5 * now, relieves=True)
    assert time == pytest.approx(RELIEF_RISE_N / 0.5 + OVERLOAD_TIME_S, abs=0.05)


def test_repeated_jogs_above_the_bound_raise_the_force_by_little_and_can_still_lower_it(limits):
    monitor, force, now = ForceMonitor(), 1.2, 0.0
    for _ in range(10):
        for _ in range(500):  # between two jogs the force is constant
            now += 0.002
            monitor.update(now, np.array([force, 0.0, 0.0]), limits.overload)
        monitor.begin(jog=True)
        while not monitor.check(now):
            now, force = now + 0.002, force + 0.0002
            monitor.update(now, np.array([force, 0.0, 0.0]), limits.overload)
    assert force < 1.2 + RELIEF_RISE_N + 10 * (FURTHER_RISE_N + 0.1 * 2.0 * OVERLOAD_TIME_S)
    monitor.begin(jog=True)
    assert monitor.check(now) == ""  # the tip can still be moved away


PERIOD = 0.002


def late(overruns: Overruns, skips: list[int], start: float = 0.0) -> list[Severity | None]:
    """Return the severity of the fault after each tick; a tick lasts its period and the skipped periods."""
    found, now = [], start
    for skipped in skips:
        now += skipped * PERIOD
        trouble = overruns.check(now, skipped)
        found.append(None if trouble is None else trouble.severity)
        now += PERIOD
    return found


@pytest.fixture
def overruns():
    return Overruns(OverrunLimits(), PERIOD)


def test_punctual_loop_causes_no_fault(overruns):
    assert late(overruns, [0] * 10_000) == [None] * 10_000


def test_five_overruns_in_a_row_cause_hold_and_twenty_cause_fault(overruns):
    found = late(overruns, [1] * 20)

    assert found[:4] == [None] * 4
    assert found[4:19] == [Severity.HOLD] * 15
    assert found[19] is Severity.FAULT


def test_punctual_tick_resets_the_number_of_consecutive_overruns(overruns):
    assert late(overruns, [1, 1, 1, 1, 0] * 5) == [None] * 25


def test_more_than_one_percent_of_skipped_periods_in_ten_seconds_causes_hold(overruns):
    # In 10 s there are 5000 periods, so 50 skipped periods are one percent.
    assert late(overruns, [0, 25] * 2) == [None] * 4
    assert late(overruns, [0, 1], start=1.0) == [None, Severity.HOLD]


def test_overruns_older_than_ten_seconds_do_not_count(overruns):
    late(overruns, [25, 0, 25, 0])

    assert late(overruns, [1, 0], start=10.2) == [None, None]


def test_overruns_before_a_motion_do_not_count(overruns):
    late(overruns, [25, 0, 25, 0, 1])
    overruns.forget()

    assert late(overruns, [1, 0], start=1.0) == [None, None]


def test_overrun_thresholds_are_those_of_the_station_file():
    overruns = Overruns(OverrunLimits(hold_in_a_row=2, fault_in_a_row=3), PERIOD)

    assert late(overruns, [1, 1, 1]) == [None, Severity.HOLD, Severity.FAULT]


def test_overrun_fault_has_the_number_of_late_ticks_and_an_instruction(overruns):
    for _ in range(4):
        overruns.check(0.0, 1)
    trouble = overruns.check(0.0, 1)

    assert trouble is not None
    assert trouble.text == (
        "this computer was too busy: the control loop was late 5 times in a row, and all axes were stopped;"
        " close other programs and run 'ctr-station doctor'"
    )
    assert trouble.details.startswith("load ")
