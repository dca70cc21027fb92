"""What given tubes can do all over their joint space: reach, dexterity, stiffness and margin of stability."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from core.errors import NoSolution
from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.margins import Margins
from station.design.measures import dexterity, stiffness
from station.design.poses import spread_poses
from station.solve_many import solve_many

#: Poses between two words about how far it is.
PIECE = 1000
#: Side of the cells by which reached places are counted [m].
CELL = 0.005
#: Percentiles that are told of each quantity.
TOLD = {"least": 0.0, "p5": 5.0, "median": 50.0, "p95": 95.0, "most": 100.0}


@dataclass(frozen=True)
class Workspace:
    """Poses that have a shape, and what it is like."""

    file: RobotFile
    force: Array  #: (3,) at the tip, world frame [N]
    asked: int  #: poses that were tried
    joints: Array  #: (k, n) [rad or m]
    tips: Array  #: (k, 3) world frame [m]
    dexterity: Array  #: (k,) [m/s]
    stiffness: Array  #: (k,) [N/m]
    margin: Array  #: (k,) 1: straight and unloaded, 0: snaps


def workspace(file: RobotFile, force: Array, count: int, seed: int, told: Callable[[float], None]) -> Workspace:
    """Look at `count` poses under a force (3,) [N] on all processors; `told` which part is done.

    Raises:
        ConfigError: the tubes stand hardly anywhere.
        NoSolution: they have no shape under this force, anywhere.

    """
    model, poses = Statics(file.robot()), spread_poses(file, count, seed)
    wrench = np.concatenate((force, np.zeros(3)))
    parts: list[tuple[Array, ...]] = []
    for first in range(0, count, PIECE):
        piece = poses[first : first + PIECE]
        found = solve_many(model, piece, np.tile(wrench, (len(piece), 1)))
        ok = found.ok
        parts.append((
            piece[ok], found.tip[ok], dexterity(found.jacobian[ok], file.limits().speed),
            stiffness(found.compliance[ok]), found.stability[ok],
        ))  # fmt: skip
        told(min(first + PIECE, count) / count)
    joints, tips, dexterities, stiffnesses, margins = (np.concatenate(part) for part in zip(*parts, strict=True))
    if len(joints) == 0:
        raise NoSolution(
            f"robot '{file.name}' has no shape under {force.tolist()} N at any of {count} poses; less force?"
        )
    return Workspace(file, force, count, joints, tips, dexterities, stiffnesses, margins)


def summary(found: Workspace) -> dict[str, Any]:
    """The numbers of a workspace, for people in mm; ready for JSON."""
    cells = np.unique(np.floor(found.tips / CELL).astype(np.int64), axis=0)
    held = Margins().stability
    return {
        "robot": found.file.name,
        "source": found.file.source,
        "force_n": found.force.tolist(),
        "poses": found.asked,
        "without_shape": found.asked - len(found.joints),
        "reach_mm": {
            axis: {"least": round(1e3 * float(row.min()), 3), "most": round(1e3 * float(row.max()), 3)}
            for axis, row in zip("xyz", found.tips.T, strict=True)
        },
        "reach_cm3": round(len(cells) * CELL**3 * 1e6, 3),
        "reach_cell_mm": 1e3 * CELL,
        "dexterity_mm_s": _told(1e3 * found.dexterity),
        "stiffness_n_m": _told(found.stiffness),
        "margin": _told(found.margin),
        "held_below_margin": held,
        "below_it": round(float((found.margin < held).mean()), 6),
    }


def _told(values: Array) -> dict[str, float]:
    return {name: float(f"{np.percentile(values, part):.5g}") for name, part in TOLD.items()}
