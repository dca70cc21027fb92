"""The bench of the environments reports their steps under the documented names."""

from station.bench.gym import ROWS, gym


def test_both_environments_are_stepped_alone_and_many_at_once():
    result = gym(seconds=0.05)

    assert list(result) == ["CtrReach-v0", "CtrTrack-v0"]
    for rates in result.values():
        assert list(rates) == ["single", f"{ROWS} at once"]
        for rate in rates.values():
            assert rate["per_s"] > 0
            assert rate["per_core_and_s"] > 0
