"""A second coil is found by its serial number, measured in the same frame as the tip's coil, lost and found again."""

import math

import numpy as np
import pytest

from station.devices.aurora.dialogue import AuroraSettings, Coil
from station.devices.aurora.protocol import PORT_OCCUPIED, AuroraError, ReplyReader, parse_bx, parse_tx
from station.devices.interfaces import Severity
from station.lab.aurora_commands import ToolPort
from station.lab.simulated_aurora import TARGET_SERIAL
from tests.harness.aurora_bench import REST, AuroraBench

WITH = AuroraSettings(target=Coil(TARGET_SERIAL))


def swaying(now: float) -> np.ndarray:
    return REST + np.array([0.020, 0.005 * math.sin(2.0 * now), 0.015])


@pytest.mark.parametrize("settings", [WITH, AuroraSettings(target=Coil(TARGET_SERIAL), always_tx=True)])
def test_positions_of_both_coils_come_from_the_same_frame(settings):
    bench = AuroraBench(settings, target=TARGET_SERIAL)
    bench.run(1.0, target=swaying)

    read = bench.run(2.0, target=swaying)

    assert len(read) == pytest.approx(80, abs=2)
    for _, reading in read:
        assert reading.target is not None
        np.testing.assert_allclose(reading.position, REST, atol=1e-5)
        np.testing.assert_allclose(reading.target, swaying(reading.frame / 40.0), atol=1e-5)
        # the longer reply for two coils does not delay the time of measurement
        assert 0.0 <= reading.time - reading.frame / 40.0 < 0.005
    assert bench.tracker.trouble(bench.now) is None


def test_reply_with_two_coils_matches_the_captured_format():
    """The reply has two entries, each in the format of the captured reply of a single tool."""
    bench = AuroraBench(WITH, target=TARGET_SERIAL)
    bench.run(1.5, target=swaying)
    bench.port.device.read()
    bench.now += 0.2
    bench.unit.transmit(bench.now, 115200)  # discard the bytes that were still on the line

    for command, size in ((b"BX 0801\r", 8 + 1 + 2 * 42 + 2), (b"TX 0801\r", 2 + 2 * (2 + 51 + 17) + 4 + 4 + 1)):
        bench.unit.receive(command, bench.now, 115200)
        reply = bench.unit.transmit(bench.now + 0.1, 115200)
        bench.now += 0.2

        assert len(reply) == size
        (whole,) = ReplyReader().feed(reply)
        tools = (parse_tx(whole) if isinstance(whole, str) else parse_bx(whole)).tools
        assert [tool.handle for tool in tools] == [0x0A, 0x0B]
        assert tools[0].frame == tools[1].frame


def test_second_coil_is_ignored_without_the_key_target():
    bench = AuroraBench(AuroraSettings(tool=Coil("3A5C1D00")), target=TARGET_SERIAL)
    bench.run(1.0, target=swaying)

    read = bench.run(2.0, target=swaying)

    assert all(reading.target is None for _, reading in read)
    np.testing.assert_allclose(read[-1][1].position, REST, atol=1e-5)
    assert bench.tracker.trouble(bench.now) is None
    assert "target" not in bench.tracker.details()


def test_second_coil_does_not_change_the_readings_of_the_tip():
    alone, with_target = AuroraBench(noise=1e-4), AuroraBench(WITH, noise=1e-4, target=TARGET_SERIAL)

    one, two = ({r.frame: r for _, r in bench.run(3.0, target=swaying)} for bench in (alone, with_target))

    common = sorted(one.keys() & two.keys())
    assert len(common) > 60
    for frame in common:
        assert one[frame].position.tolist() == two[frame].position.tolist()


def test_lost_target_is_a_warning_and_the_tip_is_still_measured():
    bench = AuroraBench(WITH, target=TARGET_SERIAL)
    bench.run(1.0, target=swaying)
    bench.unit.faults.target_lost = True

    read = bench.run(0.5, target=swaying)

    assert len(read) == pytest.approx(20, abs=2)
    assert read[-1][1].target is None
    trouble = bench.tracker.trouble(bench.now)
    assert trouble is not None
    assert trouble.severity is Severity.WARN
    assert f"target {TARGET_SERIAL}: missing; no good position for 0.5" in trouble.text

    bench.unit.faults.target_lost = False
    assert bench.run(0.5, target=swaying)[-1][1].target is not None
    assert bench.tracker.trouble(bench.now) is None


def test_unplugged_target_is_named_and_used_after_it_is_plugged_in():
    bench = AuroraBench(WITH)
    read = bench.run(1.5)
    trouble = bench.tracker.trouble(bench.now)

    assert read
    assert trouble is not None
    assert f"target {TARGET_SERIAL}: not plugged in; connected tools: 3A5C1D00 (handle 0A)" in trouble.text

    unit = AuroraBench(target=TARGET_SERIAL).unit
    bench.unit._target = unit._target
    bench.unit.handles.ports.append(ToolPort(0x0B, TARGET_SERIAL, target=True))
    bench.unit.handles.changed |= PORT_OCCUPIED
    assert bench.run(2.0, target=swaying)[-1][1].target is not None


def test_jump_of_the_target_is_rejected_without_affecting_the_tip():
    bench = AuroraBench(WITH, target=TARGET_SERIAL)
    bench.run(1.0, target=swaying)

    read = bench.run(0.2, target=lambda now: swaying(now) + 0.05)

    assert all(reading.target is None for _, reading in read[2:])
    assert len(read) >= 7


def test_coil_cannot_be_tip_and_target():
    with pytest.raises(AuroraError, match="cannot be the tip's coil and the target's"):
        AuroraSettings(tool=Coil("A"), target=Coil("A"))
