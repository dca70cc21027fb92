"""The protocol-level benchmark moves a connected lab and names its parts."""

from station.benchmarks.wire import wire


def test_wire_benchmark_measures_every_part_of_a_tick():
    result = wire(seconds=0.5)

    parts = ["lab", "stages poll", "tracker poll", "sensors poll", "stages command", "plant", "all"]
    assert list(result["us"]) == parts
    assert result["ticks"] == 250
    assert 0.0 < result["us"]["plant"] < result["us"]["lab"] < result["us"]["all"]
