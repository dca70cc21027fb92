"""RDT protocol: requests and records of the manual; sequence numbers that wrap, repeat and jump; the box's clock."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from station.devices.ati.protocol import (
    HISTORY_SAMPLES,
    LATENCY_S,
    Counters,
    RdtCommand,
    SampleHistory,
    Stream,
    describe,
    follow,
    is_usable,
    request,
)
from tests.fuzz.netft import fuzz

#: Example record: sequence 1, sample 6433, healthy, (1, -2, 3) N, (0.01, -0.02, 0.03) N m, 1e6 counts per unit.
WORKED = bytes.fromhex("00000001 00001921 00000000 000f4240 ffe17b80 002dc6c0 00002710 ffffb1e0 00007530")
WRAP = 2**32


def record(rdt: int, ft: int, status: int = 0, counts: tuple[int, ...] = (0,) * 6) -> bytes:
    return struct.pack(">IIIiiiiii", rdt % WRAP, ft % WRAP, status, *counts)


def run(stream: Stream, datagrams: dict[int, list[bytes]] | list[bytes], first: int = 0) -> list[int]:
    """Feed one datagram (or list of them) every 2 ms; return the counts along x of the accepted records."""
    accepted = []
    for number, datagram in enumerate(datagrams, first):
        for part in datagram if isinstance(datagram, list) else [datagram]:
            accepted += [sample.counts[0] for sample in stream.feed(part, number * 0.002)]
    return accepted


def series(numbers: range | list[int], rdt: int = 0, ft: int = 6433, step: int = 14) -> list[bytes]:
    """Return records whose force along x [counts] is the number of the record."""
    return [record(rdt + n, ft + step * n, counts=(n, 0, 0, 0, 0, 0)) for n in numbers]


def test_requests_match_the_examples_of_the_manual():
    assert request(RdtCommand.STREAM).hex(" ") == "12 34 00 02 00 00 00 00"
    assert request(RdtCommand.BIAS).hex(" ") == "12 34 00 42 00 00 00 00"
    assert request(RdtCommand.STOP).hex(" ") == "12 34 00 00 00 00 00 00"
    assert request(RdtCommand.STREAM, 10).hex(" ") == "12 34 00 02 00 00 00 0a"


@settings(deadline=None)  # there is no deadline, because the first case compiles the code
@given(
    st.lists(
        st.sampled_from(["next", "next", "next", "skip", "again", "old", "sick", "large", "two", "noise"]), max_size=60
    )
)
def test_compiled_stream_accepts_exactly_the_records_of_the_plain_one(fates):
    both, plain, limits, row = Stream(), Stream(), np.full(6, 1e6), np.zeros(7)
    rdt, now = 0, 0.0
    for fate in ["next"] * 3 + fates:
        now += 0.002
        rdt += {"skip": 3, "again": 0, "old": -2}.get(fate, 1)
        counts = (2_000_000 if fate == "large" else rdt, -rdt, 5, 6, 7, 8)
        datagram = record(rdt, 6433 + 14 * rdt, 0x80020000 if fate == "sick" else 0, counts)
        if fate == "two":
            rdt += 1
            datagram += record(rdt, 6433 + 14 * rdt)
        elif fate == "noise":
            datagram = bytes(range(36))
        expected = [(sample.time, *sample.counts) for sample in plain.feed(datagram, now)]
        if follow(*both.state, datagram, now, limits, row):
            assert fate not in ("large", "sick", "two", "noise")
            found = [tuple(row.tolist())]
        else:
            found = [(sample.time, *sample.counts) for sample in both.feed(datagram, now)]
        assert found == expected
    assert both.counters == plain.counters


@pytest.mark.parametrize("length", [0, 1, 8, 35, 37, 71])
def test_datagram_of_another_length_is_malformed(length):
    stream = Stream()

    assert stream.feed((WORKED * 2)[:length], 0.0) == []
    assert stream.counters.malformed == 1


def test_undisturbed_stream_is_accepted_from_its_third_record():
    stream = Stream()

    assert run(stream, series(range(1, 101))) == list(range(3, 101))
    assert stream.counters == Counters(accepted=98)


@pytest.mark.parametrize(("rdt", "ft"), [(WRAP - 50, 6433), (0, WRAP - 700), (WRAP - 10, WRAP - 20)])
def test_stream_accepts_wrapping_counters(rdt, ft):
    stream = Stream()

    assert run(stream, series(range(1, 201), rdt, ft)) == list(range(3, 201))
    assert stream.counters == Counters(accepted=198)


def test_gap_is_counted_and_later_records_are_accepted():
    stream = Stream()

    assert run(stream, [d if n not in (50, 51, 52) else [] for n, d in enumerate(series(range(1, 101)), 1)]) == [
        *range(3, 50),
        *range(53, 101),
    ]
    assert stream.counters == Counters(accepted=95, lost=3)


@pytest.mark.parametrize(("requested", "resets"), [(0.0, 0), (2.5, 1)])
def test_records_that_waited_at_the_start_are_no_reset_of_the_box(requested, resets):
    """The first records, measured at 0 s, are read at 3 s, and those between 0.1 s and 3 s are lost."""
    stream = Stream(requested=requested)
    for datagram in series(range(1, 51)):
        stream.feed(datagram, 3.0)
    accepted = [
        sample
        for n, datagram in enumerate(series(range(1500, 1600)))
        for sample in stream.feed(datagram, 3.0 + 0.002 * n)
    ]

    assert len(accepted) > 80
    assert stream.counters.resets == resets


def test_restart_of_the_box_is_a_reset_after_records_that_waited():
    stream = Stream(requested=0.0)
    run(stream, series(range(1, 101), ft=600_000), first=1500)
    run(stream, series(range(1, 101), ft=0), first=1600)

    assert stream.counters.resets == 1


def test_duplicate_and_late_records_are_dropped():
    stream, sent = Stream(), series(range(1, 21))
    sent[9], sent[10] = sent[10], sent[9]  # record 11 arrives before record 10
    sent.insert(15, sent[14])

    assert run(stream, sent) == [*range(3, 10), *range(11, 21)]
    assert stream.counters == Counters(accepted=17, lost=1, late=1, duplicates=1)


@pytest.mark.parametrize("bit", range(0, 64, 3))
def test_wrong_bit_in_a_counter_drops_only_its_record(bit):
    stream, sent = Stream(), series(range(1, 101))
    spoilt = bytearray(sent[49])
    spoilt[bit // 8] ^= 0x80 >> bit % 8
    sent[49] = bytes(spoilt)

    assert run(stream, sent) == [n for n in range(3, 101) if n != 50]


@pytest.mark.parametrize("bit", range(0, 64, 3))
def test_wrong_bit_in_the_first_record_does_not_affect_later_records(bit):
    stream, sent = Stream(), series(range(1, 101))
    spoilt = bytearray(sent[1])
    spoilt[bit // 8] ^= 0x80 >> bit % 8
    sent[1] = bytes(spoilt)
    samples = [sample for n, d in enumerate(sent, 1) for sample in stream.feed(d, n * 0.002)]

    assert [s.counts[0] for s in samples] == list(range(samples[0].counts[0], 101))
    assert samples[0].counts[0] <= 12
    assert all(s.time == pytest.approx(s.counts[0] * 0.002 - LATENCY_S, abs=1e-3) for s in samples)


def test_unrequested_restart_of_a_stream_is_accepted_after_ten_records():
    stream = Stream()
    run(stream, series(range(1, 501)))

    assert run(stream, series(range(501, 600), rdt=-500), 500) == list(range(510, 600))
    assert stream.counters.resyncs == 1
    assert stream.counters.resets == 0  # the sample counter continues, so the box has not been reset


def test_requested_restart_of_a_stream_is_accepted_from_its_third_record():
    stream = Stream()
    run(stream, series(range(1, 501)))
    stream.restart()

    assert run(stream, series(range(1000, 1100), rdt=-999), 999) == list(range(1002, 1100))
    assert stream.counters.resets == 0


def test_restart_of_the_box_is_detected():
    stream = Stream()
    run(stream, series(range(1, 1001), ft=5_000_000))
    stream.restart()

    assert run(stream, series(range(3000, 3100), rdt=-2999, ft=-42000), 2999) == list(range(3002, 3100))
    assert stream.counters.resets == 1


def test_record_with_a_constant_counter_is_dropped():
    stream, sent = Stream(), series(range(1, 101))
    stuck = [record(n, 6433 + 14 * 50, counts=(50, 0, 0, 0, 0, 0)) for n in range(51, 101)]

    assert run(stream, sent[:50] + stuck) == list(range(3, 51))
    assert stream.counters.implausible == 50


@pytest.mark.parametrize(("status", "usable"), [(0, True), (0x80010000, True), (0x80020000, False), (1 << 31, False)])
def test_latched_threshold_is_the_only_usable_fault_status(status, usable):
    assert is_usable(status) is usable


def test_status_bits_have_texts():
    assert describe(0) == "healthy"
    assert describe(0x80020000) == "transducer saturated or A/D"
    assert describe(0x80010004) == "monitor condition latched, temperature"
    assert describe(1 << 31) == "error summary alone"
    assert describe(1 << 15) == "bit 15"


def test_delayed_records_keep_their_measurement_times():
    stream, times = Stream(), []
    sent = series(range(1, 1001))
    for n in range(500):
        times += [s.time for s in stream.feed(sent[n], n * 0.002 + LATENCY_S)]
    for n in range(500, 1000):  # the host does not poll for a second
        times += [s.time for s in stream.feed(sent[n], 2.0)]

    # The box's clock may have drifted by 0.6 % of that second.
    assert times == pytest.approx([n * 0.002 for n in range(2, 1000)], abs=0.007)
    assert times[-1] == pytest.approx(1.998, abs=0.002)
    assert stream.counters == Counters(accepted=998)


def test_records_lost_by_the_host_are_a_gap_and_no_restart():
    stream = Stream()
    for n, datagram in enumerate(series(range(1, 301))):
        # the host does not poll until 4 s, and the socket keeps 200 records
        stream.feed(datagram, 0.002 * n if n < 100 else 4.0)
    fresh = [s for n, d in enumerate(series(range(2001, 2101))) for s in stream.feed(d, 4.0 + 0.002 * n)]

    assert len(fresh) == 100
    assert stream.counters == Counters(accepted=398, lost=1700)


def test_two_thousand_corrupted_datagrams_and_pages_are_handled():
    found = fuzz(2_000, 1)

    assert found["accepted"] > 200  # the code does not simply refuse everything
    assert (found["exceptions"], found["hangs"], found["false_accepts"]) == (0, 0, 0)


SCALE = np.array([[1.0] * 6, [0.5] * 6])


def fill(history: SampleHistory, sensor: int, times: np.ndarray) -> None:
    """Return counts that increase with time, each axis at a different rate."""
    ring = history.ring(sensor)
    for time in times:
        ring.row[:] = time, *(time * np.arange(1.0, 7.0) * 100.0)
        ring.push()


def test_sensors_are_interpolated_linearly_between_samples():
    history = SampleHistory(SCALE)
    fill(history, 0, np.arange(200) * 0.002)
    fill(history, 1, 0.0007 + np.arange(200) * 0.00186)

    for time in np.linspace(0.3, 0.36, 37):
        expected = np.outer([1.0, 0.5], time * np.arange(1.0, 7.0) * 100.0)
        assert history.at(time) == pytest.approx(expected, rel=1e-12)


def test_newest_and_oldest_sample_apply_outside_the_history():
    history = SampleHistory(SCALE)
    fill(history, 0, np.arange(1000) * 0.001)
    fill(history, 1, np.array([0.5]))

    assert history.at(5.0)[:, 0] == pytest.approx([99.9, 25.0])
    assert history.at(0.0)[:, 0] == pytest.approx([(1000 - HISTORY_SAMPLES) * 0.1, 25.0])


def test_sample_times_do_not_decrease_when_the_clock_is_corrected():
    history = SampleHistory(SCALE)
    ring = history.ring(0)
    fill(history, 1, np.array([0.0]))
    for time, counts in ((1.0, 10.0), (0.9995, 20.0), (1.01, 30.0)):
        ring.row[:] = time, *[counts] * 6
        ring.push()
        assert ring.time == max(1.0, time)

    assert history.at(1.0)[0, 0] == 20.0
    assert history.at(1.005)[0, 0] == pytest.approx(25.0)
