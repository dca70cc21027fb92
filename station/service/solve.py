"""`ctr-station solve`: the loaded model as a filter, JSON lines in, JSON lines out."""

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Literal

import numpy as np

from core.errors import CtrError
from core.model.cosserat import ExactRod
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.config.strict import ConfigError

Stability = Literal["stable", "unstable", "not known to be stable"]


def solve_lines(lines: Iterable[str], robot: Robot, sublink: float, exact: bool) -> Iterator[str]:
    """Answer each line; a line that cannot be answered gets {"error": ...} and the next one its turn."""
    statics, rod = Statics(robot, sublink), ExactRod(robot)
    for line in lines:
        if not line.strip():
            continue
        try:
            joints, wrench = parse(line, robot)
            answer = exact_answer(rod, joints, wrench) if exact else model_answer(statics, joints, wrench)
        except CtrError as error:
            answer = {"error": str(error)}
        yield json.dumps(answer)


def parse(line: str, robot: Robot) -> tuple[Array, Array]:
    """Joints (n,) and tip wrench (6,) of a request.

    Raises:
        ConfigError: what is wrong with it.
    """
    try:
        request = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not JSON: {error}") from None
    if not isinstance(request, dict):
        raise ConfigError(f"expected an object with 'joints' and 'force', not {type(request).__name__}")
    if unknown := [key for key in request if key not in ("joints", "force", "moment")]:
        raise ConfigError(f"unknown key '{unknown[0]}'; known are joints, force, moment")
    given = request.get("joints")
    if not isinstance(given, Mapping):
        raise ConfigError(f"joints: expected an object with {', '.join(robot.joint_names)}")
    known = ", ".join(robot.joint_names)
    if unknown := [key for key in given if key not in robot.joint_names]:
        raise ConfigError(f"joints.{unknown[0]}: '{robot.name}' has no such joint; it has {known}")
    joints: list[float] = []
    for name in robot.joint_names:
        if name not in given:
            raise ConfigError(f"joints.{name} is missing")
        joints.append(_number(f"joints.{name}", given[name]))
    wrench = [*_three("force", request.get("force", (0, 0, 0))), *_three("moment", request.get("moment", (0, 0, 0)))]
    return np.array(joints), np.array(wrench)


def model_answer(statics: Statics, joints: Array, wrench: Array) -> dict[str, Any]:
    """Tip [m], Jacobian [m/rad, m/m] and compliance [m/N] of the paper's model, and whether the shape is stable.

    Raises:
        PoseError, NotFinite, NoSolution: see `Statics.solve`.
    """
    solution = statics.solve(joints, wrench)
    return {
        "tip": solution.tip.tolist(),
        "joints": list(statics.robot.joint_names),
        "jacobian": solution.jacobian[:3].tolist(),
        "compliance": solution.compliance[:3, :3].tolist(),
        "iterations": solution.iterations,
        "stability": stability(statics, solution),
    }


def stability(statics: Statics, solution: Solution) -> Stability:
    """Whether the robot stays there, by the second variation of its elastic energy.

    A moment at the tip has no energy: what falls under one may stay all the same.
    """
    if statics.negative_directions(solution) == 0:
        return "stable"
    return "not known to be stable" if solution.wrench[3:].any() else "unstable"


def exact_answer(rod: ExactRod, joints: Array, wrench: Array) -> dict[str, Any]:
    """Tip [m] of the exact rod, whose energy nobody has asked."""
    solution = rod.solve(joints, wrench)
    unknown: Stability = "not known to be stable"
    return {
        "tip": solution.tip.tolist(), "joints": list(rod.robot.joint_names), "iterations": solution.iterations,
        "stability": unknown,
    }  # fmt: skip


def _three(what: str, value: Any) -> list[float]:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise ConfigError(f"{what} = {value!r}: expected three numbers")
    return [_number(f"{what}[{index}]", part) for index, part in enumerate(value)]


def _number(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= 1e9:
        raise ConfigError(f"{what} = {value!r}: expected a finite number")
    return float(value)
