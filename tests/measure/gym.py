"""`python -m tests.measure gym`: steps per second of the learning environments."""

import time
from collections.abc import Callable
from typing import Any

import gymnasium
from gymnasium.utils.performance import benchmark_step, benchmark_vector_step

#: Number of parallel episodes in a vector environment.
VECTOR_EPISODES = 64


def gym(seconds: float = 5.0) -> dict[str, Any]:
    """Measure single and vector environments with random actions, a hidden load, and tube errors up to 5 %.

    `per_s` is the number of steps in a second of real time. `per_core_and_s` is the number of steps in a second of this
    process's processor time, which does not depend on other programs.
    """
    result: dict[str, Any] = {}
    for name in ("CtrReach-v0", "CtrTrack-v0"):
        known = f"station.gym:{name}"
        hidden: dict[str, Any] = {"load": 0.3, "tube_error": 0.05}
        one = gymnasium.make(known, disable_env_checker=True, **hidden)
        many = gymnasium.make_vec(known, num_envs=VECTOR_EPISODES, vectorization_mode="vector_entry_point", **hidden)
        benchmark_step(one, 0, seed=0)  # compile or load the code
        result[name] = {
            "single": _steps_per_s(lambda env=one: benchmark_step(env, seconds, seed=0)),
            f"{VECTOR_EPISODES} at once": _steps_per_s(lambda env=many: benchmark_vector_step(env, seconds, seed=0)),
        }
        one.close()
        many.close()
    return result


def _steps_per_s(measure: Callable[[], float]) -> dict[str, int]:
    start, spent_start = time.perf_counter(), time.process_time()
    per_s = measure()
    length, spent = time.perf_counter() - start, time.process_time() - spent_start
    return {"per_s": round(per_s), "per_core_and_s": round(per_s * length / spent)}
