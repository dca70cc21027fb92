"""Each variant of a G-code board is connected, homed, moved and connected again, in virtual time."""

from dataclasses import replace

import numpy as np
import pytest

from station.config.robots import RobotFile
from station.devices.gcode.setup import AxisSetup, GcodeAxisFile
from station.devices.gcode.stages import gcode_stages
from station.devices.interfaces import Condition
from station.lab.config import STAGES_VARIANTS, LabChoice, StagesKind, load_lab
from station.lab.gcode_variants import VARIANTS, BoardVariant
from station.lab.simulated_gcode import SimulatedBoard
from tests.harness.stages_bench import START, StagesBench

SPEEDS = np.array([-0.3, 0.3, 0.015])
#: A board whose third axis is C.
XYC = replace(VARIANTS["grblhal"], order="XYC")
BOARDS = {**VARIANTS, "axes X, Y, C": XYC}
CASES = [("grbl", name) for name in BOARDS] + [("marlin", name) for name in STAGES_VARIANTS["marlin"]]


def bench_of(robot: RobotFile, dialect: str, variant: BoardVariant, homed: bool = True) -> StagesBench:
    """Return a bench whose board is a variant; its axes have the variant's letters."""
    bench = StagesBench(robot, dialect)
    places = [(q - s.home_at) / s.joint.microstep for q, s in zip(START, bench.setups, strict=True)]
    bench.simulated = SimulatedBoard(dialect, bench.setups, places, homed, 0, variant)
    axes = zip(robot.joints, variant.order, strict=False)
    bench.stages = gcode_stages(
        [AxisSetup.of(joint, GcodeAxisFile(letter=c)) for joint, c in axes], bench.host, dialect
    )
    return bench


def moves(bench: StagesBench) -> None:
    """Check that every stage moves at its velocity, also below the home position of a rotation, and is known there."""
    before, start = bench.positions, bench.now
    bench.run(2.0, lambda now: SPEEDS.tolist())
    bench.stages.stop(bench.now)
    bench.run(0.5)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert bench.positions - before == pytest.approx(SPEEDS * 2.0, rel=0.1), bench.now - start
    assert bench.reading.positions == pytest.approx(bench.positions, abs=2e-4)


@pytest.mark.parametrize(("dialect", "name"), CASES)
def test_homed_board_connects_and_moves(paper: RobotFile, dialect: str, name: str) -> None:
    bench = bench_of(paper, dialect, BOARDS[name]).connect()
    assert bench.stages.ready, bench.cause
    assert bench.reading.positions == pytest.approx(START, abs=2e-4)
    moves(bench)


@pytest.mark.parametrize(("dialect", "name"), CASES)
def test_board_without_home_is_homed_and_keeps_its_home_in_the_next_session(
    paper: RobotFile, dialect: str, name: str
) -> None:
    bench = bench_of(paper, dialect, BOARDS[name], homed=False).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready
    bench.home()
    assert bench.stages.ready, bench.cause
    moves(bench)
    bench.connect()
    assert bench.stages.ready, bench.cause
    assert bench.reading.positions == pytest.approx(bench.positions, abs=2e-4)


def test_board_that_sends_something_else_is_quoted(paper: RobotFile) -> None:
    bench = StagesBench(paper, "marlin")
    bench.simulated = StagesBench(paper, "grbl").simulated
    bench.connect()
    assert "the board sends '" in bench.cause
    assert 'its `dialect` "marlin" or "grbl"' in bench.cause


def test_settings_of_grbl_on_which_motions_depend_are_set(paper: RobotFile) -> None:
    bench = bench_of(paper, "grbl", replace(VARIANTS["usual"], settings={1: 25.0, 10: 2.0, 13: 1.0})).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert [bench.simulated.settings[number] for number in (1, 10, 13)] == [255.0, 3.0, 0.0]


@pytest.mark.parametrize(("number", "what"), [(20, "soft limits"), (40, "limits of jogs")])
def test_limits_of_grbl_that_do_not_contain_the_travel_are_named(paper: RobotFile, number: int, what: str) -> None:
    settings = {number: 1.0, 23: 0.0, 27: 1.0}
    bench = bench_of(paper, "grbl", replace(VARIANTS["as_delivered"], settings=settings)).connect()
    assert f"${number} = 1: {what} keep X between -200 and 0, but outer_rotation moves from" in bench.cause


def test_missing_axis_is_named_with_those_of_the_board(paper: RobotFile) -> None:
    bench = bench_of(paper, "grbl", XYC)
    axes = zip(paper.joints, "XYZ", strict=True)
    bench.stages = gcode_stages([AxisSetup.of(joint, GcodeAxisFile(letter=c)) for joint, c in axes], bench.host, "grbl")
    bench.connect()
    assert "the board has no axis Z, which moves inner_translation; its axes are X, Y, C" in bench.cause


def test_check_mode_is_ended_when_connecting_and_named_later(paper: RobotFile) -> None:
    bench = StagesBench(paper, "grbl")
    bench.simulated.checking = True
    bench.connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.simulated.checking
    bench.simulated.checking = True
    bench.run(0.3)
    assert "the board reports the state 'Check': end its check mode" in bench.cause


def test_marlin_whose_soft_endstops_stay_on_is_refused(paper: RobotFile) -> None:
    bench = bench_of(paper, "marlin", replace(VARIANTS["usual"], soft_endstops="fixed")).connect()
    assert "the firmware's soft endstops stay on (M211)" in bench.cause


@pytest.mark.parametrize(
    ("kind", "variant"), [(kind, name) for kind in STAGES_VARIANTS for name in STAGES_VARIANTS[kind]]
)
def test_every_variant_of_a_labs_file_connects_and_homes(paper: RobotFile, kind: StagesKind, variant: str) -> None:
    lab = load_lab(LabChoice(stages=kind, variant=variant), paper)
    bench = StagesBench(paper, kind, homed=False, variant=lab.variant).connect()
    bench.home()
    assert bench.stages.ready, bench.cause
    moves(bench)


def test_unknown_variant_is_refused_with_those_of_the_stages() -> None:
    with pytest.raises(ValueError, match="variant = 'grblhal': stages 'marlin' have the variants usual, starts_slowly"):
        LabChoice(stages="marlin", variant="grblhal")
