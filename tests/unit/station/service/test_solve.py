"""`ctr-station solve`: every input line gets an answer of the model, and an invalid line gets an error."""

import json
import math
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.model.cosserat import ExactRod, Loads
from core.model.solution import at_rest
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube
from station.config.robots import RobotFile
from station.service.solve import KEYS, batched_lines, solve_lines, stability
from tests.harness.root import ROOT

EXACT_TIPS = Path(__file__).parents[2] / "exact_tips.csv"
POSE = {"outer_rotation": 0.0, "inner_rotation": 1.5708, "inner_translation": -0.1}


@pytest.fixture
def answers(paper_robot):
    """Return the answers to requests; each request is an object or a line of text."""

    def ask(*requests: object, sublink: float | None = None, exact: bool = False) -> list[dict]:
        lines = [request if isinstance(request, str) else json.dumps(request) for request in requests]
        return [json.loads(answer) for answer in solve_lines([lines], paper_robot, sublink, exact=exact)]

    return ask


def test_answer_of_solve_has_the_documented_keys_and_shapes(answers):
    (answer,) = answers({"joints": POSE, "force": [0.2, 0, 0]})

    assert set(answer) == {
        "tip",
        "direction",
        "ends",
        "joints",
        "jacobian",
        "compliance",
        "iterations",
        "stability",
        "integrator",
        "sublink",
    }
    assert answer["joints"] == ["outer_rotation", "inner_rotation", "inner_translation"]
    assert np.shape(answer["tip"]) == (3,)
    assert np.linalg.norm(answer["direction"]) == pytest.approx(1.0)
    assert np.shape(answer["jacobian"]) == (3, 3)
    assert np.shape(answer["compliance"]) == (3, 3)
    assert isinstance(answer["iterations"], int)
    assert answer["stability"] == "stable"


def test_readme_documents_every_key_of_a_line_and_of_an_answer(answers):
    text = (ROOT / "core" / "README.md").read_text(encoding="utf-8")
    tables = text.split("## The command `solve`")[1].split("\n## ")[0].split("| key of ")[1:]
    line, answer = (set(re.findall(r"`(\w+)`(?=[^|]*\|.*\|$)", table, re.MULTILINE)) for table in tables)
    assert line == set(KEYS)
    assert answer == {"warnings"}.union(*answers({"joints": POSE}, "no JSON"))


@pytest.mark.parametrize(
    ("part", "moment", "expected"),
    [(0.9, 0.0, "stable"), (1.1, 0.0, "unstable"), (0.9, 1e-9, "stable"), (1.1, 1e-9, "not known to be stable")],
)
def test_solve_reports_a_straight_tube_as_stable_up_to_the_euler_load(part, moment, expected):
    """A straight tube buckles above the Euler load. A tip moment has no potential energy, so it hides the stability."""
    length = 0.15
    wrench = np.array([0.0, 0.0, -part * math.pi**2 * 0.04 / (4.0 * length**2), 0.0, 0.0, moment])
    moved = (Joint("turn", 0, "rotation"), Joint("push", 0, "translation"))
    model = Statics(Robot("one", (Tube("one", (Section(0.2),), 0.04),), moved), 0.0025)
    joints = np.array([0.0, -0.05])
    assert stability(model, model.solve(joints, wrench, at_rest(joints, math.inf, 1))) == expected


def test_jacobian_and_compliance_of_solve_equal_published_derivatives(answers):
    pose = {"outer_rotation": 0.0, "inner_rotation": math.pi / 2, "inner_translation": -0.075}
    (answer,) = answers({"joints": pose, "force": [0.2, 0, 0]}, sublink=0.0025)

    # The published values are central differences of an exact solver at this pose and load, rounded to 1e-6.
    by_joint = [[0.042281, 0.005541, -0.008890], [0.005308, 0.022191, 0.006513], [0.255580, -0.273378, 0.886618]]
    assert np.array(answer["jacobian"]) == pytest.approx(np.transpose(by_joint), abs=1e-4)
    compliance = np.array(answer["compliance"])
    assert compliance[np.triu_indices(3)] == pytest.approx(
        [0.042502, 0.002744, -0.009264, 0.042615, 0.011886, 0.006001], abs=2e-5
    )


