"""Of `ctr-station bench model`: what the model costs in batches, against one at a time.

A core's solves are counted by its processor time, so that other programs take nothing from them; what all cores achieve
together, by the clock.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from core.model.many import CHUNK
from core.model.statics import Statics
from core.robot.robot import Array
from station.bench.accuracy import cases, draw, telescope
from station.experiments.side_by_side import processors
from station.solve_many import solve_many

#: Largest force of the cold rows, in any direction [N], as in `bench accuracy`.
FORCE = 0.6


def many(rows: int = 20_000, tubes: int = 5) -> dict[str, Any]:
    """Cold rows at random poses of the paper's robot, warm ones that wander; by cores; by tubes up to so many (0: not).

    `ratio`: to `solve` one at a time at some of the same rows, in the same run.
    """
    model = Statics(cases()["paper"].robot)
    cold, warm = random_rows(rows), wandering_rows(rows)
    result: dict[str, Any] = {"rows": rows}
    few = min(rows, 300)
    for name, (joints, wrenches), along in (("cold", cold, False), ("warm", warm, True)):
        some = few if name == "cold" else min(rows, 10 * few)
        solve_many(model, joints[:1], wrenches[:1], along=along, threads=1)  # compiled, or loaded
        at_once = _spent(lambda j=joints, w=wrenches, a=along: solve_many(model, j, w, along=a, threads=1), 5) / rows
        alone = _spent(lambda j=joints, w=wrenches, a=along, s=some: _one_by_one(model, j[:s], w[:s], a), 1) / some
        cores = range(1, processors() + 1)
        result[name] = {
            "per_core_and_s": round(1.0 / at_once),
            "ratio": round(alone / at_once, 1),
            "per_s_by_cores": {str(count): _on_cores(model, joints, wrenches, along, count) for count in cores},
        }
    result["warm_per_core_and_s_by_tubes"] = {str(q): _telescope(q, rows) for q in range(1, tubes + 1)}
    return result


def random_rows(rows: int, seed: int = 0) -> tuple[Array, Array]:
    """Joints (k, 3) and wrenches (k, 6) as those of `bench accuracy`: anywhere in the travel, up to `FORCE`."""
    poses = draw(cases()["paper"]._replace(force=FORCE, moment=0.0), np.random.default_rng(seed))
    joints, wrenches = zip(*(next(poses) for _ in range(rows)), strict=True)
    return np.array(joints), np.array(wrenches)


def wandering_rows(rows: int) -> tuple[Array, Array]:
    """The same about the working pose under 0.2 N along x: 10 mrad and 0.3 mm from each to the next."""
    joints = np.array([0.0, np.pi / 2, -0.1]) + _there_and_back(rows) * np.array([0.01, -0.01, 3e-4])
    return joints, np.tile([0.2, 0.0, 0.0, 0.0, 0.0, 0.0], (rows, 1))


def _there_and_back(rows: int) -> Array:
    """0 ... 50 ... 0 and so on (rows, 1)."""
    return (50.0 - np.abs(np.arange(rows) % 100 - 50.0))[:, None]


def _telescope(tubes: int, rows: int) -> int:
    """Warm solves a second and core of a robot of so many tubes."""
    model = Statics(telescope(tubes))
    joints = np.array(
        [0.3 if joint.motion == "rotation" else -0.02 * (tubes - joint.tube) for joint in model.robot.joints]
    )
    move = np.array([1e-3 if joint.motion == "rotation" else -3e-5 for joint in model.robot.joints])
    at = joints + _there_and_back(rows) * move
    load = np.tile([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], (rows, 1))
    solve_many(model, at[:2], load[:2], along=True, threads=1)
    return round(rows / _spent(lambda: solve_many(model, at, load, along=True, threads=1), 3))


def _on_cores(model: Statics, joints: Array, wrenches: Array, along: bool, cores: int) -> int:
    begin = time.perf_counter()
    solve_many(model, joints, wrenches, along=along, threads=cores)
    return round(len(joints) / (time.perf_counter() - begin))


def _one_by_one(model: Statics, joints: Array, wrenches: Array, along: bool) -> None:
    near = None
    for row in range(len(joints)):
        near = model.solve(joints[row], wrenches[row], near if along and row % CHUNK else None)


def _spent(work: Callable[[], Any], times: int) -> float:
    """Median of this thread's processor time [s]."""
    spent: list[float] = []
    for _ in range(times):
        begin = time.thread_time()
        work()
        spent.append(time.thread_time() - begin)
    return float(np.median(spent))
