"""`ctr-station solve`: read joints and load as JSON lines, and write the model's solutions as JSON lines."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np

from core.errors import CtrError
from core.model.cosserat import ExactRod, Loads
from core.model.solution import Solution
from core.model.statics import Integrator, Statics
from core.robot.limits import JointLimit
from core.robot.robot import Array, Robot
from station.config.strict import ConfigError

Stability = Literal["stable", "unstable", "not known to be stable"]

#: Largest part of the input that is read ahead [bytes], and smallest number of lines that are solved together.
MAX_READ_AHEAD_BYTES, MIN_BATCH_LINES = 1 << 20, 8
#: Keys of an input line.
KEYS = ("joints", "force", "moment", "follow", "contact", "loads", "gravity", "distributed")


class Request(NamedTuple):
    """One line of the input."""

    joints: Array  #: (n,) [rad, m]
    wrench: Array  #: (6,) force and moment at the tip [N, N m]
    follow: bool = False  #: whether the solution starts from the shape of the last solved line
    contact: float | None = None  #: arc length at which the force acts [m]; None: at the tip
    loads: Loads | None = None  #: further loads, which only the exact rod supports


def batched_lines(source: BinaryIO) -> Iterator[list[str]]:
    """Yield the available input lines in batches; wait only for the first line of a batch."""
    rest = b""
    while piece := source.read1(MAX_READ_AHEAD_BYTES):  # pyright: ignore[reportAttributeAccessIssue] - a buffered reader's
        *lines, rest = (rest + piece).split(b"\n")
        yield [line.decode(errors="replace") for line in lines]
    yield [rest.decode(errors="replace")]


def solve_lines(
    batches: Iterable[Sequence[str]],
    robot: Robot,
    sublink: float | None = None,
    integrator: Integrator | None = None,
    exact: bool = False,
    limits: Sequence[JointLimit] = (),
) -> Iterator[str]:
    """Yield the answer to each line; a line that cannot be answered gets {"error": ...}.

    The lines of a batch are solved together; the answers are the same as for separate lines. An answer has `warnings`
    where a joint is beyond its travel in `limits`, or a tube is strained beyond what its material recovers from.
    """
    statics, rod, last = Statics(robot, sublink, integrator), ExactRod(robot), _Last()
    for lines in batches:
        requests = [_request(line, robot) for line in lines if line.strip()]
        valid = [request for request in requests if not isinstance(request, CtrError)]
        answers = iter(_exact_answers(rod, valid) if exact else _model_answers(statics, rod, valid, limits, last))
        for request in requests:
            answer = request if isinstance(request, CtrError) else next(answers)
            yield json.dumps({"error": str(answer)} if isinstance(answer, CtrError) else answer)


class _Last:
    """The last shape of the model, which a line with `follow` starts from."""

    solution: Solution | None = None


def _request(line: str, robot: Robot) -> Request | CtrError:
    try:
        return parse(line, robot)
    except CtrError as error:
        return error


def _exact_answers(rod: ExactRod, requests: Iterable[Request]) -> Iterator[dict[str, Any] | CtrError]:
    for request in requests:
        try:
            yield exact_answer(rod, request)
        except CtrError as error:
            yield error


def _model_answers(
    statics: Statics, rod: ExactRod, requests: Sequence[Request], limits: Sequence[JointLimit], last: _Last
) -> Iterator[dict[str, Any] | CtrError]:
    if len(requests) >= MIN_BATCH_LINES and not any(any(map(_is_set, request[2:])) for request in requests):
        from station.solve_many import solve_many  # local import: a single line does not need this module

        joint_rows, wrench_rows = (np.array(rows) for rows in list(zip(*requests, strict=True))[:2])
        together = solve_many(statics, joint_rows, wrench_rows)
    else:
        together = None
    for row, request in enumerate(requests):
        warnings = [*_beyond_travel(request.joints, limits)]
        try:
            if request.loads is not None:
                answer = exact_answer(rod, request)
            else:
                near = last.solution if request.follow else None
                found = together.at(row) if together else statics.solve(*request[:2], near, request.contact)
                last.solution = found
                warnings += _strained(statics, found)
                answer = _answer(statics, found)
        except CtrError as error:
            yield error
            continue
        yield answer | ({"warnings": warnings} if warnings else {})


def _is_set(value: object) -> bool:
    return value is not None and value is not False


def _beyond_travel(joints: Array, limits: Sequence[JointLimit]) -> Iterator[str]:
    for limit, value in zip(limits, joints.tolist(), strict=False):
        if not limit.lower <= value <= limit.upper:
            yield (
                f"{limit.name} {value:g} {limit.unit} is outside {limit.lower:g} ... {limit.upper:g} {limit.unit}"
                " (its travel)"
            )


def _strained(statics: Statics, solution: Solution) -> Iterator[str]:
    for tube, strain in zip(statics.robot.tubes, statics.strains(solution).tolist(), strict=True):
        if strain > tube.max_strain:
            yield (
                f"tube '{tube.name}' is strained by {100.0 * strain:.2g} %, but its material recovers from at most"
                f" {100.0 * tube.max_strain:g} % (max_strain): check curvature, diameter, load and max_strain"
            )


def parse(line: str, robot: Robot) -> Request:
    """Return the request of a line.

    Raises:
        ConfigError: the request is invalid; the text has the reason.
    """
    try:
        request = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"not JSON: {error}") from None
    if not isinstance(request, dict):
        raise ConfigError(f"expected an object with 'joints' and 'force', not {type(request).__name__}")
    if unknown := [key for key in request if key not in KEYS]:
        raise ConfigError(f"unknown key '{unknown[0]}'; known are {', '.join(KEYS)}")
    if not isinstance(follow := request.get("follow", False), bool):
        raise ConfigError(f"follow = {follow!r}: expected true or false")
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
    contact = None if request.get("contact") is None else _number("contact", request["contact"])
    return Request(np.array(joints), np.array(wrench), follow, contact, _loads(request, robot))


def _loads(request: Mapping[str, Any], robot: Robot) -> Loads | None:
    """Return the loads of the keys `loads`, `gravity` and `distributed`; None without these keys."""
    if not any(key in request for key in ("loads", "gravity", "distributed")):
        return None
    given, points = request.get("loads", []), list[tuple[float, Array]]()
    if not isinstance(given, list):
        raise ConfigError(f"loads = {given!r}: expected a list of objects with 'at' and 'force'")
    for number, one in enumerate(given):
        if not isinstance(one, Mapping) or set(one) != {"at", "force"}:
            raise ConfigError(f"loads[{number}] = {one!r}: expected an object with 'at' [m] and 'force' [N]")
        force = np.array(_three(f"loads[{number}].force", one["force"]))
        points.append((_number(f"loads[{number}].at", one["at"]), force))
    weights = None
    if request.get("gravity") is not None:
        down = np.array(_three("gravity", request["gravity"]))
        own = np.array([tube.weight for tube in robot.tubes])
        if not (length := float(np.linalg.norm(down))) > 0.0:
            raise ConfigError("gravity = [0, 0, 0]: expected the direction in which the weight acts")
        if not own.all():
            raise ConfigError("gravity: a tube of the robot has no weight; add its density to the robot's file")
        weights = np.outer(own, down / length)
    return Loads(points, weights, np.array(_three("distributed", request.get("distributed", (0, 0, 0)))))


def model_answer(statics: Statics, joints: Array, wrench: Array) -> dict[str, Any]:
    """Return tip [m], Jacobian [m/rad, m/m], compliance [m/N], stability, and the model's integrator.

    Raises:
        PoseError, NotFinite, NoSolution: see `Statics.solve`.
    """
    return _answer(statics, statics.solve(joints, wrench))


def _answer(statics: Statics, solution: Solution) -> dict[str, Any]:
    """Return the answer to one request."""
    shape = statics.shape(solution)
    rows = [int(np.abs(shape[:, 0] - end).argmin()) for end in statics.robot.tube_ends(solution.joints)]
    return {
        "tip": solution.tip.tolist(),
        "direction": solution.rotation[:, 2].tolist(),
        "ends": {tube.name: shape[row, 10:13].tolist() for tube, row in zip(statics.robot.tubes, rows, strict=True)},
        "joints": list(statics.robot.joint_names),
        "jacobian": solution.jacobian[:3].tolist(),
        "compliance": solution.compliance[:3, :3].tolist(),
        "iterations": solution.iterations,
        "stability": stability(statics, solution),
        "integrator": statics.used_integrator,
        "sublink": statics.step,
    }


def stability(statics: Statics, solution: Solution) -> Stability:
    """Return the stability of a shape by the second variation of its elastic energy.

    A moment at the tip has no potential energy: a shape under a moment may be stable even if this test fails.
    """
    if statics.negative_directions(solution) == 0:
        return "stable"
    return "not known to be stable" if solution.wrench[3:].any() else "unstable"


def exact_answer(rod: ExactRod, request: Request) -> dict[str, Any]:
    """Return tip [m], direction, Jacobian and compliance of the exact rod; its stability is not evaluated."""
    if request.follow:
        raise ConfigError("follow: not possible with the exact rod, which solves every line from rest")
    solution = rod.solve(request.joints, request.wrench, None, request.contact, request.loads)
    unknown: Stability = "not known to be stable"
    slopes, n = rod.derivatives(request.joints, request.wrench, solution, *request[3:]), request.joints.size
    return {
        "tip": solution.tip.tolist(), "direction": solution.rotation[:, 2].tolist(),
        "joints": list(rod.robot.joint_names), "jacobian": slopes[:3, :n].tolist(),
        "compliance": slopes[:3, n : n + 3].tolist(), "iterations": solution.iterations, "stability": unknown,
        "integrator": "exact rod",
    }  # fmt: skip


def _three(what: str, value: Any) -> list[float]:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise ConfigError(f"{what} = {value!r}: expected three numbers")
    return [_number(f"{what}[{index}]", part) for index, part in enumerate(value)]


def _number(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= 1e9:
        raise ConfigError(f"{what} = {value!r}: expected a number between -1e9 and 1e9")
    return float(value)
