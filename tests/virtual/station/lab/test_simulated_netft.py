"""The simulated Net F/T box: answers, timing, clients, and errors of the sensor."""

import struct
from itertools import pairwise

import numpy as np
import pytest

from station.lab.config import BaseSensorConfig
from station.lab.wires import MAX_PENDING_DATAGRAMS
from tests.harness.netft_bench import PERFECT, STREAM, TICK, WRENCH, Bench


def test_record_of_the_simulated_netft_box_equals_the_documented_one():
    bench = Bench(first=0.0)
    bench.box.advance(0.0, WRENCH)
    bench.request(STREAM)
    bench.box.advance(0.0, WRENCH)
    bench.box.advance(0.004, WRENCH)

    (first, *_) = bench.host.receive()
    # The record has sequence 1, a healthy status and the counts of 1 N, -2 N, 3 N, 0.01, -0.02, 0.03 N m. The counter
    # has advanced by 14 in 2 ms.
    assert first.hex(" ", 4) == "00000001 0000192f 00000000 000f4240 ffe17b80 002dc6c0 00002710 ffffb1e0 00007530"


@pytest.mark.parametrize(("requested", "step"), [(500.0, 14), (7000.0, 1), (3000.0, 2)])
def test_record_rate_of_the_netft_box_is_7000_over_a_whole_number(requested, step):
    bench = Bench(rate=requested)
    bench.request(STREAM)
    records = bench.run(1.0)

    assert len(records) == pytest.approx(7000 / step, rel=0.01, abs=1)
    assert [r[0] for r in records] == list(range(1, len(records) + 1))
    assert {b[1] - a[1] for a, b in pairwise(records)} == {step}


def test_netft_counter_continues_and_sequence_restarts_with_each_request():
    bench = Bench()
    bench.request(STREAM)
    first = bench.run(0.1)
    bench.request(STREAM)
    second = bench.run(0.1)

    assert second[0][0] == 1
    assert second[0][1] > first[-1][1]


def test_netft_box_sends_the_requested_number_of_samples_and_obeys_stop():
    bench = Bench()
    bench.request("1234000200000005")
    assert [r[0] for r in bench.run(0.1)] == [1, 2, 3, 4, 5]
    bench.request(STREAM)
    assert bench.run(0.1)
    bench.request("1234000000000000")
    assert bench.run(0.1) == []


def test_netft_bias_zeroes_the_present_reading_during_the_stream():
    bench = Bench()
    bench.request(STREAM)
    bench.run(0.1)
    bench.request("1234004200000000")
    records = bench.run(0.1)[1:]  # the first record was already in transmission

    assert all(r[3:] == (0,) * 6 for r in records)
    assert records[0][0] > 1
    assert bench.run(0.01, 2.0 * WRENCH)[-1][3:] == (1_000_000, -2_000_000, 3_000_000, 10_000, -20_000, 30_000)
    assert b"<setbias>1000000;-2000000;3000000;10000;-20000;30000</setbias>" in (bench.box.page() or b"")


def test_first_netft_record_is_on_time_and_all_records_have_the_latency():
    bench = Bench(rate=7000.0, first=0.005, latency=0.010)
    bench.request(STREAM)
    arrivals = []
    for number in range(1, 1001):
        bench.box.advance(number * 1e-4, WRENCH)
        arrivals += [(number * 1e-4, struct.unpack(">I", d[4:8])[0] - 6433) for d in bench.host.receive()]

    time, count = arrivals[0]
    assert count == 35  # 35 samples at 7000 Hz are 5 ms
    assert time == pytest.approx(0.015, abs=2e-4)
    assert all(0.010 - 1e-9 <= t - c / 7000 <= 0.0102 for t, c in arrivals)


def test_clock_error_of_the_netft_box_changes_its_record_rate():
    bench = Bench(clock_error=0.005)
    bench.request(STREAM)
    records = bench.run(2.0)

    assert (records[-1][1] - records[0][1]) == pytest.approx(7000 * 1.005 * 1.99, rel=0.005)


