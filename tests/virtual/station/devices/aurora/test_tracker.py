"""The driver on a line: set-up from any state, frames and their times, quality, faults on the wire, recovery."""

import math

import numpy as np
import pytest

from station.devices.aurora.dialogue import Break
from station.devices.aurora.measurement import Quality
from station.devices.aurora.protocol import AuroraError
from station.devices.aurora.replies import Transform
from station.devices.aurora.session import AuroraSession
from station.devices.aurora.settings import AuroraSettings
from station.devices.aurora.tracker import AuroraTracker
from station.devices.links.memory_pipe import memory_pipe
from station.lab.aurora.coil import MOUNT
from station.lab.aurora.wire import HostPort, pump
from tests.harness.aurora_bench import REST, AuroraBench


def commands(bench: AuroraBench) -> list[str]:
    return [command for command in bench.unit.executed if command[:2] not in ("BX", "TX")]


def test_a_unit_fresh_from_the_switch_is_set_up_step_by_step():
    bench = AuroraBench()
    bench.run(1.0)

    assert commands(bench) == [
        *("INIT:", "COMM:50000", "VER:0", "PHSR:01", "PHSR:02", "PINIT:0A", "PHSR:03", "PENA:0AD", "PHSR:04"),
        *("PHINF:0A0001", "TSTART:"),
    ]
    assert bench.unit.baud == 115200
    assert bench.report.quality is Quality.GOOD
    assert bench.report.trouble == ""
    assert bench.report.firmware == "AURORA Rev 009"
    assert bench.report.tool is not None
    assert bench.report.tool.serial == "3A5C1D00"


def test_every_frame_comes_once_soon_and_where_the_tip_was():
    bench = AuroraBench()

    def tip(now: float) -> np.ndarray:
        return REST + np.array([0.010 * math.sin(now), 0.0, 0.015 * math.cos(now)])

    bench.run(1.0, tip)
    read = bench.run(20.0, tip)
    frames = [reading.frame for _, reading in read]

    assert frames == list(range(frames[0], frames[0] + len(frames)))
    assert len(read) == pytest.approx(800, abs=2)
    for now, reading in read:
        # by the frame number: frame 0 was at 0; ticks of 2 ms and the wire make it at most 5 ms late
        assert 0.0 <= reading.time - reading.frame / 40.0 < 0.005
        assert 0.020 < now - reading.time < 0.040
        assert reading.position == pytest.approx(tip(reading.frame / 40.0), abs=1e-7)  # single precision
    assert bench.report.counts.repeated < 0.15 * len(read)  # asked for hardly more often than there are frames


def test_old_firmware_is_asked_with_tx():
    bench = AuroraBench(firmware="AURORA Rev 007")
    read = bench.run(3.0)

    assert {command for command in bench.unit.executed if command[1:2] == "X"} == {"TX:0801"}
    assert len(read) > 80
    assert read[-1][1].position == pytest.approx(REST, abs=0.6e-5)  # TX prints hundredths of a millimetre


@pytest.mark.parametrize("lacks", [("BX",), ("BX", "VER")])
def test_a_unit_without_bx_is_asked_with_tx(lacks):
    bench = AuroraBench(lacks=lacks)

    assert len(bench.run(3.0)) > 60
    assert bench.report.quality is Quality.GOOD


def test_a_unit_that_another_session_left_tracking_at_the_fast_rate_is_found():
    bench = AuroraBench()
    bench.run(1.0)
    bench.tracker = AuroraTracker(bench.port, registration=MOUNT)
    bench.run(3.0)

    assert bench.report.quality is Quality.GOOD
    assert commands(bench).count("COMM:50000") == 1


def test_a_unit_left_at_an_unexpected_rate_is_reset_by_a_break():
    bench = AuroraBench(AuroraSettings(baud=230400))
    bench.run(1.0)
    bench.tracker = AuroraTracker(bench.port, AuroraSettings(baud=115200), MOUNT)
    bench.run(6.0)

    assert bench.report.quality is Quality.GOOD
    assert bench.unit.baud == 115200


