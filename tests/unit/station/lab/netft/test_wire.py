"""What the simulated Net F/T box answers to a browser."""

import pytest

from station.devices.netft.protocol import LATENCY
from station.lab.netft.simulated import BoxSettings
from station.lab.netft.wire import respond


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