def test_model_and_exact_rod_of_solve_agree_with_three_independent_solvers(answers):
    table = np.loadtxt(EXACT_TIPS, delimiter=",", skiprows=1)
    names = ("inner_translation", "outer_rotation", "inner_rotation")
    requests = [{"joints": dict(zip(names, row[:3], strict=True)), "force": row[3:6].tolist()} for row in table]
    tips = 1e-3 * table[:, 6:9]

    for exact, bound in ((False, 0.08e-3), (True, 0.001e-3)):
        given = np.array([answer["tip"] for answer in answers(*requests, exact=exact)])
        assert np.linalg.norm(given - tips, axis=1).max() <= bound


def test_derivatives_of_solve_with_the_exact_rod_are_those_of_the_model(answers):
    request = {"joints": POSE, "force": [0.2, 0, 0]}
    (answer,), (fast,) = answers(request, exact=True), answers(request, sublink=0.0025)

    assert np.array(answer["jacobian"]) == pytest.approx(np.array(fast["jacobian"]), abs=1e-4)
    assert np.array(answer["compliance"]) == pytest.approx(np.array(fast["compliance"]), abs=2e-5)
    assert answer["stability"] == "not known to be stable"


def test_request_to_solve_may_have_joints_in_any_order_and_no_force(answers):
    turned = dict(reversed(POSE.items()))
    first, second, third = answers({"joints": POSE, "force": [0, 0, 0]}, {"joints": turned}, {"joints": POSE})

    assert first == second == third


def test_loads_on_the_shaft_and_weights_are_those_of_the_exact_rod(paper):
    robot = paper.robot()
    joints, force = np.array([POSE[name] for name in robot.joint_names]), [0.1, 0.0, 0.0]
    rod, none = ExactRod(robot), np.zeros(6)
    at, own = (0.1, np.array(force)), np.array([tube.weight for tube in robot.tubes])
    requests = (
        {"joints": POSE, "force": force, "contact": 0.1},
        {"joints": POSE, "loads": [{"at": 0.1, "force": force}, {"at": 0.05, "force": [0, 0.2, 0]}]},
        {"joints": POSE, "gravity": [2, 0, 0], "distributed": [0, 0.3, 0]},
    )
    found = [json.loads(answer) for answer in solve_lines([[json.dumps(request) for request in requests]], robot)]
    both = Loads([at, (0.05, np.array([0, 0.2, 0]))])
    loads = (Loads([at]), both, Loads((), np.outer(own, [1, 0, 0]), np.array([0, 0.3, 0])))
    for answer, load, error in zip(found, loads, (0.1e-3, 1e-9, 1e-9), strict=True):
        assert answer["tip"] == pytest.approx(rod.solve(joints, none, loads=load).tip, abs=error)
    assert len(found[0]["jacobian"]) == 3


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"contact": 0.9}, "contact at 900 mm"),
        ({"loads": [{"at": 0.9, "force": [0, 0, 1]}]}, "a load at 900 mm is outside 0 ..."),
        ({"loads": [{"force": [0, 0, 1]}]}, "loads[0] = "),
        ({"loads": {}}, "loads = {}"),
        ({"gravity": [0, 0, 0]}, "gravity = [0, 0, 0]"),
        ({"distributed": [0, 0]}, "distributed = [0, 0]"),
        ({"distributed": [0, 0, 1], "follow": True}, "follow: not possible with the exact rod"),
    ],
)
def test_an_impossible_load_is_refused_by_its_key(answers, more, words):
    (answer,) = answers({"joints": POSE} | more)
    assert words in answer["error"]


def test_a_retracted_tip_is_the_end_of_the_innermost_tube(answers):
    (answer,) = answers({"joints": POSE | {"inner_translation": -0.25}})
    assert np.linalg.norm(answer["ends"]["inner"]) < 0.054 < 0.16 < np.linalg.norm(answer["ends"]["outer"])
    assert answer["tip"] == pytest.approx(answer["ends"]["inner"], abs=1e-7)


