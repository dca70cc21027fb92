"""A robot whose tubes may snap causes a warning or a refusal when it is loaded.

During a motion a low stability of the loaded model causes HOLD, and a jump between tracker and model causes STOP.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from core.robot.strength import design_snap_number
from station.config.loads import ConstantLoad
from station.config.motions import CircleMotion
from station.config.robots import TubeFile, load_robot
from station.config.strict import ConfigError
from station.control.monitors import CONFIRMING_FRAMES, Margins, check_design
from station.control.states import State
from tests.harness.virtual_station import VirtualStation


def test_design_that_snaps_causes_a_warning_or_a_refusal_as_configured() -> None:
    paper = load_robot("paper")

    # These are the paper's tubes with twice the curvature.
    def bent(tube: TubeFile) -> TubeFile:
        x = [section.curvature[0] for section in tube.sections]
        sections = [s.model_copy(update={"curvature": (2.0 * c, 0.0)}) for s, c in zip(tube.sections, x, strict=True)]
        return tube.model_copy(update={"sections": tuple(sections)})

    snaps = paper.model_copy(update={"name": "bent", "tubes": tuple(bent(tube) for tube in paper.tubes)})

    lower, upper = (np.array([getattr(joint, end) for joint in paper.joints]) for end in ("lower", "upper"))
    number = design_snap_number(snaps.robot(), lower, upper)
    assert number > 1.0
    warning = check_design(snaps, Margins())
    assert "robot 'bent'" in warning
    assert f"{number:.2f} is not below 1" in warning
    with pytest.raises(ConfigError, match=r"is not below 1.* margins.design = 'warn'"):
        check_design(snaps, Margins(design="refuse"))
    assert check_design(paper, Margins(design="refuse")) == ""


def test_design_whose_snap_number_is_unknown_is_accepted_with_a_warning() -> None:
    paper = load_robot("paper")
    inner = paper.tubes[0]
    twisted = tuple(
        section.model_copy(update={"curvature": (2.0, 3.0 * number)}) for number, section in enumerate(inner.sections)
    )
    helix = paper.model_copy(update={"tubes": (inner.model_copy(update={"sections": twisted}), *paper.tubes[1:])})

    warning = check_design(helix, Margins())
    assert f"tube '{inner.name}' is not curved in one plane" in warning
    assert "watch its stability" in warning


def test_load_that_lowers_the_stability_below_the_margin_causes_hold(case) -> None:
    # The paper's tubes are far from a snap, so the margin is raised to a stability that a load of 0.4 N falls below.
    station = VirtualStation(case, Margins(stability=0.99)).ready()
    at_rest = station.of("stability")[-1, 0]
    station.moving()
    assert at_rest > 0.99
    station.lab.apply_load(ConstantLoad(magnitude=0.4, direction=(0.0, 0.0, -1.0)), station.now)
    station.becomes(State.HOLD)

    assert "the tubes are about to snap: stability 0.9" in station.loop.cause
    assert "is below 0.99; take the load off" in station.loop.cause
    station.seconds(0.4)
    assert station.rests()


def test_jump_of_the_measured_tip_away_from_the_model_stops_every_axis(virtual: VirtualStation) -> None:
    virtual.moving()
    # The tracker measures a snap as a jump of the coil. Its driver accepts a jump only after ten frames that agree.
    virtual.lab.aurora.faults = replace(virtual.lab.aurora.faults, jump=0.05)
    virtual.becomes(State.STOPPED, 1.0)

    assert re.search(r"has changed by \d+ mm within a minute, more than 30 mm", virtual.loop.cause)
    assert "check before you reset" in virtual.loop.cause
    virtual.seconds(0.4)
    assert virtual.rests()
    assert CONFIRMING_FRAMES > 1


def test_usual_error_of_the_model_is_below_half_the_snap_threshold(virtual: VirtualStation) -> None:
    virtual.moving(since=8.0)

    apart = virtual.of("tip_measured") - virtual.of("tip_estimated")
    assert np.linalg.norm(apart[-4000:] - apart[-4000], axis=1).max() < 0.5 * Margins().apart


@pytest.mark.parametrize("joint", ["outer_rotation", "inner_rotation"])
def test_joint_that_loses_its_steps_is_named_when_every_axis_stops(virtual: VirtualStation, joint: str) -> None:
    virtual.moving(CircleMotion(radius=0.010, period=20.0), since=4.0)
    virtual.fail("stall", joint)
    virtual.becomes(State.STOPPED, 20.0)

    assert virtual.loop.cause.startswith(f"the joint {joint} does not go where it was sent: ")
    assert "home it again" in virtual.loop.cause
    virtual.seconds(0.4)
    assert virtual.rests()


def test_jump_of_the_tip_while_the_joints_move_names_no_joint(virtual: VirtualStation) -> None:
    virtual.moving(CircleMotion(radius=0.010, period=20.0), since=4.0)
    virtual.lab.aurora.faults = replace(virtual.lab.aurora.faults, jump=0.05)
    virtual.becomes(State.STOPPED, 1.0)

    assert "does not go where" not in virtual.loop.cause
