"""The simulated Net F/T box: what it answers, when, to whom; its sensor's imperfections; its faults; its network."""

import socket
import struct
import threading
import time
from collections.abc import Iterator
from itertools import pairwise

import httpx
import numpy as np
import pytest

from station.devices.netft import LATENCY
from station.devices.netft_page import read_page
from station.devices.netft_sensors import BoxAddress, NetftSensors, Quality, SensorError, connect
from station.lab.config import BaseSensorConfig
from station.lab.netft_wire import MOST_WAITING, AddressTaken, MemoryDatagrams, MemoryEnd, PageServer, UdpEnd, respond
from station.lab.simulated_netft import BoxSettings, SimulatedNetft

PERFECT = BaseSensorConfig(
    force_noise=0.0, moment_noise=0.0, force_count=0.0, moment_count=0.0, drift=0.0, force_offset=0.0, moment_offset=0.0
)
WRENCH = np.array([1.0, -2.0, 3.0, 0.01, -0.02, 0.03])
STREAM = "1234000200000000"
TICK = 0.002


class Bench:
    """A box on a wire in memory, and a host that writes hexadecimal."""

    def __init__(self, config: BaseSensorConfig = PERFECT, seed: int = 1, **settings: object) -> None:
        self.end = MemoryEnd()
        self.host = self.end.link("host")
        self.box = SimulatedNetft(self.end, config, np.random.default_rng(seed), BoxSettings(**settings))
        self.now = 0.0

    def ask(self, request: str, host: MemoryDatagrams | None = None) -> None:
        (host or self.host).send(bytes.fromhex(request))

    def run(self, time: float, wrench: np.ndarray = WRENCH) -> list[tuple[int, ...]]:
        """Records that the host gets in `time` [s]."""
        datagrams = []
        for _ in range(round(time / TICK)):
            self.now += TICK
            self.box.advance(self.now, wrench)
            datagrams += self.host.receive()
        return [fields for datagram in datagrams for fields in struct.iter_unpack(">IIIiiiiii", datagram)]


def test_a_record_is_the_worked_one():
    bench = Bench(first=0.0)
    bench.box.advance(0.0, WRENCH)
    bench.ask(STREAM)
    bench.box.advance(0.0, WRENCH)
    bench.box.advance(0.004, WRENCH)

    (first, *_) = bench.host.receive()
    # Sequence 1, healthy, the counts of 1 N, -2 N, 3 N, 0.01, -0.02, 0.03 N m; the counter has moved on by 14 in 2 ms.
    assert first.hex(" ", 4) == "00000001 0000192f 00000000 000f4240 ffe17b80 002dc6c0 00002710 ffffb1e0 00007530"


@pytest.mark.parametrize(("asked", "step"), [(500.0, 14), (1000.0, 7), (7000.0, 1), (3000.0, 2), (50.0, 140)])
def test_the_rate_is_7000_over_a_whole_number(asked, step):
    bench = Bench(rate=asked)
    bench.ask(STREAM)
    records = bench.run(1.0)

    assert len(records) == pytest.approx(7000 / step, rel=0.01, abs=1)
    assert [r[0] for r in records] == list(range(1, len(records) + 1))
    assert {b[1] - a[1] for a, b in pairwise(records)} == {step}


def test_the_internal_counter_goes_on_and_the_sequence_begins_anew_with_each_request():
    bench = Bench()
    bench.ask(STREAM)
    first = bench.run(0.1)
    bench.ask(STREAM)
    second = bench.run(0.1)

    assert second[0][0] == 1
    assert second[0][1] > first[-1][1]


def test_a_count_of_samples_is_kept_and_a_stop_obeyed():
    bench = Bench()
    bench.ask("1234000200000005")
    assert [r[0] for r in bench.run(0.1)] == [1, 2, 3, 4, 5]
    bench.ask(STREAM)
    assert bench.run(0.1)
    bench.ask("1234000000000000")
    assert bench.run(0.1) == []


def test_only_the_latest_that_asked_is_served():
    bench = Bench()
    other = bench.end.link("other")
    bench.ask(STREAM)
    assert bench.run(0.1)
    bench.ask(STREAM, other)
    assert bench.run(0.1) == []
    assert other.receive()


def test_a_long_request_names_the_host_to_serve():
    bench = Bench()
    elsewhere = bench.end.link("10.0.0.7")
    bench.ask("1234 8002 00000000 0a000007 " + f"{elsewhere.address[1]:04x}")

    assert bench.run(0.1) == []
    assert len(elsewhere.receive()) > 40