def test_tip_moment_bends_the_tip(answers):
    free, bent = answers({"joints": POSE}, {"joints": POSE, "moment": [0.01, 0, 0]})

    assert np.linalg.norm(np.subtract(free["tip"], bent["tip"])) > 1e-3


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("good morning", "not JSON: "),
        ("[" * 100_000, "not JSON: "),
        ('{"joints": ' + "1" * 5000 + "}", "not JSON: "),
        ("3", "expected an object with 'joints' and 'force', not int"),
        ("{}", "joints: expected an object with outer_rotation, inner_rotation, inner_translation"),
        ('{"joints": [0, 1.57, -0.1]}', "joints: expected an object with outer_rotation, "),
        ({"joints": {**POSE, "elbow": 1.0}}, "joints.elbow: 'paper' has no such joint; it has outer_rotation, "),
        ({"joints": {"outer_rotation": 0.0, "inner_rotation": 1.0}}, "joints.inner_translation is missing"),
        ({"joints": {**POSE, "inner_rotation": "1"}}, "joints.inner_rotation = '1': expected a number between"),
        ({"joints": {**POSE, "inner_rotation": True}}, "joints.inner_rotation = True: expected a number between"),
        ({"joints": {**POSE, "inner_rotation": math.nan}}, "joints.inner_rotation = nan: expected a number between"),
        ({"joints": POSE, "force": [math.nan, 0, 0]}, "force[0] = nan: expected a number between"),
        ({"joints": POSE, "force": [0.2, 0]}, "force = [0.2, 0]: expected three numbers"),
        ({"joints": POSE, "force": 0.2}, "force = 0.2: expected three numbers"),
        ({"joints": POSE, "force": [0, 0, 10**400]}, "force[2] = 1000"),
        ({"joints": POSE, "moment": [0, "1", 0]}, "moment[1] = '1': expected a number between"),
        ({"joints": POSE, "froce": [0.2, 0, 0]}, "unknown key 'froce'; known are joints, force, moment"),
        ({"joints": {**POSE, "inner_translation": 0.01}}, "tube 'inner' starts at 10 mm, in front of "),
        ({"joints": {**POSE, "inner_translation": -0.4}}, "tube 'inner' ends at -97 mm, but must not end behind "),
        ({"joints": POSE, "force": [1e6, 0, 0]}, "no shape found "),
    ],
)
def test_invalid_line_to_solve_gets_an_error_and_does_not_affect_other_lines(answers, line, error):
    good = {"joints": POSE, "force": [0.2, 0, 0]}
    before, bad, after = answers(good, line, good)

    assert list(bad) == ["error"]
    assert bad["error"].startswith(error)
    assert before == after
    assert "tip" in after


def test_solve_skips_empty_lines(answers):
    assert len(answers("", "  \n", {"joints": POSE}, "\n")) == 1


def test_solve_answers_of_a_batch_equal_the_answers_of_single_lines(paper_robot):
    random = np.random.default_rng(2)
    good = [
        json.dumps({"joints": {**POSE, "inner_rotation": angle}, "force": [0.1, 0.2, 0.0], "moment": [moment, 0, 0]})
        for angle, moment in zip(random.uniform(-3.0, 3.0, 12), [0.0] * 9 + [0.01] * 3, strict=True)
    ]
    lines = [*good[:6], "{", "", json.dumps({"joints": {**POSE, "inner_translation": 0.01}}), *good[6:]]

    together, alone = (
        [json.loads(answer) for answer in solve_lines(batches, paper_robot, 0.010, exact=False)]
        for batches in ([lines], [[line] for line in lines])
    )
    assert ["error" in answer for answer in together] == [False] * 6 + [True, True] + [False] * 6
    for one, other in zip(together, alone, strict=True):
        assert one.keys() == other.keys()
        assert one.get("error") == other.get("error")
        # The comparison has a tolerance, because recompiled code may round differently.
        for part in {"tip", "jacobian", "compliance"} & one.keys():
            np.testing.assert_allclose(one[part], other[part], rtol=1e-7, atol=1e-11)


def test_solve_answers_a_line_before_the_next_line_is_written():
    """A program that uses `solve` may wait for each answer before it writes the next line."""
    reads, writes = os.pipe()
    with os.fdopen(reads, "rb") as source, os.fdopen(writes, "wb", buffering=0) as sink:
        batches = batched_lines(source)
        for sent, come in ((b"one\n", ["one"]), (b"two\nthr", ["two"]), (b"ee\nfo\xffur\n", ["three", "fo\ufffdur"])):
            sink.write(sent)
            assert next(batches) == come
        sink.write(b"last")
        sink.close()
        assert list(batches) == [[], ["last"]]