def test_netft_records_interpolate_a_changing_wrench():
    bench = Bench(rate=7000.0)
    bench.request(STREAM)
    for number in range(1, 101):
        bench.box.advance(number * 0.01, np.array([number * 0.01, 0, 0, 0, 0, 0]))
    records = [struct.unpack(">IIIiiiiii", d) for d in bench.host.receive()]

    assert [r[3] for r in records] == pytest.approx([(r[1] - 6433) / 7000 * 1e6 for r in records], abs=1.0)


def test_simulated_force_sensor_has_the_configured_noise_quantisation_offset_and_drift():
    bench = Bench(BaseSensorConfig())
    bench.request(STREAM)
    counts = np.array([r[3:] for r in bench.run(40.0, np.zeros(6))], dtype=float) * 1e-6

    assert counts.std(axis=0) == pytest.approx([0.02] * 3 + [0.2e-3] * 3, rel=0.05)
    assert (np.abs(counts.mean(axis=0)) <= [1.0] * 3 + [10e-3] * 3).all()
    assert np.abs(counts.mean(axis=0)).min() > 0.0
    steps = counts / ([1 / 256] * 3 + [0.05e-3] * 3)
    assert np.abs(steps - np.round(steps)).max() < 0.011  # the tolerance is the resolution of the counts on the wire
    drift = counts[-5000:].mean(axis=0) - counts[:5000].mean(axis=0)
    assert np.abs(drift[:3]) == pytest.approx([30.0 * 5e-3 / 60.0] * 3, abs=1.5e-3)


@pytest.mark.parametrize(("axis", "value", "end"), [(0, 18.5, 18_000_000), (4, -0.3, -250_000)])
def test_simulated_force_sensor_saturates_and_reports_it_beyond_its_range(axis, value, end):
    bench, wrench = Bench(), np.zeros(6)
    wrench[axis] = value
    bench.request(STREAM)
    records = bench.run(0.1, wrench)

    assert records[-1][2] == 0x80020000
    assert records[-1][3 + axis] == end
    assert bench.run(0.1, 0.5 * wrench)[-1][2] == 0


def test_gain_errors_and_cross_talk_are_linear_fractions_of_the_sensor_ranges():
    ranges = np.array([18.0, 18.0, 18.0, 0.25, 0.25, 0.25])

    def read(wrench: np.ndarray, gain: float = 0.01) -> np.ndarray:
        bench = Bench(PERFECT.model_copy(update={"gain": gain}))
        bench.request(STREAM)
        return np.array(bench.run(0.05, wrench)[-1][3:]) * 1e-6

    response = np.column_stack([(read(0.5 * r * axis) - 0.5 * r * axis) / (0.5 * r)
                                for axis, r in zip(np.eye(6), ranges, strict=True)])  # fmt: skip
    parts = response * ranges / ranges[:, None]
    assert 0.005 < np.abs(parts).max() <= 0.01 + 1e-4
    assert np.abs(parts[:3, 3:]).max() > 0.003  # by cross-talk a moment appears as a force
    assert read(WRENCH) == pytest.approx(WRENCH + response @ WRENCH, abs=5e-6)
    assert read(WRENCH, 0.0) == pytest.approx(WRENCH, abs=2e-6)


def test_number_of_unreceived_netft_records_is_bounded():
    bench = Bench(rate=7000.0)
    bench.request(STREAM)
    for _ in range(1000):
        bench.now += TICK
        bench.box.advance(bench.now, WRENCH)

    newest = [struct.unpack(">I", datagram[:4])[0] for datagram in bench.host.receive()]
    assert len(newest) == MAX_PENDING_DATAGRAMS
    assert newest == list(range(newest[-1] - MAX_PENDING_DATAGRAMS + 1, newest[-1] + 1))
