"""The simulated Aurora: documented exchanges, modes, errors, timing of the line, measurements."""

import struct

import numpy as np
import pytest

from station.devices.aurora.protocol import ReplyReader, ToolState, framed, parse_bx, parse_tx
from station.devices.links.link import LinkError
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import TrackerConfig
from station.lab.simulated_aurora import MAX_PENDING_COMMANDS, SimulatedAurora, pump
from station.lab.wires import BUFFER_BYTES, HostPort
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
    assert host.send(b"GETINFO:Features.Firmware.Version0492\r").startswith(b"Features.Firmware.Version=")
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


def test_aurora_command_with_a_space_needs_no_crc_and_accepts_lower_case_handles():
    host = Host()

    for command in (b"INIT \r", b"PINIT 0a\r", b"PENA 0aD\r", b"TSTART \r"):
        assert host.send(command) == b"OKAYA896\r"
    assert host.send(b"BX 0801\r")[:2] == b"\xc4\xa5"


@pytest.mark.parametrize(
    "command",
    [
        "COMM:50000",
        "GETINFO:Features.Firmware.Version",
        "VER:0",
        "APIREV:",
        "SFLIST:00",
        "BEEP:1",
        "PHSR:02",
        "PHSR:03",
    ],
)
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
    for command in ("PINIT:0A", "PENA:0AD", "PDIS:0A"):
        assert host.request(command) == "OKAY"
        states.append(host.request("PHSR:00"))

    assert states == ["010A001", "010A011", "010A031", "010A011"]
    assert host.request("PHSR:03") == "010A011"
    assert host.request("PHSR:04") == "00"


def test_aurora_command_phinf_returns_fields_in_the_order_of_the_bits():
    information = str(Host().request("PHINF:0A0025"))

    assert len(information) == 33 + 20 + 14
    assert information[23:31] == "3A5C1D00"
    assert information[31:33] == "01"


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


def test_aurora_baud_rate_changes_after_the_reply_to_the_command():
    host = Host()

    assert host.send(framed("COMM:50000"), baud=9600) == b"OKAYA896\r"
    assert host.unit.baud == 115200
    assert host.send(framed("VER:0"), baud=115200).startswith(b"NDI Aurora")


def test_aurora_and_host_receive_garbage_at_the_wrong_baud_rate():
    host = Host()
    host.request("COMM:50000")

    assert ReplyReader().feed(host.send(framed("INIT:"), baud=9600)) == []
    assert "INIT:" not in host.unit.executed
    host.send(b"\r", baud=115200)
    assert host.request("INIT:") == "OKAY"


def test_break_resets_the_simulated_aurora_to_9600_baud():
    host = Host().track()
    host.unit.restart(host.now)

    assert host.send(b"", 1.0) == b"RESETBE6F\r"
    assert host.unit.baud == 9600
    assert host.request("TX:0801") == "ERROR0C"
    assert host.request("PHSR:02") == "010A001"


def test_aurora_line_in_memory_transmits_a_break():
    port, unit = HostPort("aurora"), SimulatedAurora(TrackerConfig(), np.random.default_rng(0))
    unit.baud = 115200
    port.set_break(True)
    port.set_break(False)
    pump(port.device, unit, 0.0)
    pump(port.device, unit, 1.0)

    assert port.read() == b"RESETBE6F\r"


def test_simulated_aurora_bounds_its_backlog_in_a_flood_of_commands():
    host = Host().track()
    replies = ReplyReader().feed(host.send(framed("BX:0801") * 5000, 20.0))

    assert 0 < len(replies) <= 2 * MAX_PENDING_COMMANDS
    host.send(b"\r")  # the CR ends the command that was cut by the full buffer
    assert host.request("TSTOP:") == "OKAY"


def test_aurora_port_in_memory_keeps_at_most_its_buffer():
    port = HostPort("aurora")
    port.write(b"x" * 3 * BUFFER_BYTES)
    port.device.write(b"y" * 3 * BUFFER_BYTES)

    assert port.device.read() == b"x" * BUFFER_BYTES
    assert port.read() == b"y" * BUFFER_BYTES


def test_simulated_tracker_measures_40_frames_a_second_and_repeats_the_latest():
    host = Host().track()
    frames = []
    for _ in range(200):
        (tool,) = parse_bx(bytes(host.request("BX:0801", 0.010))).tools
        frames.append(tool.frame)

    steps = np.diff(np.array(frames, dtype=int))
    assert set(steps) == {0, 1}
    assert frames[-1] - frames[0] == pytest.approx(80, abs=1)


