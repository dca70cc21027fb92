"""A lost coil of the tracker sets a flag, freezes the outer loop's correction, and causes HOLD after 0.25 s.

Frames with a jump and repeated frames are rejected.
"""

from dataclasses import replace

import numpy as np
import pytest

from station.config.controllers import PERIOD_S
from station.control.states import State
from station.control.task import FREEZE_AFTER_S
from station.devices.interfaces import Severity
from tests.harness.cases import a_case
from tests.harness.virtual_station import VirtualStation


def test_short_loss_of_the_tracker_coil_sets_a_flag_and_the_run_continues(virtual: VirtualStation) -> None:
    virtual.moving()
    begin = len(virtual.rows)
    # A frame arrives 24 ms after its measurement, so a loss of 0.18 s appears as 0.2 s without a frame.
    virtual.fail("lose_tool", "tracker", duration=0.18)
    virtual.seconds(1.0)

    assert virtual.state is State.RUNNING
    flags = virtual.of("trouble", virtual.rows[begin:])[:, 1]
    assert Severity.WARN in flags
    assert flags.max() == Severity.WARN
    assert flags[-1] == 0
    off = virtual.of("tip_desired", virtual.rows[begin:]) - virtual.of("tip_true", virtual.rows[begin:])
    before = (
        virtual.of("tip_desired", virtual.rows[:begin])[-200:] - virtual.of("tip_true", virtual.rows[:begin])[-200:]
    )
    # The model replaces the tracker meanwhile, so the error changes only by noise.
    assert np.abs(off - before.mean(axis=0)).max() < 0.5e-3


def test_motion_ends_in_hold_after_a_quarter_of_a_second_without_the_tracker_coil(virtual: VirtualStation) -> None:
    virtual.moving()
    virtual.fail("lose_tool", "tracker")
    took = virtual.becomes(State.HOLD)

    # The 0.25 s count from the measurement of the last valid position, which arrives one latency later.
    assert 0.2 <= took <= 0.25 + 2 * PERIOD_S
    assert virtual.loop.cause == "the tracker lost the coil for 0.25 s"
    virtual.seconds(0.4)
    assert virtual.rests()
    virtual.mend()
    virtual.seconds(1.0)
    assert virtual.state is State.HOLD
    virtual.loop.reset(virtual.now)
    virtual.seconds(0.5)
    assert virtual.state is State.READY


def test_outer_loop_of_the_paper_freezes_its_correction_without_tracker_frames() -> None:
    case = a_case("fig10", "paper")
    station = VirtualStation(case)
    motion = case.file.trajectory
    station.moving(motion, since=3.0)
    station.fail("lose_tool", "tracker", duration=0.2)
    begin = len(station.rows)
    station.until(lambda: station.of("trouble", station.rows[-1:])[0, 1] > 0)
    station.seconds(0.06)
    frozen = station.of("u_int", station.rows[begin:])

    # Without feed-forward the requested velocity of the tip equals the correction.
    assert np.ptp(frozen[-10:], axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.linalg.norm(frozen[-1]) > 1e-3
    assert FREEZE_AFTER_S < 0.25
    station.seconds(0.5)
    assert station.state is State.RUNNING


def test_short_jump_of_the_tracked_position_is_rejected_and_the_run_continues(virtual: VirtualStation) -> None:
    virtual.moving()
    begin = len(virtual.rows)
    virtual.lab.aurora.faults = replace(virtual.lab.aurora.faults, jump=0.05)
    virtual.seconds(0.15)
    virtual.lab.aurora.faults = replace(virtual.lab.aurora.faults, jump=0.0)
    virtual.seconds(0.5)

    assert virtual.state is State.RUNNING
    measured = virtual.of("tip_measured", virtual.rows[begin:])
    assert np.linalg.norm(measured - measured[0], axis=1).max() < 0.02
    assert virtual.devices.tracker.details()["jumps"] >= 4


@pytest.mark.parametrize("kind", ["mute", "restart"])
def test_failed_tracker_causes_hold_within_a_quarter_of_a_second(virtual: VirtualStation, kind: str) -> None:
    virtual.moving()
    virtual.fail(kind, "tracker")
    took = virtual.becomes(State.HOLD)

    assert took <= 0.25 + 2 * PERIOD_S
    assert virtual.loop.cause.startswith("the ")
