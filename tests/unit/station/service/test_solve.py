"""`ctr-station solve`: every input line gets an answer of the model, and an invalid line gets an error."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest

from core.model.solution import at_rest
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube
from station.service.solve import batched_lines, solve_lines, stability

EXACT_TIPS = Path(__file__).parents[2] / "exact_tips.csv"
POSE = {"outer_rotation": 0.0, "inner_rotation": 1.5708, "inner_translation": -0.1}


@pytest.fixture
def answers(paper_robot):
    """Return the answers to requests; each request is an object or a line of text."""

    def ask(*requests: object, sublink: float = 0.010, exact: bool = False) -> list[dict]:
        lines = [request if isinstance(request, str) else json.dumps(request) for request in requests]
        return [json.loads(answer) for answer in solve_lines([lines], paper_robot, sublink, exact)]

    return ask


def test_answer_of_solve_has_the_documented_keys_and_shapes(answers):
    (answer,) = answers({"joints": POSE, "force": [0.2, 0, 0]})

    assert set(answer) == {"tip", "direction", "joints", "jacobian", "compliance", "iterations", "stability"}
    assert answer["joints"] == ["outer_rotation", "inner_rotation", "inner_translation"]
    assert np.shape(answer["tip"]) == (3,)
    assert np.linalg.norm(answer["direction"]) == pytest.approx(1.0)
    assert np.shape(answer["jacobian"]) == (3, 3)
    assert np.shape(answer["compliance"]) == (3, 3)
    assert isinstance(answer["iterations"], int)
    assert answer["stability"] == "stable"


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


def test_model_and_exact_rod_agree_within_a_tenth_of_a_millimetre(answers):
    random = np.random.default_rng(4)
    requests = [
        {
            "joints": dict(zip(POSE, [*random.uniform(-3.0, 3.0, 2), random.uniform(-0.12, -0.01)], strict=True)),
            "force": random.uniform(-0.25, 0.25, 3).tolist(),
        }
        for _ in range(20)
    ]
    tips = [np.array([answer["tip"] for answer in answers(*requests, exact=exact)]) for exact in (False, True)]

    assert np.linalg.norm(tips[0] - tips[1], axis=1).max() < 1e-4


def test_answer_of_solve_with_the_exact_rod_has_only_the_tip(answers):
    (answer,) = answers({"joints": POSE}, exact=True)

    assert set(answer) == {"tip", "joints", "iterations", "stability"}
    assert answer["stability"] == "not known to be stable"


def test_request_to_solve_may_have_joints_in_any_order_and_no_force(answers):
    turned = dict(reversed(POSE.items()))
    first, second, third = answers({"joints": POSE, "force": [0, 0, 0]}, {"joints": turned}, {"joints": POSE})

    assert first == second == third


def test_tip_moment_bends_the_tip(answers):
    free, bent = answers({"joints": POSE}, {"joints": POSE, "moment": [0.01, 0, 0]})

    assert np.linalg.norm(np.subtract(free["tip"], bent["tip"])) > 1e-3


def test_shorter_sub_link_is_closer_to_the_exact_rod(answers):
    request = {"joints": POSE, "force": [0.2, 0.1, 0]}
    exact = np.array(answers(request, exact=True)[0]["tip"])
    errors = [np.linalg.norm(answers(request, sublink=m)[0]["tip"] - exact) for m in (0.02, 0.01, 0.005)]

    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("good morning", "not JSON: "),
        ("{", "not JSON: "),
        ("[" * 100_000, "not JSON: "),
        ('{"joints": ' + "1" * 5000 + "}", "not JSON: "),
        ("3", "expected an object with 'joints' and 'force', not int"),
        ("[]", "expected an object with 'joints' and 'force', not list"),
        ("{}", "joints: expected an object with outer_rotation, inner_rotation, inner_translation"),
        ('{"joints": [0, 1.57, -0.1]}', "joints: expected an object with outer_rotation, "),
        ({"joints": {**POSE, "elbow": 1.0}}, "joints.elbow: 'paper' has no such joint; it has outer_rotation, "),
        ({"joints": {"outer_rotation": 0.0, "inner_rotation": 1.0}}, "joints.inner_translation is missing"),
        ({"joints": {**POSE, "inner_rotation": "1"}}, "joints.inner_rotation = '1': expected a finite number"),
        ({"joints": {**POSE, "inner_rotation": None}}, "joints.inner_rotation = None: expected a finite number"),
        ({"joints": {**POSE, "inner_rotation": True}}, "joints.inner_rotation = True: expected a finite number"),
        ({"joints": {**POSE, "inner_rotation": math.nan}}, "joints.inner_rotation = nan: expected a finite number"),
        ({"joints": {**POSE, "inner_rotation": math.inf}}, "joints.inner_rotation = inf: expected a finite number"),
        ({"joints": POSE, "force": [math.nan, 0, 0]}, "force[0] = nan: expected a finite number"),
        ({"joints": POSE, "force": [0.2, 0]}, "force = [0.2, 0]: expected three numbers"),
        ({"joints": POSE, "force": 0.2}, "force = 0.2: expected three numbers"),
        ({"joints": POSE, "force": [0, 0, 10**400]}, "force[2] = 1000"),
        ({"joints": POSE, "moment": [0, "1", 0]}, "moment[1] = '1': expected a finite number"),
        ({"joints": POSE, "froce": [0.2, 0, 0]}, "unknown key 'froce'; known are joints, force, moment"),
        ({"joints": {**POSE, "inner_translation": 0.01}}, "tube 'inner' starts at 10 mm, in front of "),
        ({"joints": {**POSE, "inner_translation": -0.2}}, "tube 'inner' ends at 103 mm, but must end beyond "),
        ({"joints": POSE, "force": [1e6, 0, 0]}, "no shape found "),
    ],
)
@pytest.mark.parametrize("exact", [False, True])
def test_invalid_line_to_solve_gets_an_error_and_does_not_affect_other_lines(answers, line, error, exact):
    good = {"joints": POSE, "force": [0.2, 0, 0]}
    before, bad, after = answers(good, line, good, exact=exact)

    assert list(bad) == ["error"]
    if not (exact and "no shape" in error):
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
        for part in {
            "tip",
            "jacobian",
            "compliance",
        } & one.keys():  # the comparison has a tolerance, because recompiled code may round differently
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