def test_aurora_frame_is_reported_after_its_latency():
    host = Host().track()
    for _ in range(100):
        requested = host.now
        (tool,) = parse_bx(bytes(host.request("BX:0801", 0.007))).tools
        # The latency of 24 ms includes 4.6 ms for the reply; the request takes 1 ms.
        assert tool.frame / 40.0 + 0.024 - 0.0046 <= requested + 0.0011


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
    for _ in range(4000):
        (tool,) = parse_bx(bytes(host.request("BX:0801", 0.012))).tools
        assert tool.transform is not None
        positions[tool.frame] = tool.transform.position
    noise = np.array(list(positions.values())) - SEEN

    assert noise.std(axis=0) == pytest.approx([0.1] * 3, rel=0.1)


@pytest.mark.parametrize(
    ("beyond", "options", "state"),
    [
        (0.02, "0801", ToolState.VALID),
        (0.02, "0001", ToolState.MISSING),
        (0.20, "0801", ToolState.MISSING),
    ],
)
def test_coil_outside_the_volume_is_reported(beyond, options, state):
    host = Host()
    host.tip = np.array([0.250 + beyond, 0.0, 0.190])
    host.track()
    for reply in (parse_bx(bytes(host.request(f"BX:{options}"))), parse_tx(str(host.request(f"TX:{options}")))):
        (tool,) = reply.tools
        assert tool.state is state
        assert tool.port_status == 0x71


def test_lost_aurora_tool_is_reported_missing():
    host = Host().track()
    host.unit.faults.tool_lost = True
    host.send(b"", 0.1)
    (tool,) = parse_bx(bytes(host.request("BX:0801"))).tools

    assert (tool.state, tool.port_status) == (ToolState.MISSING, 0x31)


def test_replugged_aurora_tool_gets_another_handle_and_sets_the_system_status():
    host = Host().track()
    host.unit.unplug()
    assert [tool.state for tool in parse_bx(bytes(host.request("BX:0801"))).tools] == [ToolState.DISABLED]
    assert [tool.state for tool in parse_tx(str(host.request("TX:0801"))).tools] == [ToolState.UNOCCUPIED]
    host.unit.plug()

    assert parse_bx(bytes(host.request("BX:0801"))).system_status & 0x40
    assert host.request("PHSR:01") == "010A030"
    assert host.request("PHSR:02") == "010B001"
    assert parse_bx(bytes(host.request("BX:0801"))).system_status == 0


def test_aurora_command_tstart_80_restarts_the_frame_count():
    host = Host().track()
    host.request("TSTOP:")
    host.request("TSTART:80", 0.1)
    (tool,) = parse_bx(bytes(host.request("BX:0801", 0.01))).tools

    assert tool.frame is not None
    assert tool.frame <= 4


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


def test_port_with_a_pulled_cable_is_dead_until_it_is_reopened():
    port, unit = HostPort("aurora"), SimulatedAurora(TrackerConfig(), np.random.default_rng(0))
    port.write(framed("INIT:"))
    port.device.unplug()
    for now in (0.1, 0.2):
        pump(port.device, unit, now)
    for use in (port.read, lambda: port.write(b"x"), port.reopen):
        with pytest.raises(LinkError, match=r"aurora .*plugged"):
            use()
    port.device.plug()
    with pytest.raises(LinkError, match="gone"):
        port.read()
    port.reopen()
    pump(port.device, unit, 0.3)
    assert port.read() == b""  # bytes in transmission are lost
    port.write(framed("INIT:"))
    for now in (0.4, 0.5, 0.6):
        pump(port.device, unit, now)
    assert port.read() == framed("OKAY")


def test_aurora_with_the_same_seed_measures_the_same():
    def seen(seed: int) -> bytes:
        host = Host(noise=1e-4)
        host.unit = SimulatedAurora(TrackerConfig(), np.random.default_rng(seed))
        host.track()
        return host.send(framed("BX:0801"))

    assert seen(3) == seen(3)
    assert seen(3) != seen(4)


@pytest.mark.parametrize("seed", range(2))
def test_disturbed_aurora_line_harms_neither_tracker_nor_host(seed):
    result = fuzz(5000, seed)

    assert (result["exceptions"], result["hangs"], result["false_accepts"]) == (0, 0, 0)
    assert result["cases"] >= 5000
    assert result["good_frames"] > 500
