"""Workspace of a robot over its joint space: reach, dexterity, stiffness and margin of stability."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.errors import NoSolution
from core.model.fold import margin_of_worst_tubes
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.monitors import Margins
from station.design.inverse_kinematics import spread_poses
from station.design.task import dexterity, stiffness
from station.solve_many import solve_many

#: Number of poses between two progress reports.
BATCH_POSES = 1000
#: Edge length of the cubic cells that are counted to estimate the volume that the tip reaches [m].
CELL_SIZE_M = 0.005
#: Percentiles of each quality measure in the summary, by name [%].
PERCENTILES = {"least": 0.0, "p5": 5.0, "median": 50.0, "p95": 95.0, "most": 100.0}


@dataclass(frozen=True)
class WorkspaceStudy:
    """Result of a workspace study: the k poses for which the model has a solution, and their quality measures."""

    file: RobotFile
    force: Array  #: force at the tip (3,) in the world frame [N]
    requested: int  #: number of evaluated poses
    joints: Array  #: joint positions (k, n) [rad or m]
    tips: Array  #: tip positions (k, 3) in the world frame [m]
    dexterity: Array  #: dexterity of the tip (k,) [m/s]
    stiffness: Array  #: stiffness of the tip (k,) [N/m]
    margin: Array  #: margin of stability (k,); 1: straight and unloaded, 0: the tubes snap
    worst: Array  #: margin of the worst tubes within `Margins.uncertainty` (k,); 0: motions to this pose end in HOLD


def workspace(file: RobotFile, force: Array, count: int, seed: int, report: Callable[[float], None]) -> WorkspaceStudy:
    """Evaluate `count` poses under a force (3,) [N] on all processors; `report` receives the fraction done.

    Raises:
        ConfigError: almost no joint position is valid.
        NoSolution: no pose has a model solution under this force.

    """
    model, poses = Statics(file.robot()), spread_poses(file, count, seed)
    wrench = np.concatenate((force, np.zeros(3)))
    parts: list[tuple[Array, ...]] = []
    for first in range(0, count, BATCH_POSES):
        piece = poses[first : first + BATCH_POSES]
        found = solve_many(model, piece, np.tile(wrench, (len(piece), 1)))
        ok = found.ok
        worst = [
            margin_of_worst_tubes(model, found.at(row), piece[row], Margins().uncertainty)[1]
            for row in np.nonzero(ok)[0].tolist()
        ]
        parts.append((
            piece[ok], found.tip[ok], dexterity(found.jacobian[ok], file.limits().speed),
            stiffness(found.compliance[ok]), found.stability[ok],
            np.array(worst),
        ))  # fmt: skip
        report(min(first + BATCH_POSES, count) / count)
    joints, tips, dexterities, stiffnesses, margins, lowest = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    if len(joints) == 0:
        raise NoSolution(
            f"robot '{file.name}' has no model solution under {force.tolist()} N at any of {count} poses;"
            " reduce the force"
        )
    return WorkspaceStudy(file, force, count, joints, tips, dexterities, stiffnesses, margins, lowest)


def summary(found: WorkspaceStudy) -> dict[str, Any]:
    """Return the numbers of a workspace as a JSON object, with lengths in mm."""
    cells = np.unique(np.floor(found.tips / CELL_SIZE_M).astype(np.int64), axis=0)
    return {
        "robot": found.file.name,
        "source": found.file.source,
        "model": Statics(found.file.robot()).discretisation,
        "force_n": found.force.tolist(),
        "poses": found.requested,
        "without_shape": found.requested - len(found.joints),
        "reach_mm": {
            axis: {"least": round(1e3 * float(row.min()), 3), "most": round(1e3 * float(row.max()), 3)}
            for axis, row in zip("xyz", found.tips.T, strict=True)
        },
        "reach_cm3": round(len(cells) * CELL_SIZE_M**3 * 1e6, 3),
        "reach_cell_mm": 1e3 * CELL_SIZE_M,
        "dexterity_mm_s": _percentiles(1e3 * found.dexterity),
        "stiffness_n_m": _percentiles(found.stiffness),
        "margin": _percentiles(found.margin),
        "tube_uncertainty": Margins().uncertainty,
        "may_snap": round(float((found.worst <= 0.0).mean()), 6),
    }


def _percentiles(values: Array) -> dict[str, float]:
    return {name: float(f"{np.percentile(values, part):.5g}") for name, part in PERCENTILES.items()}