def test_buffered_records_come_several_a_datagram():
    bench = Bench(buffer=10)
    bench.ask("1234000300000019")  # 25 records
    lengths = []
    for _ in range(100):
        bench.now += TICK
        bench.box.advance(bench.now, WRENCH)
        lengths += [len(datagram) / 36 for datagram in bench.host.receive()]

    assert lengths == [10, 10, 5]


def test_a_bias_makes_the_present_reading_zero_while_the_stream_goes_on():
    bench = Bench()
    bench.ask(STREAM)
    bench.run(0.1)
    bench.ask("1234004200000000")
    records = bench.run(0.1)[1:]  # the first was on its way already

    assert all(r[3:] == (0,) * 6 for r in records)
    assert records[0][0] > 1
    assert bench.run(0.01, 2.0 * WRENCH)[-1][3:] == (1_000_000, -2_000_000, 3_000_000, 10_000, -20_000, 30_000)
    assert b"<setbias>1000000;-2000000;3000000;10000;-20000;30000</setbias>" in (bench.box.page() or b"")


def test_the_threshold_latch_stays_until_it_is_reset():
    bench = Bench()
    bench.box.faults.status = 1 << 16
    bench.ask(STREAM)
    assert {r[2] for r in bench.run(0.05)} == {0x80010000}
    bench.ask("1234004100000000")
    assert {r[2] for r in bench.run(0.05)[1:]} == {0}  # the first was on its way already


@pytest.mark.parametrize(
    "request_", ["", "1234", "12340002000000", "123400020000000000", "4321000200000000", "12348002000000000a000007"]
)
def test_what_is_no_request_is_ignored(request_):
    bench = Bench()
    bench.ask(request_)

    assert bench.run(0.1) == []


def test_the_first_record_comes_when_it_is_due_and_all_are_late_by_the_latency():
    bench = Bench(rate=7000.0, first=0.005, latency=0.010)
    bench.ask(STREAM)
    arrivals = []
    for number in range(1, 1001):
        bench.box.advance(number * 1e-4, WRENCH)
        arrivals += [(number * 1e-4, struct.unpack(">I", d[4:8])[0] - 6433) for d in bench.host.receive()]

    time, count = arrivals[0]
    assert count == 35  # 5 ms
    assert time == pytest.approx(0.015, abs=2e-4)
    assert all(0.010 - 1e-9 <= t - c / 7000 <= 0.0102 for t, c in arrivals)


def test_the_clock_of_the_box_may_be_off():
    bench = Bench(clock_error=0.005)
    bench.ask(STREAM)
    records = bench.run(2.0)

    assert (records[-1][1] - records[0][1]) == pytest.approx(7000 * 1.005 * 1.99, rel=0.005)


def test_a_wrench_that_changes_is_sampled_on_the_way():
    bench = Bench(rate=7000.0)
    bench.ask(STREAM)
    for number in range(1, 101):
        bench.box.advance(number * 0.01, np.array([number * 0.01, 0, 0, 0, 0, 0]))
    records = [struct.unpack(">IIIiiiiii", d) for d in bench.host.receive()]

    assert [r[3] for r in records] == pytest.approx([(r[1] - 6433) / 7000 * 1e6 for r in records], abs=1.0)


def test_noise_quantisation_offset_and_drift_are_the_configured_ones():
    bench = Bench(BaseSensorConfig())
    bench.ask(STREAM)
    counts = np.array([r[3:] for r in bench.run(40.0, np.zeros(6))], dtype=float) * 1e-6

    assert counts.std(axis=0) == pytest.approx([0.02] * 3 + [0.2e-3] * 3, rel=0.05)
    assert (np.abs(counts.mean(axis=0)) <= [1.0] * 3 + [10e-3] * 3).all()
    assert np.abs(counts.mean(axis=0)).min() > 0.0
    steps = counts / ([1 / 256] * 3 + [0.05e-3] * 3)
    assert np.abs(steps - np.round(steps)).max() < 0.011  # a wire count is coarser than that
    drift = counts[-5000:].mean(axis=0) - counts[:5000].mean(axis=0)
    assert np.abs(drift[:3]) == pytest.approx([30.0 * 5e-3 / 60.0] * 3, abs=1.5e-3)


def test_the_same_seed_gives_the_same_bytes_and_another_one_others():
    def sent(seed: int) -> list[tuple[int, ...]]:
        bench = Bench(BaseSensorConfig(), seed)
        bench.ask(STREAM)
        return bench.run(0.5)

    assert sent(3) == sent(3)
    assert sent(3) != sent(4)


