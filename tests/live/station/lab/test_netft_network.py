"""The simulated Net F/T box on real sockets."""

import socket
import threading
import time
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from station.devices.netft.page import read_page
from station.devices.netft.sensors import BoxAddress, SensorError, connect
from station.lab.netft.simulated import BoxSettings, SimulatedNetft
from station.lab.netft.wire import AddressTaken, PageServer, UdpEnd
from tests.harness.netft_bench import PERFECT, TICK, WRENCH


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
        reading = sensors.poll(time.perf_counter())
        while sensors.counters[0].accepted <= 20:
            time.sleep(0.001)
            reading = sensors.poll(time.perf_counter())
        assert reading.wrenches[0] == pytest.approx(WRENCH, abs=1e-6)
        sensors.bias()
        while sensors.poll(time.perf_counter()).wrenches.any():
            time.sleep(0.001)
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
