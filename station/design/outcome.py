"""Outcome of a design search: evaluation of start robot and found robot, also under growing loads and as exact rods."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError
from core.model.cosserat import ExactRod, Rod
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.monitors import Margins, check_design
from station.design.search import Line, best, parameters_of
from station.design.study import Study, StudyTaskFile, largest, unit
from station.design.task import HeldLoad, TaskResult, evaluate


class ExactCheck(NamedTuple):
    """Numbers of the exact rod at the joint positions that the evaluation has found with the sub-link model."""

    distance: float  #: largest distance of the exact rod's tip from the task's points [m]
    margin: float  #: smallest margin of stability of the exact rod [1]


def exact(file: RobotFile, task: StudyTaskFile, held: HeldLoad) -> ExactCheck:
    """Compute the exact rod at every point of a task under every force, and return the check.

    Raises:
        NoSolution: the exact rod has no solution at one of the points.

    """
    rod = ExactRod(file.robot())
    distance, margin = 0.0, np.inf
    for force, row in zip(held.load * np.array(task.forces), held.joints, strict=True):
        at: Rod | None = None
        for point, joints in zip(np.array(task.points), row, strict=True):
            wrench: Array = np.concatenate((force, np.zeros(3)))
            at = rod.solve(joints, wrench, at)
            distance = max(distance, float(np.linalg.norm(at.tip - point)))
            margin = min(margin, rod.stability(joints, wrench, at))
    return ExactCheck(distance, margin)


@dataclass(frozen=True)
class EvaluatedDesign:
    """Robot, the result of its evaluation for the task, and the checks with the exact rod."""

    file: RobotFile
    outcome: TaskResult
    exact: ExactCheck | None  #: check with the exact rod under the task's forces
    exact_largest: ExactCheck | None  #: check with the exact rod under the largest forces that the robot holds


@dataclass(frozen=True)
class DesignResult:
    """Result of a finished search: study, candidates, start robot and found robot."""

    study: Study
    lines: Sequence[Line]  #: candidates in the order of the search
    before: EvaluatedDesign
    after: EvaluatedDesign


def design(study: Study, lines: Sequence[Line]) -> DesignResult:
    """Evaluate the start robot and the best candidate under growing loads and with the exact rod."""
    found = best(lines)
    return DesignResult(study, lines, _evaluate(study, study.robot), _evaluate(study, named(study, found)))


def named(study: Study, line: Line) -> RobotFile:
    """Return a candidate as a robot with a new name.

    Raises:
        ConfigError: the robot is impossible.

    """
    file = study.changed(line["parameters"])
    parameters = ", ".join(f"{key} = {value:.5g}" for key, value in parameters_of(study, line).items())
    source = f"'{study.robot.name}' with parameters found by 'ctr-station design {study.name}': {parameters}"
    return file.model_copy(update={"name": f"{study.robot.name}-{study.name}", "source": source})


def _evaluate(study: Study, file: RobotFile) -> EvaluatedDesign:
    task = study.file.task
    outcome = evaluate(file, task, study.file.objective)
    if outcome.nominal is not None:  # working pose: at the point in the middle of the task, under the smallest force
        least = min(range(len(task.forces)), key=lambda row: largest([task.forces[row]]))
        pose = outcome.nominal.joints[least, len(task.points) // 2]
        names = [joint.name for joint in file.joints]
        file = file.model_copy(update={"working_pose": dict(zip(names, pose.tolist(), strict=True))})
    return EvaluatedDesign(file, outcome, _exact(study, file, outcome.nominal), _exact(study, file, outcome.largest))


def _exact(study: Study, file: RobotFile, load: HeldLoad | None) -> ExactCheck | None:
    try:
        return None if load is None else exact(file, study.file.task, load)
    except CtrError:
        return None


def summary(found: DesignResult) -> dict[str, Any]:
    """Return the numbers of a search in N and mm as a JSON object."""
    study = found.study
    before, after = (_numbers(study, each) for each in (found.before, found.after))
    return {
        "study": study.name,
        "title": study.file.title,
        "objective": study.file.objective,
        "candidates": len({tuple(line["parameters"]) for line in found.lines}),
        "better": best(found.lines)["cost"] < found.lines[0]["cost"],
        "before": before,
        "after": after,
        "gain": {
            name: round(after[name] / before[name], 4)
            for name in ("largest_force_n", "least_margin", "least_dexterity_mm_s", "least_stiffness_n_m")
            if before[name] and after[name] is not None
        },
        "parameters": [
            {
                "key": parameter.key, "unit": unit(parameter.key), "before": was, "after": now,
                "lower": parameter.lower, "upper": parameter.upper,
            }
            for parameter, was, now in zip(
                study.file.parameters, study.start_parameters.tolist(),
                best(found.lines)["parameters"], strict=True,
            )
        ],
        "warning": check_design(found.after.file, Margins()),
    }  # fmt: skip


def _numbers(study: Study, design: EvaluatedDesign) -> dict[str, Any]:
    outcome, nominal = design.outcome, design.outcome.nominal
    check, largest_check = design.exact, design.exact_largest
    return {
        "robot": design.file.name,
        "model": Statics(design.file.robot()).discretisation,
        "times_the_load": round(outcome.load, 4),
        "largest_force_n": round(outcome.load * largest(study.file.task.forces), 4),
        "then": outcome.why,
        "least_margin": None if nominal is None else round(float(nominal.margins.min()), 5),
        "least_dexterity_mm_s": None if nominal is None else round(1e3 * float(nominal.dexterities.min()), 4),
        "least_stiffness_n_m": None if nominal is None else round(float(nominal.stiffnesses.min()), 3),
        "exact_away_mm": None if check is None else round(1e3 * check.distance, 4),
        "exact_margin": None if check is None else round(check.margin, 5),
        "exact_away_under_largest_mm": None if largest_check is None else round(1e3 * largest_check.distance, 4),
        "exact_margin_under_largest": None if largest_check is None else round(largest_check.margin, 5),
    }
