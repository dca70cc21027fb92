"""Part of `ctr-station bench`: computing speed of the model, a tick, a simulated run and the learning environments.

The rate of one core is the number of solves or steps in a second of processor time, which does not depend on other
programs. The rate of several cores is the number in a second of real time.
"""

import contextlib
import math
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from types import FrameType
from typing import Any, cast

import numpy as np
from rich.table import Table

import core.control.step as control_step
from core.model.batch import CHUNK_ROWS
from core.model.cosserat import ExactRod
from core.model.statics import Solution, Statics
from core.robot.robot import Array
from station.benchmarks.accuracy import cases, draw, telescope
from station.config.controllers import PERIOD_S
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.control import loop
from station.control.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.job_pool import JobPool, processors
from station.experiments.runner import run_case
from station.solve_many import solve_many

#: Processor time between two samples of the running function [s].
SAMPLE_S = 1e-3


def model(solves: int = 20_000, tubes: int = 5) -> dict[str, Any]:
    """Measure warm-started solves while the joints move around (0, pi/2, -0.100) under 0.2 N along x.

    The timed part solves the model and reads tip, J and C. Between two solves the joints move by 10 mrad and 0.3 mm,
    within +-0.5 rad and +-15 mm. `accuracy_mm` is the distance of the tip from that of the exact rod. `residual` is
    computed separately after the solve. For `derivative_error` the model is solved again from the solution; the error
    is the difference of both J and C, relative to the largest entry. The result also has the same numbers for the
    fourth-order integrator, the time of a pass along the tubes with and without derivatives, and the speed of the
    model in batches for 1 to `tubes` tubes.
    """
    robot = load_robot("paper").robot()
    result = _wander(Statics(robot), solves)
    result["state_only_us"], result["pass_us"], sublinks = _passes(Statics(robot))
    result["sublinks"] = sublinks
    result["per_sublink_us"] = {
        "state": round(result["state_only_us"] / sublinks, 4),
        "derivatives": round((result["pass_us"] - result["state_only_us"]) / sublinks, 4),
    }
    result["fourth_order"] = _wander(Statics(robot, integrator="fourth_order"), solves)
    result["many"] = many(solves, tubes)
    return result


