"""The benchmark of the environments reports their steps under the documented names."""

from station.benchmarks.bench import VECTOR_EPISODES, gym


def test_gym_benchmark_steps_single_and_vector_environments():
    result = gym(seconds=0.05)

    assert list(result) == ["CtrReach-v0", "CtrTrack-v0"]
    for rates in result.values():
        assert list(rates) == ["single", f"{VECTOR_EPISODES} at once"]
        for rate in rates.values():
            assert rate["per_s"] > 0
            assert rate["per_core_and_s"] > 0
