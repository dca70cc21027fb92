"""The wire-level bench moves a connected lab and names its parts."""

from station.bench.wire import wire


def test_every_part_of_the_tick_is_measured():
    result = wire(seconds=0.5)

    parts = ["lab", "stages poll", "tracker poll", "sensors poll", "stages command", "plant", "all"]
    assert list(result["us"]) == parts
    assert result["ticks"] == 250
    assert 0.0 < result["us"]["plant"] < result["us"]["lab"] < result["us"]["all"]