def snapping_pair() -> RobotFile:
    """Return the file of two tubes that snap as the inner one turns: snap number above 1."""
    tube = {"bending_stiffness": 0.01, "poisson_ratio": 0.3, "sections": [
        {"length": 0.2}, {"length": 0.1, "curvature": [12.0, 0.0]}]}  # fmt: skip
    stage = {"motion": "rotation", "lower": -4.0, "upper": 4.0, "speed": 1.0, "acceleration": 1.0, "microstep": 1e-5}
    return RobotFile.model_validate(
        {"name": "pair", "tubes": [
            {**tube, "name": "inner", "outer_diameter": 0.001, "inner_diameter": 0.0008, "translation": -0.2},
            {**tube, "name": "outer", "outer_diameter": 0.0014, "inner_diameter": 0.0011, "translation": -0.2},
        ], "joints": [{**stage, "name": "turn", "tube": "inner"}]}, strict=False,
    )  # fmt: skip


def test_a_line_with_follow_continues_the_shape_of_the_line_before():
    """Past half a turn two shapes exist: the followed one, checked with the exact rod, and the one from rest."""
    robot = snapping_pair().robot()
    turns = np.linspace(0.0, 3.5, 36)
    lines = [json.dumps({"joints": {"turn": turn}, "follow": True}) for turn in turns.tolist()]
    rod, exact = None, ExactRod(robot)
    for turn in turns:
        rod = exact.solve(np.array([turn]), np.zeros(6), rod)
    # Lines that arrive in separate batches are followed, too.
    followed = [json.loads(answer) for answer in solve_lines([lines[:20], lines[20:]], robot)][-1]
    cold = json.loads(next(iter(solve_lines([[lines[-1]]], robot))))

    assert np.linalg.norm(np.subtract(followed["tip"], rod.tip)) < 0.1e-3
    assert np.linalg.norm(np.subtract(cold["tip"], rod.tip)) > 10e-3


def test_a_joint_beyond_its_travel_and_a_tube_beyond_nitinols_strain_are_reported(answers, paper):
    limits = paper.limits().joints
    (warned,) = solve_lines([[json.dumps({"joints": {**POSE, "outer_rotation": 90.0}})]], paper.robot(), limits=limits)
    assert json.loads(warned)["warnings"] == ["outer_rotation 90 rad is outside -6.28319 ... 6.28319 rad (its travel)"]
    (fine,) = solve_lines([[json.dumps({"joints": POSE})]], paper.robot(), limits=limits)
    assert "warnings" not in json.loads(fine)


@pytest.mark.parametrize(("radius", "warns"), [(0.010, False), (0.002, True)])
def test_the_strain_of_a_straightened_tube_is_its_radius_over_the_curves(radius, warns):
    """A soft curved tube in a stiff straight one is straightened: strain = tube radius / radius of its curve."""
    inner = Tube("inner", (Section(0.1, (1.0 / radius, 0.0)),), 1e-6, 0.3, 1.0e-3, 0.5e-3)
    outer = Tube("outer", (Section(0.1),), 10.0, 0.3, 2.0e-3, 1.5e-3)
    robot = Robot("straightened", (inner, outer), (Joint("turn", 0, "rotation"),))
    statics = Statics(robot)
    strains = statics.strains(statics.solve(np.zeros(1), np.zeros(6)))
    assert strains[0] == pytest.approx(0.5e-3 / radius, rel=1e-3)
    assert strains[1] == pytest.approx(0.0, abs=1e-4)
    answer = json.loads(next(iter(solve_lines([[json.dumps({"joints": {"turn": 0.0}})]], robot))))
    assert ("warnings" in answer) is warns
    steel = replace(robot, tubes=(replace(inner, max_strain=0.002), outer))
    answer = json.loads(next(iter(solve_lines([[json.dumps({"joints": {"turn": 0.0}})]], steel))))
    assert "tube 'inner' is strained by" in answer["warnings"][0]
    assert "at most 0.2 % (max_strain)" in answer["warnings"][0]
