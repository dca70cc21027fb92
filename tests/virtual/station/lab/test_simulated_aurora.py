"""The simulated Aurora: documented exchanges, modes, errors, timing of the line, measurements."""

import struct

import numpy as np
import pytest

from station.devices.aurora.protocol import ReplyReader, ToolState, framed, parse_bx, parse_tx
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import TrackerConfig
from station.lab.simulated_aurora import MAX_PENDING_COMMANDS, SimulatedAurora
from station.lab.wires import BUFFER_BYTES
from tests.fuzz.aurora import fuzz

TIP = np.array([0.010, -0.020, 0.190])
#: The position TIP in the generator's frame, which is 0.2 m behind the plate with its z axis reversed [mm].
SEEN = (10.0, 20.0, -390.0)


class Host:
    """Host that communicates byte by byte in virtual time, at the unit's baud rate by default."""

    def __init__(self, noise: float = 0.0, **unit: str) -> None:
        self.unit = SimulatedAurora(TrackerConfig(noise=noise, direction_noise=0.0), np.random.default_rng(0), **unit)
        self.now = 0.0
        self.tip = TIP

    def send(self, data: bytes, time: float = 0.3, baud: int | None = None) -> bytes:
        """Return the bytes received within `time` [s]."""
        received = b""
        self.unit.receive(data, self.now, baud)
        for _ in range(round(time / 0.001)):
            before, self.now = self.now, self.now + 0.001
            self.unit.advance(before, self.now, self.tip, self.tip)
            self.unit.receive(b"", self.now)
            received += self.unit.transmit(self.now, baud)
        return received

    def request(self, command: str, time: float = 0.3) -> str | bytes:
        """Return the single reply to a command; command and reply have CRCs."""
        reader = ReplyReader()
        (reply,) = reader.feed(self.send(framed(command), time))
        assert (reader.noise, reader.crc_errors) == (0, 0)
        return reply

    def track(self) -> "Host":
        for command in ("INIT:", "COMM:50000", "PINIT:0A", "PENA:0AD", "TSTART:"):
            assert self.request(command) == "OKAY"
        return self


def test_simulated_aurora_executes_commands_after_a_flood_of_bytes():
    """Bytes beyond the buffer are lost, as in a serial port, instead of being transmitted for minutes."""
    host = Host()
    for _ in range(50):
        host.send(bytes(65536), time=0.001)
    host.send(b"\r", time=2.0 * BUFFER_BYTES * 10 / 9600)
    assert host.request("INIT:") == "OKAY"


def test_documented_exchange_of_the_aurora_protocol():
    host = Host()

    assert host.send(b"INIT:E3A5\r") == b"OKAYA896\r"
    assert host.send(b"COMM:500000048\r") == b"OKAYA896\r"
    version = host.send(b"VER:065EE\r")
    assert b"\nFreeze Tag: AURORA Rev 009\n" in version
    assert version.endswith(b"\r")
    assert host.send(b"PHSR:02E17E\r") == b"010A001C1B5\r"
    assert host.send(b"PINIT:0AD5EB\r") == b"OKAYA896\r"
    assert host.send(b"PENA:0ADAD1E\r") == b"OKAYA896\r"
    assert host.send(b"TSTART:5423\r") == b"OKAYA896\r"
    assert host.send(b"BX:080100EC\r")[:11] == bytes.fromhex("c4a52d003043010a01") + struct.pack("<f", 1.0)[:2]
    assert host.send(b"TSTOP:2C14\r") == b"OKAYA896\r"
    assert host.send(b"TX:0801C19B\r") == b"ERROR0C4E42\r"


@pytest.mark.parametrize("command", ["COMM:50000", "VER:0", "PHSR:02", "PHSR:03"])
def test_simulated_aurora_answers_queries_before_it_is_initialised(command):
    assert not str(Host().request(command)).startswith("ERROR")


@pytest.mark.parametrize(
    ("command", "error"),
    [
        (b"INIT:E3A6\r", 0x04),  # the CRC is wrong
        (b"INIT:\r", 0x03),
        (b"INIT\r", 0x01),
        (framed("FOO:"), 0x01),
        (framed("VER:x"), 0x07),
        (framed("COMM:90000"), 0x06),
        (framed("COMM:500"), 0x03),
        (framed("PINIT:0B"), 0x08),
        (framed("PINIT:zz"), 0x23),
        (framed("PENA:0AD"), 0x0E),
        (framed("PENA:0AX"), 0x09),
        (framed("PHSR:09"), 0x23),
        (framed("BX:0801"), 0x0C),
        (framed("TSTOP:"), 0x0C),
        (b"A" * 600 + b"\r", 0x02),
        (b"\xff\xfe\r", 0x04),
    ],
)
def test_invalid_aurora_command_is_answered_with_its_error_number(command, error):
    host = Host()
    host.request("INIT:")
    assert host.send(command, 1.0) == framed(f"ERROR{error:02X}")


