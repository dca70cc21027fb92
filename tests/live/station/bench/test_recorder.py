"""The recorder's bench really records, both ways."""

from station.bench.recorder import recorder


def test_the_bench_records_every_row_and_tells_what_a_row_costs():
    result = recorder(1.0)

    assert result["live"]["rows"] == 500
    assert result["live"]["missed"] == 0
    assert result["channels"] > 90
    assert result["in_loop_us"] > 0.0
    assert result["live"]["us"] > 0.0
    assert 100 < result["bytes_per_row"] < 8 * result["channels"] + 100
