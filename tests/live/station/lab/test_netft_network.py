"""The simulated Net F/T box serves its driver and browsers on real sockets."""

import socket
import threading
import time
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from station.devices.ati.calibration import read_page
from station.devices.ati.netft import ForceBoxFile, SensorError, connect
from station.devices.ati.protocol import RdtCommand, request
from station.lab.endpoints import AddressInUse, PageServer, UdpDeviceEnd
from station.lab.simulated_netft import BoxSettings, SimulatedNetft
from tests.harness.netft_bench import PERFECT, TICK, WRENCH


class Served:
    """A box on this machine's network, advanced by a thread as the lab's process would."""

    def __init__(self) -> None:
        self.end = UdpDeviceEnd("127.0.0.1", 0)
        self.box = SimulatedNetft(self.end, PERFECT, np.random.default_rng(1), BoxSettings(serial="FT77"))
        self.box.page()  # compiles the page's code, which takes longer than a host waits for a page
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


def test_netft_driver_connects_streams_biases_and_stops_over_http_and_udp(served):
    sensors = connect(
        [ForceBoxFile(host="127.0.0.1", rdt_port=served.end.port, http_port=served.server.port, serial="FT77")]
    )
    try:
        sensors.start(time.perf_counter())
        reading = sensors.poll(time.perf_counter())
        while sensors.counters[0].accepted <= 20:
            time.sleep(0.001)
            reading = sensors.poll(time.perf_counter())
        assert reading.wrenches[0] == pytest.approx(WRENCH, abs=1e-6)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
            host.sendto(request(RdtCommand.BIAS), ("127.0.0.1", served.end.port))
        while sensors.poll(time.perf_counter()).wrenches.any():
            time.sleep(0.001)
    finally:
        sensors.close()


def test_force_sensor_with_an_unexpected_serial_number_is_refused(served):
    with pytest.raises(SensorError, match="calibration 'FT77', expected 'FT78'"):
        connect([ForceBoxFile(host="127.0.0.1", rdt_port=served.end.port, http_port=served.server.port, serial="FT78")])


def test_browser_gets_only_the_page_from_the_simulated_box(served):
    with httpx.Client(base_url=f"http://127.0.0.1:{served.server.port}", trust_env=False) as client:
        page = client.get("/netftapi2.xml", params={"index": "0"})
        missing, posted = client.get("/"), client.post("/netftapi2.xml", content=b"x")

    assert page.status_code == 200
    assert read_page(page.content).serial == "FT77"
    assert (missing.status_code, posted.status_code) == (404, 405)


def test_mute_box_does_not_answer_by_http_either(served):
    served.box.faults.mute = True
    with pytest.raises(httpx.ReadTimeout), httpx.Client(trust_env=False, timeout=0.2) as client:
        client.get(f"http://127.0.0.1:{served.server.port}/netftapi2.xml")


def test_silent_connections_to_the_box_do_not_block_others(served):
    silent = [socket.create_connection(("127.0.0.1", served.server.port)) for _ in range(8)]
    try:
        with httpx.Client(trust_env=False) as client:
            assert client.get(f"http://127.0.0.1:{served.server.port}/netftapi2.xml").status_code == 200
    finally:
        for visitor in silent:
            visitor.close()


def test_port_in_use_is_named_in_the_error_of_the_simulated_box(served):
    with pytest.raises(AddressInUse, match=f"udp://127.0.0.1:{served.end.port}"):
        UdpDeviceEnd("127.0.0.1", served.end.port)
    with pytest.raises(AddressInUse, match=f"http://127.0.0.1:{served.server.port}"):
        PageServer("127.0.0.1", served.server.port, served.box.page)