@pytest.mark.parametrize(("axis", "value", "end"), [(0, 18.5, 18_000_000), (4, -0.3, -250_000)])
def test_beyond_the_calibrations_range_the_sensor_saturates_and_says_so(axis, value, end):
    bench, wrench = Bench(), np.zeros(6)
    wrench[axis] = value
    bench.ask(STREAM)
    records = bench.run(0.1, wrench)

    assert records[-1][2] == 0x80020000
    assert records[-1][3 + axis] == end
    assert bench.run(0.1, 0.5 * wrench)[-1][2] == 0


# Faults on the wire, and what the real driver makes of them.


class Station(Bench):
    """The driver of one sensor at the host's end."""

    def __init__(self, **settings: object) -> None:
        super().__init__(**settings)
        self.sensors = NetftSensors([self.host], [read_page(self.box.page() or b"")])
        self.sensors.start(0.0)
        self.worst = Quality.GOOD

    def drive(self, time: float, wrench: np.ndarray = WRENCH) -> np.ndarray:
        self.worst = Quality.GOOD
        for _ in range(round(time / TICK)):
            self.now += TICK
            self.box.advance(self.now, wrench)
            reading = self.sensors.poll(self.now)
            self.worst |= self.sensors.quality[0]
            if self.sensors.is_usable:
                assert reading.wrenches[0] == pytest.approx(wrench, abs=1e-6)
                assert self.now - 0.05 < reading.time <= self.now
        return reading.wrenches[0]


@pytest.fixture
def station() -> Station:
    station = Station()
    station.drive(0.1)
    assert station.sensors.is_usable
    return station


def test_the_driver_reads_what_the_plant_has(station):
    assert station.drive(1.0) == pytest.approx(WRENCH, abs=1e-6)
    assert station.worst is Quality.GOOD
    assert station.sensors.counters[0].lost == 0


def test_lost_doubled_and_exchanged_datagrams_are_counted_and_used_all_the_same(station):
    station.box.faults.drop = station.box.faults.duplicate = station.box.faults.reorder = 0.1
    station.drive(2.0)

    counters = station.sensors.counters[0]
    assert station.worst == Quality.GAP
    assert counters.lost > 50
    assert counters.duplicates > 50
    assert counters.late > 50
    assert counters.resyncs == 0


def test_flipped_bits_do_not_upset_the_stream(station):
    station.box.faults.flip = 0.2
    for _ in range(1000):  # bits of the counts themselves are for UDP's checksum
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        station.sensors.poll(station.now)
    station.box.faults.flip = 0.0
    station.drive(0.1)

    assert station.sensors.quality == (Quality.GOOD,)
    assert station.sensors.counters[0].implausible > 10


@pytest.mark.parametrize(
    ("fault", "value", "quality"),
    [
        ("mute", True, Quality.STALE),
        ("saturate", True, Quality.SATURATED),
        ("freeze", True, Quality.STALE),
        ("status", 1 << 9, Quality.STATUS),
    ],
)
def test_a_fault_is_seen_as_what_it_is_and_goes_when_it_goes(station, fault, value, quality):
    healthy = getattr(station.box.faults, fault)
    setattr(station.box.faults, fault, value)
    station.drive(0.5)
    assert quality in station.worst
    assert not station.sensors.is_usable

    setattr(station.box.faults, fault, healthy)
    station.drive(1.0)
    assert station.sensors.is_usable


def test_a_delay_makes_old_samples_of_old_time(station):
    station.box.faults.delay = 0.020
    for _ in range(100):
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        reading = station.sensors.poll(station.now)

    assert station.sensors.is_usable
    assert station.now - reading.time == pytest.approx(0.020, abs=0.004)


def test_a_box_without_power_for_a_moment_is_not_trusted_again_by_itself(station):
    station.drive(5.0)
    station.box.reboot()
    for _ in range(1000):
        station.now += TICK
        station.box.advance(station.now, WRENCH)
        station.sensors.poll(station.now)

    assert Quality.RESET in station.sensors.quality[0]
    assert not station.sensors.is_usable
    station.sensors.start(station.now)
    station.drive(0.1)
    assert station.sensors.is_usable


def test_records_that_nobody_receives_do_not_pile_up():
    bench = Bench(rate=7000.0)
    bench.ask(STREAM)
    for _ in range(1000):
        bench.now += TICK
        bench.box.advance(bench.now, WRENCH)

    newest = [struct.unpack(">I", datagram[:4])[0] for datagram in bench.host.receive()]
    assert len(newest) == MOST_WAITING
    assert newest == list(range(newest[-1] - MOST_WAITING + 1, newest[-1] + 1))