def _wander(statics: Statics, solves: int) -> dict[str, Any]:
    exact = ExactRod(statics.robot)
    wrench = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
    centre, reach, stride = (
        np.array([0.0, math.pi / 2, -0.1]),
        np.array([0.5, 0.5, 0.015]),
        np.array([0.01, 0.01, 3e-4]),
    )
    joints, direction = centre.copy(), np.array([1.0, -1.0, 1.0])
    rng = np.random.default_rng(0)
    near: Solution = statics.solve(joints, wrench)
    times, passes, checked = np.empty(solves), np.empty(solves), list[tuple[float, float, float]]()
    for index in range(solves):
        # A joint reverses at the border of its range, and sometimes in between, so that the poses differ.
        direction = np.where(np.abs(joints + direction * stride - centre) > reach, -direction, direction)
        direction = np.where(rng.random(3) < 0.01, -direction, direction)
        direction = np.where(np.abs(joints + direction * stride - centre) > reach, -direction, direction)
        joints = joints + direction * stride
        start = time.perf_counter()
        near = statics.solve(joints, wrench, near)
        tip, jacobian, compliance = near.tip, near.jacobian, near.compliance
        times[index], passes[index] = time.perf_counter() - start, near.iterations
        if index % max(1, solves // 200) == 0:
            again = statics.solve(joints, wrench, near)
            differences = [
                float(np.abs(found - better).max() / np.abs(better).max())
                for found, better in (
                    (jacobian[:3], again.jacobian[:3]),
                    (compliance[:3, :3], again.compliance[:3, :3]),
                )
            ]
            error = float(np.linalg.norm(tip - exact.solve(joints, wrench).tip))
            checked.append((error, statics.residual(near), max(differences)))
    errors, residuals, derivative_errors = zip(*checked, strict=True)
    return {
        "solves": solves,
        "solve_us": {"median": _microseconds(np.median(times)), "p99": _microseconds(np.percentile(times, 99))},
        "passes": round(float(passes.mean()), 3),
        "accuracy_mm": {"mean": round(1e3 * float(np.mean(errors)), 5), "max": round(1e3 * max(errors), 5)},
        "residual": float(f"{max(residuals):.2g}"),
        "derivative_error": float(f"{max(derivative_errors):.2g}"),
    }


def _passes(statics: Statics) -> tuple[float, float, int]:
    """Return the median times of a pass without and with derivatives [us], and the number of sub-links."""
    solution = statics.solve(np.array([0.0, math.pi / 2, -0.1]), np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
    durations: list[float] = []
    for with_derivatives in (False, True):
        times = np.empty(100)
        for index in range(times.size):
            start = time.perf_counter()
            statics.repeat_pass(solution, 100, with_derivatives)
            times[index] = (time.perf_counter() - start) / 100
        durations.append(_microseconds(np.median(times[3:])))
    return durations[0], durations[1], statics.shape(solution).shape[0] - 1


def headless(seconds: float = 20.0) -> dict[str, Any]:
    """Measure the speed of the case `feedforward` of `fig10` in virtual time: one run, then one on each processor."""
    _headless(2.0, lambda _: None)
    alone = sorted(_headless(seconds, lambda _: None) for _ in range(3))
    shares = share_by_folder(lambda: _headless(seconds, lambda _: None))
    tick_us = 1e6 * PERIOD_S / alone[1]
    count = processors()
    with JobPool(count) as started:
        for duration in (2.0, seconds):
            parallel = started.carry_out(_headless, [duration] * count, lambda _: None)
    return {
        "times_real_time": round(alone[1], 2), "min": round(alone[0], 2), "max": round(alone[2], 2),
        "tick_us": {folder: round(share * tick_us, 1) for folder, share in shares.items()},
        "side_by_side": {"processes": count, "times_real_time": round(sum(parallel), 2)},
    }  # fmt: skip


def share_by_folder(work: Callable[[], object]) -> dict[str, float]:
    """Carry out `work` and return the shares of its processor time by folder of the project, the largest first.

    Compiled code and libraries count for the function that calls them.
    """
    counts = Counter[str]()

    def sample(_: int, frame: FrameType | None) -> None:
        while frame is not None:
            package, *rest = frame.f_globals.get("__name__", "").split(".")
            if package in ("core", "station") and rest:
                counts[f"{package}/{rest[0]}"] += 1
                return
            frame = frame.f_back

    before = signal.signal(signal.SIGPROF, sample)
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_S, SAMPLE_S)
    try:
        work()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    return {folder: count / counts.total() for folder, count in counts.most_common()}


def _headless(duration: float, _: Callable[[float], None]) -> float:
    """Run the case for `duration` [s] and return its speed relative to real time."""
    case = next(case for case in load_experiment("fig10").cases if case.name == "feedforward")
    file = case.file.model_copy(update={"duration": duration})
    run = run_case(case._replace(file=file), 0, VirtualClock(), lambda _: None)
    return run.simulated_s / run.wall_s


def table(title: str, result: Mapping[str, Any]) -> Table:
    """Return the result of a benchmark as a table for the terminal."""
    shown = Table(title=f"bench {title}", title_style="")
    shown.add_column("figure")
    shown.add_column("value", justify="right")
    for figure, value in flat(result):
        shown.add_row(figure, f"{value}")
    return shown


def flat(result: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names and values of a nested result; the name of an inner value starts with the names around it."""
    for key, value in result.items():
        if isinstance(value, Mapping):
            yield from flat(cast(Mapping[str, Any], value), f"{before}{key} ")
        else:
            yield f"{before}{key}", value


def _microseconds(seconds: Any) -> float:
    return round(1e6 * float(seconds), 2)


#: Largest force at the tip in the rows without a warm start, in any direction [N]; equal to that of `bench accuracy`.
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
    """Return random joints (k, 3) in the whole travel and wrenches (k, 6), drawn as in `bench accuracy`."""
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


#: Timed cases, by result: three joints; six joints: position only, with direction, and with null-space objectives.
TICK_CASES = {
    "step_us": ("fig10", "feedforward"),
    "six_joints_step_us": ("points", "position_alone"),
    "six_joints_pointing_step_us": ("points", "pointing_alone"),
    "six_joints_spare_step_us": ("points", "pointing"),
}


def tick(seconds: float = 20.0) -> dict[str, Any]:
    """Run each of `TICK_CASES` for `seconds` after a warm-up; return the times of a tick [us].

    In a tick the controller fuses and filters the forces, observes the tip, solves the model twice, and computes and
    limits the joint velocities. Between two ticks the virtual lab and the telemetry run, so they displace data from the
    processor's cache, as the drivers and the telemetry of a real rig do.
    """
    found: dict[str, Any] = {"ticks": round(seconds * 500)}
    for key, (experiment, name) in TICK_CASES.items():
        found[key] = _tick(next(case for case in load_experiment(experiment).cases if case.name == name), seconds)
    return found


@contextlib.contextmanager
def timed_steps() -> Iterator[list[float]]:
    """Collect the duration of each step of the controller [s], in this process."""
    taken: list[float] = []

    def timed(*arguments: Any) -> control_step.Tick:
        start = time.perf_counter()
        result = control_step.step(*arguments)
        taken.append(time.perf_counter() - start)
        return result

    loop.step = timed
    try:
        yield taken
    finally:
        loop.step = control_step.step


def _tick(case: Case, seconds: float) -> dict[str, float]:
    with timed_steps() as taken:
        for duration in (2.0, seconds):
            taken.clear()
            file = case.file.model_copy(update={"duration": duration})
            run_case(case._replace(file=file), 0, VirtualClock(), lambda _: None)
    # Only ticks of the motion count: during its preparation the controller does not compute the inverse kinematics.
    moving = 1e6 * np.array(taken[-int(seconds * 500) :])
    part = np.percentile(moving, [50, 99, 99.9])
    return dict(zip(("median", "p99", "p99_9"), np.round(part, 1).tolist(), strict=True))


#: Number of parallel episodes in a vector environment.
VECTOR_EPISODES = 64


def gym(seconds: float = 5.0) -> dict[str, Any]:
    """Measure single and vector environments with random actions, a hidden load, and tube errors up to 5 %.

    `per_s` is the number of steps in a second of real time. `per_core_and_s` is the number of steps in a second of this
    process's processor time, which does not depend on other programs.

    Raises:
        ConfigError: Gymnasium is not installed.
    """
    try:
        import gymnasium
        from gymnasium.utils.performance import benchmark_step, benchmark_vector_step
    except ImportError:
        raise ConfigError("bench gym needs Gymnasium: pip install 'ctr-station[gym]'") from None
    result: dict[str, Any] = {}
    for name in ("CtrReach-v0", "CtrTrack-v0"):
        known = f"station.gym:{name}"
        hidden: dict[str, Any] = {"load": 0.3, "tube_error": 0.05}
        one = gymnasium.make(known, disable_env_checker=True, **hidden)
        many = gymnasium.make_vec(known, num_envs=VECTOR_EPISODES, vectorization_mode="vector_entry_point", **hidden)
        benchmark_step(one, 0, seed=0)  # compile or load the code
        result[name] = {
            "single": _steps_per_s(lambda env=one: benchmark_step(env, seconds, seed=0)),  # pyright: ignore
            f"{VECTOR_EPISODES} at once": _steps_per_s(lambda env=many: benchmark_vector_step(env, seconds, seed=0)),  # pyright: ignore
        }
        one.close()
        many.close()
    return result


def _steps_per_s(measure: Callable[[], float]) -> dict[str, int]:
    start, spent_start = time.perf_counter(), time.process_time()
    per_s = measure()
    length, spent = time.perf_counter() - start, time.process_time() - spent_start
    return {"per_s": round(per_s), "per_core_and_s": round(per_s * length / spent)}