def test_a_break_lasts_a_quarter_of_a_second_in_two_steps_without_waiting():
    session, orders = AuroraSession(AuroraSettings()), []
    for tick in range(5000):  # nobody answers
        orders += [(tick * 0.001, order) for order in session.due(tick * 0.001) if isinstance(order, Break)]

    (begin, low), (end, high) = orders[:2]
    assert (low, high) == (Break(True), Break(False))
    assert end - begin == pytest.approx(0.25, abs=2e-3)


def test_a_unit_that_is_switched_off_and_on_is_set_up_again():
    bench = AuroraBench()
    bench.run(2.0)
    bench.unit.restart(bench.now)
    during = bench.run(0.3)
    after = bench.run(8.0)

    assert not during
    assert bench.report.quality is Quality.GOOD
    assert bench.report.counts.connects == 2
    assert after[-1][1].position == pytest.approx(REST, abs=1e-8)


def test_a_lost_tool_is_a_quality_and_no_reading():
    bench = AuroraBench()
    bench.run(1.0)
    bench.unit.faults.tool_lost = True
    bench.run(0.1)  # what was measured before is still on its way
    during = bench.run(1.0)
    lost = bench.report
    bench.unit.faults.tool_lost = False
    after = bench.run(0.2)

    assert not during
    assert lost.quality is Quality.MISSING
    assert lost.good_age == pytest.approx(1.1, abs=0.1)
    assert len(after) >= 5
    assert bench.report.quality is Quality.GOOD


@pytest.mark.parametrize("beyond", [0.020, 0.200])  # the coil is still seen, and no more
def test_outside_the_half_metre_cube_there_is_no_reading(beyond):
    bench = AuroraBench()
    bench.run(1.0)
    speed = 0.3
    way = (0.250 - REST[0]) + beyond
    start = bench.now

    def tip(now: float) -> np.ndarray:
        return REST + np.array([min(way, speed * (now - start)), 0.0, 0.0])

    inside = bench.run(way / speed + 0.1, tip)
    outside = bench.run(0.5, tip)

    assert max(reading.position[0] for _, reading in inside) <= 0.250 + 1e-7
    assert not outside
    assert bench.report.quality is Quality.OUT_OF_VOLUME


def test_a_jump_is_not_a_reading():
    bench = AuroraBench()
    bench.run(1.0)
    read = bench.run(0.2, lambda now: REST + np.array([0.05, 0.0, 0.0]))

    assert all(abs(reading.position[0] - REST[0]) < 0.001 for _, reading in read)
    assert bench.report.quality is Quality.JUMP
    bench.run(0.5, lambda now: REST + np.array([0.05, 0.0, 0.0]))
    assert bench.report.quality is Quality.GOOD  # it stayed there


def test_a_tool_that_is_pulled_and_plugged_is_taken_up_under_its_new_handle():
    bench = AuroraBench()
    bench.run(1.0)
    bench.unit.unplug()
    during = bench.run(2.0)
    pulled = bench.report
    bench.unit.plug()
    after = bench.run(3.0)

    assert len(during) <= 2
    assert pulled.quality is Quality.DISABLED
    assert "not plugged in" in pulled.trouble
    assert bench.report.quality is Quality.GOOD
    assert after
    assert "PINIT:0B" in bench.unit.executed


def test_only_the_tool_that_was_named_is_the_tip():
    bench = AuroraBench(AuroraSettings(tool_serial="12345678"))
    assert not bench.run(3.0)
    assert bench.report.trouble == "tool 12345678 is not plugged in; tools that are: 3A5C1D00"


def test_a_mute_unit_is_told_and_found_again_when_it_speaks():
    bench = AuroraBench()
    bench.run(1.0)
    bench.unit.faults.mute = True
    bench.run(0.3)
    early = bench.report
    bench.run(5.0)
    late = bench.report
    bench.unit.faults.mute = False
    bench.run(8.0)

    assert early.quality is Quality.SILENT
    assert late.quality is Quality.CONNECTING
    assert "no answer to INIT:" in late.trouble or "no frame" in late.trouble
    assert bench.report.quality is Quality.GOOD