def test_simulated_aurora_refuses_tracking_before_it_is_initialised():
    assert Host().request("TSTART:") == "ERROR10"


def test_aurora_port_handle_goes_through_its_documented_states():
    host = Host()
    host.request("INIT:")
    states = [host.request("PHSR:00")]
    for command in ("PINIT:0A", "PENA:0AD", "PHF:0A"):
        assert host.request(command) == "OKAY"
        states.append(host.request("PHSR:00"))

    assert states == ["010A001", "010A011", "010A031", "010A001"]
    assert host.request("PHSR:02") == "010A001"
    assert host.request("PHSR:04") == "00"


def test_transmission_of_an_aurora_frame_takes_68_ms_at_9600_baud_and_6_ms_at_115200():
    def exchange(host: Host) -> float:
        start = host.now
        received, host_now = b"", 0.0
        received = host.send(framed("BX:0801"), 0.0)
        while len(received) < 53:
            received += host.send(b"", 0.001)
            host_now = host.now
        return host_now - start

    fast = Host().track()
    slow = Host()
    for command in ("INIT:", "PINIT:0A", "PENA:0AD", "TSTART:"):
        slow.request(command)

    # The request has 12 bytes and the reply 53 bytes of 10 bits each; the tracker needs 0.5 ms to answer.
    assert exchange(slow) == pytest.approx(0.0677 + 0.0005, abs=0.002)
    assert exchange(fast) == pytest.approx(0.0056 + 0.0005, abs=0.002)


def test_simulated_aurora_bounds_its_backlog_in_a_flood_of_commands():
    host = Host().track()
    replies = ReplyReader().feed(host.send(framed("BX:0801") * 5000, 20.0))

    assert 0 < len(replies) <= 2 * MAX_PENDING_COMMANDS
    host.send(b"\r")  # the CR ends the command that was cut by the full buffer
    assert host.request("TSTOP:") == "OKAY"


def test_aurora_commands_bx_and_tx_report_the_position_of_the_tip():
    host = Host().track()
    (binary,) = parse_bx(bytes(host.request("BX:0801"))).tools
    (text,) = parse_tx(str(host.request("TX:0801"))).tools

    for tool in (binary, text):
        assert tool.state is ToolState.VALID
        assert tool.port_status == 0x31
        assert tool.transform is not None
        assert tool.transform.position == pytest.approx(SEEN, abs=1e-4)
    assert binary.transform is not None
    assert GENERATOR_POSE.apply(1e-3 * np.array(binary.transform.position)) == pytest.approx(TIP, abs=1e-7)


def test_simulated_coil_reports_its_direction_but_no_roll():
    host = Host().track()
    axis = np.array([0.6, 0.0, 0.8])
    host.unit.advance(host.now, host.now + 0.1, TIP, TIP, axis)
    host.now += 0.1
    host.unit.receive(b"", host.now)
    (tool,) = parse_bx(bytes(host.request("BX:0801", 0.01))).tools
    assert tool.transform is not None
    w, x, y, z = tool.transform.quaternion

    # The third column of the rotation is the coil's axis in the generator's frame.
    assert (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)) == pytest.approx((0.6, 0.0, -0.8))
    assert z == 0.0


def test_simulated_tracker_has_the_configured_noise():
    host = Host(noise=0.1e-3)
    host.track()
    positions = {}
    for _ in range(800):
        (tool,) = parse_bx(bytes(host.request("BX:0801", 0.025))).tools
        assert tool.transform is not None
        positions[tool.frame] = tool.transform.position
    noise = np.array(list(positions.values())) - SEEN

    assert len(noise) > 700
    assert noise.std(axis=0) == pytest.approx([0.1] * 3, rel=0.1)


def test_each_aurora_fault_changes_the_line():
    host = Host().track()
    faults = host.unit.faults

    faults.delay = 0.05
    assert host.send(framed("BX:0801"), 0.05) == b""
    assert len(host.send(b"", 0.05)) == 53
    faults.delay, faults.mute = 0.0, True
    assert host.send(framed("BX:0801")) == b""
    faults.mute, faults.drop = False, 1.0
    assert host.send(framed("BX:0801")) == b""
    faults.drop, faults.flip = 0.0, 0.2
    replies = [reply for _ in range(50) for reply in ReplyReader().feed(host.send(framed("BX:0801"), 0.02))]
    assert all(isinstance(reply, str) and reply.startswith("ERROR") for reply in replies)
    faults.flip = 0.0
    host.send(b"\r")
    assert len(host.send(framed("BX:0801"))) == 53


def test_disturbed_aurora_line_harms_neither_tracker_nor_host():
    result = fuzz(2000, seed=0)

    assert (result["exceptions"], result["hangs"], result["false_accepts"]) == (0, 0, 0)
    assert result["good_frames"] > 200
