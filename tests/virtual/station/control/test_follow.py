"""A run that follows a target: its error, a lost target, and a refusal without a target."""

import numpy as np
import pytest

from station.config.motions import FollowMotion
from station.control.states import RefusedError, State
from station.devices.interfaces import Severity
from station.lab.config import load_lab
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation

FOLLOW = FollowMotion()


@pytest.fixture
def virtual() -> VirtualStation:
    return VirtualStation(a_case("follow", "breathing"))


def errors(virtual: VirtualStation, since: float) -> np.ndarray:
    """Return the distance (ticks,) [m] of the true tip from its desired position, the true target plus the offset."""
    rows = virtual.rows[-round(since / virtual.case.controller.period) :]
    desired = virtual.of("target_true", rows) + virtual.of("target_offset", rows)
    return np.linalg.norm(desired - virtual.of("tip_true", rows), axis=1)


def check_bounds(virtual: VirtualStation, motion: FollowMotion = FOLLOW) -> None:
    """Check that the setpoint of a run keeps its bounds on speed and acceleration.

    The telemetry's setpoint is the bounded one minus its velocity times the lead time (50 ms at most), so its velocity
    may exceed the bound by 50 ms times the acceleration.
    """
    moving = virtual.of("target_followed")[:, 0] > 0.0
    velocity = np.diff(virtual.of("tip_desired")[moving], axis=0) / virtual.case.controller.period
    change = np.linalg.norm(velocity[100:] - velocity[:-100], axis=1) / (100 * virtual.case.controller.period)
    margin = 0.05 * motion.max_acceleration
    assert np.linalg.norm(velocity, axis=1).max() <= motion.max_speed + margin
    assert change.max() <= motion.max_acceleration + 2.0 * margin / 0.2


def test_tip_stays_next_to_a_breathing_target_rests_while_it_is_lost_and_follows_again(virtual: VirtualStation) -> None:
    virtual.moving(FOLLOW, since=6.0)
    virtual.seconds(3.0)
    assert errors(virtual, 3.0).max() < 0.5e-3
    target = virtual.of("target_true", virtual.rows[-1500:])
    assert np.ptp(target, axis=0).max() > 4e-3  # the target really moves
    assert np.linalg.norm(target - virtual.of("target_predicted", virtual.rows[-1500:]), axis=1).max() < 0.4e-3

    virtual.fail("lose_target", "tracker", duration=1.2)
    virtual.seconds(0.9)
    desired = virtual.of("tip_desired", virtual.rows[-50:])
    assert np.ptp(desired, axis=0).max() < 1e-9  # the setpoint of the tip is at rest
    trouble = virtual.devices.tracker.trouble(virtual.now)
    assert trouble is not None
    assert trouble.severity is Severity.WARN
    assert "target" in trouble.text
    assert virtual.state is State.RUNNING

    virtual.seconds(4.0)
    assert virtual.state is State.RUNNING
    assert errors(virtual, 1.0).max() < 0.6e-3
    check_bounds(virtual)


def test_tip_reaches_the_given_offset_from_the_target_within_the_bounds(virtual: VirtualStation) -> None:
    motion = FollowMotion(offset=(0.004, 0.0, -0.015))
    virtual.moving(motion, since=4.5)
    virtual.seconds(1.0)

    assert virtual.of("target_offset")[-1].tolist() == [0.004, 0.0, -0.015]
    assert errors(virtual, 1.0).max() < 0.6e-3
    check_bounds(virtual, motion)


def test_target_lost_for_long_ends_the_run_with_the_cause(virtual: VirtualStation) -> None:
    virtual.moving(FOLLOW, since=0.5)
    virtual.fail("lose_target", "tracker")

    assert virtual.becomes(State.HOLD, 5.0) == pytest.approx(FOLLOW.patience, abs=0.1)
    assert virtual.loop.cause.startswith("the target was not measured for 2.0 s")
    assert "bring it back into the tracker's volume" in virtual.loop.cause
    assert not virtual.of("target_followed")[-1]
    virtual.seconds(0.3)
    assert virtual.rests()
    virtual.loop.reset(virtual.now)
    with pytest.raises(RefusedError, match="the target was not measured for"):
        virtual.moving(FOLLOW)
    virtual.mend()
    virtual.seconds(0.2)
    virtual.moving(FOLLOW)


def test_bench_without_a_second_coil_refuses_to_follow() -> None:
    usual = a_case("follow", "breathing")
    bench = VirtualStation(usual._replace(lab=load_lab("gentle", usual.robot)))

    with pytest.raises(RefusedError, match=r"target was not measured yet.*name its coil in devices\.tracker\.target"):
        bench.moving(FOLLOW)
    assert bench.state is State.READY
    assert not bench.of("target_true").any()
    assert not bench.of("target_measured").any()