def test_a_pulled_cable_is_lost_for_good_until_a_link_is_attached():
    bench = AuroraBench()
    bench.run(1.0)
    bench.port.device.unplug()
    assert not bench.run(1.0)
    assert bench.report.quality is Quality.LOST
    assert "unplugged" in bench.report.trouble

    bench.port.device.plug()
    assert not bench.run(1.0)
    bench.port = HostPort("aurora again")
    bench.tracker.attach(bench.port)
    assert bench.run(4.0)
    assert bench.report.quality is Quality.GOOD


def test_after_a_lost_cable_another_tool_is_not_taken_for_the_first():
    bench = AuroraBench()
    bench.run(1.0)
    other = AuroraBench(serial="99999999")
    bench.port.device.unplug()
    bench.run(0.1)
    bench.unit, bench.port = other.unit, other.port
    bench.tracker.attach(bench.port)

    assert not bench.run(3.0)
    assert bench.report.trouble == "tool 3A5C1D00 is not plugged in; tools that are: 99999999"


@pytest.mark.parametrize("seed", range(4))
def test_a_disturbed_line_costs_frames_but_never_gives_a_wrong_one(seed):
    bench = AuroraBench(seed=seed)
    bench.unit.faults.drop = bench.unit.faults.flip = 1e-3
    read = bench.run(60.0)
    report = bench.report

    assert len(read) > 1000
    for _, reading in read:
        assert reading.position == pytest.approx(REST, abs=1e-8)
    assert report.noise > 0


def test_late_replies_are_timed_by_their_frames():
    bench = AuroraBench()
    bench.run(2.0)
    bench.unit.faults.delay = 0.015
    read = bench.run(2.0)

    assert len(read) > 60
    for _, reading in read:
        assert reading.time == pytest.approx(reading.frame / 40.0, abs=0.006)


def test_no_bytes_make_poll_raise():
    rng = np.random.default_rng(0)
    host, device = memory_pipe("noise")
    tracker = AuroraTracker(host)
    for tick in range(3000):
        device.write(rng.bytes(int(rng.integers(0, 60))))
        assert tracker.poll(0.01 * tick) is None
    assert tracker.report(30.0).quality is Quality.CONNECTING
    assert tracker.report(30.0).noise > 50000


def test_a_rate_that_the_unit_does_not_have_is_refused():
    with pytest.raises(AuroraError, match="12345 baud is not one of 9600"):
        AuroraSettings(baud=12345)


def test_closing_stops_the_tracking():
    bench = AuroraBench()
    bench.run(1.0)
    bench.tracker.close()
    pump(bench.port.device, bench.unit, bench.now)
    pump(bench.port.device, bench.unit, bench.now + 0.1)

    assert not bench.unit.tracking


@pytest.mark.parametrize("seed", range(3))
def test_the_tip_is_ahead_of_its_coil_along_the_coils_axis(seed):
    """Against the matrix of the quaternion, column z."""
    w, x, y, z = quaternion = (v := np.random.default_rng(seed).normal(size=4)) / np.linalg.norm(v)
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z])
    coil = Transform(tuple(quaternion.tolist()), (10.0, -20.0, 30.0), 0.1)

    assert np.array(coil.ahead(4.0)) == pytest.approx(np.array(coil.position) + 4.0 * axis)
    assert np.linalg.norm(np.subtract(coil.ahead(4.0), coil.position)) == pytest.approx(4.0)
    assert coil.ahead(0.0) == coil.position


def test_the_driver_tells_the_tip_where_the_coil_is_behind_it():
    """The simulated coil looks along the generator's z, which is down."""
    read = AuroraBench(AuroraSettings(coil_to_tip=4.0)).run(1.0)
    assert read
    for _, reading in read:
        assert reading.position == pytest.approx(REST - np.array([0.0, 0.0, 0.004]), abs=1e-7)


def test_the_driver_tells_where_the_coil_points_unless_it_is_not_to_be_believed():
    (_, reading), *_ = AuroraBench().run(1.0)
    assert reading.direction == pytest.approx(MOUNT.rotation[:, 2], abs=1e-6)
    (_, reading), *_ = AuroraBench(AuroraSettings(tells_axis=False)).run(1.0)
    assert reading.direction is None
