"""`ctr-station solve`: read joints and load as JSON lines, and write the model's solutions as JSON lines."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, BinaryIO, Literal

import numpy as np

from core.errors import CtrError
from core.model.cosserat import ExactRod
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.config.strict import ConfigError

Stability = Literal["stable", "unstable", "not known to be stable"]

#: Largest part of the input that is read ahead [bytes], and smallest number of lines that are solved together.
MAX_READ_AHEAD_BYTES, MIN_BATCH_LINES = 1 << 20, 8


def batched_lines(source: BinaryIO) -> Iterator[list[str]]:
    """Yield the available input lines in batches; wait only for the first line of a batch."""
    rest = b""
    while piece := source.read1(MAX_READ_AHEAD_BYTES):  # pyright: ignore[reportAttributeAccessIssue] - a buffered reader's
        *lines, rest = (rest + piece).split(b"\n")
        yield [line.decode(errors="replace") for line in lines]
    yield [rest.decode(errors="replace")]


def solve_lines(batches: Iterable[Sequence[str]], robot: Robot, sublink: float, exact: bool) -> Iterator[str]:
    """Yield the answer to each line; a line that cannot be answered gets {"error": ...}.

    The lines of a batch are solved together; the answers are the same as for separate lines.
    """
    statics, rod = Statics(robot, sublink), ExactRod(robot)
    for lines in batches:
        requests = [_request(line, robot) for line in lines if line.strip()]
        valid = [request for request in requests if not isinstance(request, CtrError)]
        answers = iter(_exact_answers(rod, valid) if exact else _model_answers(statics, valid))
        for request in requests:
            answer = request if isinstance(request, CtrError) else next(answers)
            yield json.dumps({"error": str(answer)} if isinstance(answer, CtrError) else answer)


def _request(line: str, robot: Robot) -> tuple[Array, Array] | CtrError:
    try:
        return parse(line, robot)
    except CtrError as error:
        return error


def _exact_answers(rod: ExactRod, requests: Iterable[tuple[Array, Array]]) -> Iterator[dict[str, Any] | CtrError]:
    for joints, wrench in requests:
        try:
            yield exact_answer(rod, joints, wrench)
        except CtrError as error:
            yield error


def _model_answers(statics: Statics, requests: Sequence[tuple[Array, Array]]) -> Iterator[dict[str, Any] | CtrError]:
    if len(requests) >= MIN_BATCH_LINES:
        from station.solve_many import solve_many  # local import: a single line does not need this module

        joint_rows, wrench_rows = (np.array(rows) for rows in zip(*requests, strict=True))
        together = solve_many(statics, joint_rows, wrench_rows)
    else:
        together = None
    for row, (joints, wrench) in enumerate(requests):
        try:
            yield _answer(statics, statics.solve(joints, wrench) if together is None else together.at(row))
        except CtrError as error:
            yield error


def parse(line: str, robot: Robot) -> tuple[Array, Array]:
    """Return the joints (n,) and the tip wrench (6,) of a request.

    Raises:
        ConfigError: the request is invalid; the text has the reason.
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
    """Return tip [m], Jacobian [m/rad, m/m], compliance [m/N] and stability, computed by the paper's model.

    Raises:
        PoseError, NotFinite, NoSolution: see `Statics.solve`.
    """
    return _answer(statics, statics.solve(joints, wrench))


def _answer(statics: Statics, solution: Solution) -> dict[str, Any]:
    """Return the answer to one request."""
    return {
        "tip": solution.tip.tolist(),
        "direction": solution.rotation[:, 2].tolist(),
        "joints": list(statics.robot.joint_names),
        "jacobian": solution.jacobian[:3].tolist(),
        "compliance": solution.compliance[:3, :3].tolist(),
        "iterations": solution.iterations,
        "stability": stability(statics, solution),
    }


def stability(statics: Statics, solution: Solution) -> Stability:
    """Return the stability of a shape by the second variation of its elastic energy.

    A moment at the tip has no potential energy: a shape under a moment may be stable even if this test fails.
    """
    if statics.negative_directions(solution) == 0:
        return "stable"
    return "not known to be stable" if solution.wrench[3:].any() else "unstable"


def exact_answer(rod: ExactRod, joints: Array, wrench: Array) -> dict[str, Any]:
    """Return the tip [m] of the exact rod; its stability is not evaluated."""
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
