"""The command `ik`: find poses at which the tip is at a point."""

import argparse
import json
import math
import re
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from station.cli.options import number_between, seed
from station.cli.workspace import MAX_FORCE_N
from station.config.strict import ConfigError

if TYPE_CHECKING:
    from core.control.tip_motion import Aim
    from core.model.solution import Solution
    from core.model.statics import Statics
    from station.design.inverse_kinematics import ReachingPoses

#: Largest distance of the tip from the point [mm], and its default.
MAX_TOLERANCE_MM, TOLERANCE_MM = 100.0, 0.1
#: Largest component of a position [m].
MAX_POSITION_M = 10.0
#: Largest number of printed poses; `--json` prints all.
MAX_LINES = 10


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `ik` to the parser."""
    ik = commands.add_parser("ik", help="find the joint positions at which the tip is at a point")
    ik.add_argument("robot", metavar="ROBOT", help="preset or .toml file")
    ik.add_argument("--tip", nargs="+", required=True, metavar="X Y Z", help="point of the tip, world frame [m]")
    ik.add_argument("--direction", nargs="+", metavar="X Y Z", help="direction of the tip's axis (default: any)")
    ik.add_argument("--force", nargs="+", metavar="X Y Z", help="force at the tip, world frame [N] (default: 0 0 0)")
    ik.add_argument(
        "--tolerance", type=number_between(1e-4, MAX_TOLERANCE_MM, "a distance", "mm"), default=TOLERANCE_MM,
        metavar="MM", help=f"largest distance of the tip from the point [mm] (default: {TOLERANCE_MM:g})",
    )  # fmt: skip
    ik.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of the start poses (default: 0)")
    ik.add_argument("--json", action="store_true", help="print one JSON object instead of text")
    ik.set_defaults(command=_ik)


def _ik(parsed: argparse.Namespace) -> int:
    import numpy as np

    from core.control.tip_motion import Aim
    from core.model.statics import Statics
    from station.config.robots import load_robot
    from station.design.inverse_kinematics import reaching_poses

    file, direction = load_robot(parsed.robot), None
    force = np.zeros(3) if parsed.force is None else np.array(_three(parsed.force, "--force", "N", MAX_FORCE_N))
    if parsed.direction is not None:
        direction = np.array(_three(parsed.direction, "--direction", "", math.inf))
        if not (length := float(np.linalg.norm(direction))) > 0.0:
            raise ConfigError("--direction 0 0 0 is not a direction; give a vector that is not zero")
        direction /= length
    point = np.array(_three(parsed.tip, "--tip", "m", MAX_POSITION_M))
    aim = Aim(point, 1e-3 * parsed.tolerance, np.append(force, np.zeros(3)), direction)
    found, model = reaching_poses(file, aim, parsed.seed), Statics(file.robot())
    if parsed.json:
        numbers = {
            "solutions": [_numbers(model, aim, at) for at in found.poses],
            "nearest": _numbers(model, aim, found.nearest) | {"why": found.why},
        }
        sys.stdout.write(f"{json.dumps(numbers)}\n")
    else:
        sys.stdout.writelines(f"{line}\n" for line in _lines(model, aim, found))
    return 0 if found.poses else 1


def _three(texts: list[str], option: str, unit: str, largest: float) -> list[float]:
    """Return the three numbers of an option, which spaces or commas separate."""
    try:
        numbers = [float(part) for text in texts for part in re.split(r"[,\s]+", text.strip())]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) and abs(number) <= largest for number in numbers):
        between = f" from {-largest:g} to {largest:g} {unit}" if math.isfinite(largest) else ""
        raise ConfigError(f"{option} {' '.join(texts)}: expected three numbers X Y Z{between}")
    return numbers


def _numbers(model: "Statics", aim: "Aim", at: "Solution") -> dict[str, Any]:
    away, angle = aim.errors(at)
    return {
        "joints": dict(zip(model.robot.joint_names, at.joints.tolist(), strict=True)),
        "tip": at.tip.tolist(),
        "direction": at.rotation[:, 2].tolist(),
        "distance": math.hypot(*away.tolist()),
        "angle": angle,
        "stability": at.stability,
    }


def _lines(model: "Statics", aim: "Aim", found: "ReachingPoses") -> Iterator[str]:
    """Yield the lines of the result: one pose per line, then notes about the poses."""
    for at in found.poses[:MAX_LINES] or (found.nearest,):
        joints = ", ".join(
            f"{joint.name} {value:.6g} {joint.unit}"
            for joint, value in zip(model.robot.joints, at.joints.tolist(), strict=True)
        )
        away, angle = aim.errors(at)
        error = f"{1e3 * math.hypot(*away.tolist()):.3g} mm"
        if aim.direction is not None:
            error += f" and {math.degrees(angle):.3g} deg"
        yield f"{joints}: {error} from the aim, stability margin {at.stability:.3g}"
    if not found.poses:
        yield f"No pose within the limits reaches the point; the pose above is the nearest one found ({found.why})."
    elif len(found.poses) == 1:
        yield "One pose was found; the search starts from many poses, but does not prove that there is no other."
    else:
        yield (
            f"{len(found.poses)} different poses were found, the most stable first. With more joints than needed, they"
            " are examples of a continuum."
            if len(model.robot.joints) > (3 if aim.direction is None else 5)
            else f"{len(found.poses)} different poses were found, the most stable first."
        )
    if found.retracted:
        yield "In these poses the innermost tube ends inside another tube: the tip is its end."
