"""`python -m tests.measure batch`: speed of the model in batches of many poses."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from core.model.batch import CHUNK_ROWS
from core.model.statics import Statics
from core.robot.robot import Array
from station.jobs.processes import processors
from station.solve_many import solve_many
from tests.measure.accuracy import cases, draw, telescope

#: Largest force at the tip in the rows without a warm start, in any direction [N]; equal to that of `accuracy`.
MAX_RANDOM_FORCE_N = 0.6


def many(rows: int = 20_000, tubes: int = 5) -> dict[str, Any]:
    """Measure cold solves at random poses and warm solves along a path; by cores, and for 1 to `tubes` tubes.

    `ratio` is the speed of a batch relative to single calls of `solve` at some of the same rows. With `tubes` 0 the
    measurement by tubes is omitted. The rate of one core is the number of solves in a second of processor time, which
    does not depend on other programs. The rate of several cores is the number of solves in a second of real time.
    """
    model = Statics(cases()["paper"].robot)
    cold, warm = random_rows(rows), wandering_rows(rows)
    result: dict[str, Any] = {"rows": rows}
    base_rows = min(rows, 300)
    for name, (joints, wrenches), along in (("cold", cold, False), ("warm", warm, True)):
        some = base_rows if name == "cold" else min(rows, 10 * base_rows)
        solve_many(model, joints[:1], wrenches[:1], along=along, threads=1)  # compile or load the code
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
    """Return random joints (k, 3) in the whole travel and wrenches (k, 6), drawn as in `accuracy`."""
    poses = draw(cases()["paper"]._replace(force=MAX_RANDOM_FORCE_N, moment=0.0), np.random.default_rng(seed))
    joints, wrenches = zip(*(next(poses) for _ in range(rows)), strict=True)
    return np.array(joints), np.array(wrenches)


def wandering_rows(rows: int) -> tuple[Array, Array]:
    """Return joints and wrenches around the working pose under 0.2 N along x, with steps of 10 mrad and 0.3 mm."""
    joints = np.array([0.0, np.pi / 2, -0.1]) + _there_and_back(rows) * np.array([0.01, -0.01, 3e-4])
    return joints, np.tile([0.2, 0.0, 0.0, 0.0, 0.0, 0.0], (rows, 1))


def _there_and_back(rows: int) -> Array:
    """Return the periodic sequence 0 ... 50 ... 0 (rows, 1)."""
    return (50.0 - np.abs(np.arange(rows) % 100 - 50.0))[:, None]


def _telescope(tubes: int, rows: int) -> int:
    """Return the number of warm solves in a second of processor time for a robot with `tubes` tubes."""
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
    start = time.perf_counter()
    solve_many(model, joints, wrenches, along=along, threads=cores)
    return round(len(joints) / (time.perf_counter() - start))


def _one_by_one(model: Statics, joints: Array, wrenches: Array, along: bool) -> None:
    near = None
    for row in range(len(joints)):
        near = model.solve(joints[row], wrenches[row], near if along and row % CHUNK_ROWS else None)


def _spent(work: Callable[[], Any], times: int) -> float:
    """Call `work` several times, and return the median of the processor time that this thread needed for a call [s]."""
    spent: list[float] = []
    for _ in range(times):
        start = time.thread_time()
        work()
        spent.append(time.thread_time() - start)
    return float(np.median(spent))