# The same box on real sockets.


class Served:
    """A box on this machine's network, advanced by a thread as the lab's process would."""

    def __init__(self) -> None:
        self.end = UdpEnd("127.0.0.1", 0)
        self.box = SimulatedNetft(self.end, PERFECT, np.random.default_rng(1), BoxSettings(serial="FT77"))
        self.server = PageServer("127.0.0.1", 0, self.box.page)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.server.close()
        self.end.close()

    def _serve(self) -> None:
        number = 0
        while not self._stop.wait(0.001):
            number += 1
            self.server.poll()
            self.box.advance(number * TICK, WRENCH)


@pytest.fixture
def served() -> Iterator[Served]:
    served = Served()
    yield served
    served.close()


def test_over_http_and_udp_the_driver_connects_streams_biases_and_stops(served):
    sensors = connect([BoxAddress("127.0.0.1", served.end.port, served.server.port, "FT77")])
    try:
        sensors.start(time.perf_counter())
        for _ in range(10_000):
            reading = sensors.poll(time.perf_counter())
            if sensors.counters[0].accepted > 20:
                break
            time.sleep(0.001)
        assert reading.wrenches[0] == pytest.approx(WRENCH, abs=1e-6)
        sensors.bias()
        for _ in range(10_000):
            reading = sensors.poll(time.perf_counter())
            if not reading.wrenches.any():
                break
            time.sleep(0.001)
        assert not reading.wrenches.any()
    finally:
        sensors.close()


def test_another_sensor_than_the_expected_one_is_refused_by_its_serial_number(served):
    with pytest.raises(SensorError, match="calibration 'FT77', expected 'FT78'"):
        connect([BoxAddress("127.0.0.1", served.end.port, served.server.port, "FT78")])


def test_a_browser_gets_the_page_and_nothing_else(served):
    with httpx.Client(base_url=f"http://127.0.0.1:{served.server.port}", trust_env=False) as client:
        page = client.get("/netftapi2.xml", params={"index": "0"})
        missing, posted = client.get("/"), client.post("/netftapi2.xml", content=b"x")

    assert page.status_code == 200
    assert read_page(page.content).serial == "FT77"
    assert (missing.status_code, posted.status_code) == (404, 405)


def test_a_mute_box_does_not_answer_by_http_either(served):
    served.box.faults.mute = True
    with pytest.raises(httpx.ReadTimeout), httpx.Client(trust_env=False, timeout=0.2) as client:
        client.get(f"http://127.0.0.1:{served.server.port}/netftapi2.xml")


def test_visitors_that_say_nothing_do_not_keep_others_out(served):
    silent = [socket.create_connection(("127.0.0.1", served.server.port)) for _ in range(8)]
    try:
        with httpx.Client(trust_env=False) as client:
            assert client.get(f"http://127.0.0.1:{served.server.port}/netftapi2.xml").status_code == 200
    finally:
        for visitor in silent:
            visitor.close()


def test_a_port_that_is_taken_is_named(served):
    with pytest.raises(AddressTaken, match=f"udp://127.0.0.1:{served.end.port}"):
        UdpEnd("127.0.0.1", served.end.port)
    with pytest.raises(AddressTaken, match=f"http://127.0.0.1:{served.server.port}"):
        PageServer("127.0.0.1", served.server.port, served.box.page)


@pytest.mark.parametrize(
    ("heard", "answer"),
    [
        (b"GET /netftapi2.xml HTTP/1.1\r\n", b""),
        (b"GET /netftapi2.xml HTTP/1.1\r\n\r\n", b"HTTP/1.1 200 OK"),
        (b"GET /netftapi2.xml?index=2 HTTP/1.0\r\nHost: x\r\n\r\n", b"HTTP/1.1 200 OK"),
        (b"GET /netftapi2.xmls HTTP/1.1\r\n\r\n", b"HTTP/1.1 404"),
        (b"nonsense\r\n\r\n", b"HTTP/1.1 400"),
        (b"DELETE /netftapi2.xml HTTP/1.1\r\n\r\n", b"HTTP/1.1 405"),
        (b"x" * 8192, b"HTTP/1.1 431"),
    ],
)
def test_requests_for_the_page(heard, answer):
    assert respond(heard, lambda: b"<netft/>").startswith(answer)
    assert bool(respond(heard, lambda: b"<netft/>")) == bool(answer)


def test_the_latency_of_the_simulated_box_is_the_manuals():
    assert BoxSettings().latency == LATENCY == 288e-6
