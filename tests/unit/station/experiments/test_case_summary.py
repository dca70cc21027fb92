"""The summary of a case in the units of the page."""

import pytest

from station.config.controllers import ControllerFile
from station.config.loads import HungWeightLoad, NoLoad, RampLoad, TapLoad, TrapezoidLoad, WallLoad
from station.config.motions import CircleMotion, JointSweepMotion, StepMotion, WaypointsMotion
from station.config.strict import Strict
from station.experiments.case_summary import (
    case_facts,
    describe_controller,
    describe_keys,
    load_windows,
    motion_title,
    window_name,
)
from station.lab.faults import LabFault
from tests.harness.cases import a_case


def test_title_of_a_free_motion_has_the_values_that_differ_from_their_defaults():
    circle = CircleMotion(radius=0.005, period=6.0)
    assert motion_title(circle, NoLoad()) == "circle, radius 5 mm, period 6 s"
    pulled = motion_title(circle, HungWeightLoad(weight=0.2))
    assert pulled == "circle, radius 5 mm, period 6 s; load hung weight, weight 0.2 N"


@pytest.mark.parametrize(
    ("model", "text"),
    [
        (CircleMotion(radius=0.01, period=12.0), "circle: radius 10 mm, period 12 s, along z"),
        (
            CircleMotion(radius=0.01, period=12.0, normal=(0.0, 0.6, -0.8)),
            "circle: radius 10 mm, period 12 s, along (0, 0.6, -0.8)",
        ),
        (StepMotion(offset=(0.001, 0.0, 0.0), stay=6.0), "step: offset 1, 0, 0 mm, stay 6 s"),
        (StepMotion(offset=(0.001, 0.0, 0.0)), "step: offset 1, 0, 0 mm"),
        (
            WaypointsMotion(points=((5.0, 0.0, 0.01, 0.0), (10.0, 0.0, 0.0, 0.0))),
            "waypoints: 2 points in 10 s, up to 10 mm from the start",
        ),
        (
            JointSweepMotion(joint="outer_rotation", speed=0.05235988, distance=6.2831853),
            "joint sweep: joint outer rotation, speed 3 °/s, distance 360 °",
        ),
        (NoLoad(), "none"),
        (
            HungWeightLoad(weight=0.2, lowering=3.0),
            "hung weight: along x, weight 0.2 N, lowering 3 s, frequency 2 Hz, damping 0.05, start 0 s",
        ),
        (RampLoad(times=(0.0, 2.5), magnitudes=(0.0, 0.5)), "ramps: along x, times 0, 2.5 s, magnitudes 0, 0.5 N"),
        (
            LabFault(kind="mute", device="tracker", at=10.0, duration=0.2),
            "mute: device tracker, at 10 s, duration 0.2 s",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_case_summary_shows_motion_load_and_fault_with_numbers_and_units(model: Strict, text: str):
    assert describe_keys(model) == text


def test_summary_of_a_wall_shows_only_keys_that_have_an_effect():
    at_rest, moving = describe_keys(WallLoad()), describe_keys(WallLoad(amplitude=0.005, lump_stiffness=200.0))

    for word in ("amplitude", "frequency", "lump"):
        assert word not in at_rest
        assert word in moving
    assert "stiffness 1000 N/m" in at_rest


def test_summary_of_a_controller_shows_the_frame_of_its_stiffness():
    controller = ControllerFile(stiffness=(30.0, 30.0, 300.0), stiffness_frame="tip")
    assert describe_controller(controller).endswith("stiffness 30, 30, 300 N/m, stiffness frame tip")
    assert "stiffness" not in describe_controller(ControllerFile())


def test_the_case_summary_shows_the_sweep_of_a_translation_joint_in_millimetres():
    sweep = JointSweepMotion(joint="inner_translation", speed=-0.002, distance=0.01)
    assert describe_keys(sweep, turns=False) == "joint sweep: joint inner translation, speed -2 mm/s, distance 10 mm"


def test_case_facts_describe_every_part_of_a_case():
    facts = dict(case_facts(a_case("fig10", "paper")))
    assert facts == {
        "motion": "sinusoid: along z, amplitude 10 mm, frequency 0.05 Hz",
        "load": "raised cosine: along x, peak 0.5 N, period 20 s",
        "control": "dual layer, inner type 1, feedback tracker, k1 2.5 1/s, k2 2.5 1/s",
        "model": "the paper's integrator, sub-links of 10 mm",
        "duration": "200 s, errors count from 0 s on",
        "start pose": "outer rotation 0 °, inner rotation 90 °, inner translation -100 mm",
    }


LIFTED = TrapezoidLoad(magnitude=0.5, rise=1.0, stay=4.0, fall=0.5, start=2.0)


def test_each_part_of_a_motion_ends_with_the_next_change_of_the_load_or_with_the_motion():
    assert load_windows(LIFTED, 20.0) == [(2.0, 7.0), (7.0, 20.0)]
    assert load_windows(LIFTED, 5.0) == [(2.0, 5.0)]
    assert load_windows(TapLoad(peak=0.5, start=1.5), 3.0) == [(1.5, 3.0)]
    assert load_windows(NoLoad(), 3.0) == []


def test_parts_of_a_motion_are_named_by_the_time_of_the_load_change():
    assert [window_name(begin) for begin, _ in load_windows(LIFTED, 20.0)] == ["2 s", "7 s"]
