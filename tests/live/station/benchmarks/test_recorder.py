"""The recorder's benchmark records in virtual time and live."""

from station.benchmarks.recorder import recorder


def test_recorder_benchmark_records_every_row_and_reports_the_cost_per_row():
    result = recorder(1.0)

    assert result["live"]["rows"] == 500
    assert result["live"]["missed"] == 0
    assert result["channels"] > 90
    assert result["in_loop_us"] > 0.0
    assert result["live"]["us"] > 0.0
    assert 100 < result["bytes_per_row"] < 8 * result["channels"] + 100
