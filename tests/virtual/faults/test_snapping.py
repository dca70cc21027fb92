"""A robot whose tubes may snap causes a warning or a refusal when it is loaded.

A motion toward a snap of tubes within 5 % of the described ones ends in HOLD before the snap. A jump between tracker
and model causes STOP.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from core.robot.strength import design_snap_number
from station.config.motions import CircleMotion, JointSweepMotion, Orders
from station.config.robots import RobotFile, TubeFile, load_robot
from station.config.strict import ConfigError
from station.control.clock import VirtualClock
from station.control.monitors import CONFIRMING_FRAMES, Margins, check_design
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.experiments.experiment import Case
from station.experiments.runner import run_case
from station.lab.config import StagesKind
from tests.golden.cases import SOON, preset
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


@pytest.mark.parametrize(("lower", "warns"), [(-0.149, False), (-0.151, True)])
def test_tube_that_the_guide_strains_beyond_its_material_causes_a_warning(lower: float, warns: bool) -> None:
    """The inner tube of 2 mm bends with 4 1/m from 150 mm on: straight, its surface is strained by 0.4 %."""
    paper = load_robot("paper")
    steel = paper.tubes[0].model_copy(update={"max_strain": 0.002})
    joints = tuple(
        joint.model_copy(update={"lower": lower}) if joint.motion == "translation" else joint for joint in paper.joints
    )
    robot = paper.model_copy(update={"tubes": (steel, *paper.tubes[1:]), "joints": joints})

    warning = check_design(robot, Margins())
    assert ("the guide strains tube 'inner' by 0.4 %" in warning) is warns
    assert ("at most 0.2 % (max_strain)" in warning) is warns


def steep(factor: float, preset: str = "paper") -> RobotFile:
    """Return soft tubes that snap: the tubes of a preset with their curvature times `factor`."""

    def bent(tube: TubeFile) -> TubeFile:
        sections = tuple(s.model_copy(update={"curvature": (factor * s.curvature[0], 0.0)}) for s in tube.sections)
        return tube.model_copy(update={"sections": sections, "bending_stiffness": 0.4 * tube.bending_stiffness})

    robot = load_robot(preset)
    return robot.model_copy(update={"name": "steep", "tubes": tuple(bent(tube) for tube in robot.tubes)})


def turning(case: Case, factor: float, seed: int, joint: str, speed: float) -> VirtualStation:
    """Start a sweep toward the snap of steep tubes, whose real stiffness and curvature differ by up to 5 %."""
    robot = steep(factor)
    lab = case.lab.model_copy(update={"plant": case.lab.plant.model_copy(update={"vary": 0.05, "tubes": {}})})
    controller = case.file.controller.controller(robot)
    start = np.array([0.0, 3.0, -0.1])
    station = VirtualStation(
        case._replace(robot=robot, lab=lab, controller=controller, start=start), Margins(apart=0.5), seed
    ).ready()
    sweep = Orders(JointSweepMotion(joint=joint, speed=speed, distance=4.0), robot.robot())
    station.loop.start(MotionTask(controller, sweep, 60.0))
    return station


def largest_step(station: VirtualStation) -> float:
    """Return the largest distance that the true tip moved in a tick [m]."""
    return float(np.linalg.norm(np.diff(station.of("tip_true"), axis=0), axis=1).max())


#: Largest distance of the tip in a tick without a snap, which moves it by 90 mm and more [m].
MOVES_M = 1e-3
TOWARD_SNAP = {"inner_rotation": 0.349, "outer_rotation": -0.349}


@pytest.mark.parametrize("joint", TOWARD_SNAP)
@pytest.mark.parametrize("seed", range(10))
def test_tubes_that_differ_by_five_percent_are_stopped_before_they_snap(case: Case, joint: str, seed: int) -> None:
    station = turning(case, 2.0 + 0.1 * (seed % 5), seed, joint, TOWARD_SNAP[joint])
    station.becomes(State.HOLD, 12.0)
    station.seconds(0.5)

    assert "the tubes are about to snap: tubes that differ by 5 %" in station.loop.cause
    assert largest_step(station) < MOVES_M
    assert station.rests()


def test_joints_can_leave_the_neighbourhood_of_a_snap_but_not_enter_it_again(case: Case) -> None:
    station = turning(case, 2.0, 1, "inner_rotation", 0.349)
    station.becomes(State.HOLD, 12.0)
    station.seconds(0.5)
    held = station.places[1]
    for speed, ends in ((0.1, State.HOLD), (-0.1, State.RUNNING)):
        station.loop.reset(station.now)
        station.becomes(State.READY)
        sweep = Orders(JointSweepMotion(joint="inner_rotation", speed=speed, distance=0.2), station.case.robot.robot())
        station.loop.start(MotionTask(station.case.controller, sweep, 60.0))
        station.until(lambda: station.loop.phase is Phase.MOVING or station.state is State.HOLD)
        station.seconds(1.0)
        assert station.state is ends, station.loop.cause
    assert station.places[1] < held - 0.03
    assert largest_step(station) < MOVES_M


def test_jump_of_the_measured_tip_away_from_the_model_stops_every_axis_and_names_no_joint(
    virtual: VirtualStation,
) -> None:
    virtual.moving()
    # The tracker measures a snap as a jump of the coil. Its driver accepts a jump only after ten frames that agree.
    virtual.lab.aurora.faults = replace(virtual.lab.aurora.faults, jump=0.05)
    virtual.becomes(State.STOPPED, 1.0)

    assert re.search(r"has changed by \d+ mm within a minute, more than 30 mm", virtual.loop.cause)
    assert "check before you reset" in virtual.loop.cause
    assert "does not move as commanded" not in virtual.loop.cause  # no joint is named, although the joints move
    virtual.seconds(0.4)
    assert virtual.rests()
    assert CONFIRMING_FRAMES > 1


def test_usual_error_of_the_model_is_below_half_the_snap_threshold(virtual: VirtualStation) -> None:
    virtual.moving(since=5.0)

    apart = virtual.of("tip_measured") - virtual.of("tip_estimated")
    assert np.linalg.norm(apart[-2500:] - apart[-2500], axis=1).max() < 0.5 * Margins().apart


@pytest.mark.parametrize("stages", ["grbl", "marlin"])
@pytest.mark.parametrize("joint", ["outer_rotation", "inner_rotation", "inner_translation"])
@pytest.mark.parametrize("duration", [None, 1.5])
def test_joint_that_loses_its_steps_is_named_within_two_seconds(
    case: Case, stages: StagesKind, joint: str, duration: float | None
) -> None:
    virtual = VirtualStation(case._replace(lab=case.lab.model_copy(update={"stages": stages})))
    virtual.moving(CircleMotion(radius=0.010, period=8.0), since=2.0)
    virtual.fail("stall", joint, **({} if duration is None else {"duration": duration}))
    virtual.becomes(State.STOPPED, 2.0)

    assert virtual.loop.cause.startswith(f"the joint {joint} does not move as commanded: ")
    assert "home it again" in virtual.loop.cause
    virtual.seconds(0.4)
    assert virtual.rests()


def test_joint_that_makes_up_for_a_load_is_not_named_without_force_sensors() -> None:
    case = preset("fewer_devices", "tracker_only_sinusoid", 1.0, SOON)
    run = run_case(case, 1, VirtualClock(), lambda _: None)
    assert run.completed, run.cause
