"""The simulated Net F/T box answers requests of a browser for its page."""

import pytest

from station.devices.ati.protocol import LATENCY_S
from station.lab.endpoints import respond
from station.lab.simulated_netft import BoxSettings


@pytest.mark.parametrize(
    ("http_request", "answer"),
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
def test_requests_for_the_simulated_box_page_get_the_expected_status(http_request, answer):
    assert respond(http_request, lambda: b"<netft/>").startswith(answer)
    assert bool(respond(http_request, lambda: b"<netft/>")) == bool(answer)


def test_latency_of_the_simulated_force_sensor_is_that_of_the_manual():
    assert BoxSettings().latency == LATENCY_S == 288e-6
