"""The Aurora driver on a serial line: set-up from any state, times of frames, quality, line faults, recovery."""

import math
import re

import numpy as np
import pytest

from station.devices.aurora import tracker
from station.devices.aurora.dialogue import AuroraSettings, Coil, SerialBreak
from station.devices.aurora.protocol import AuroraError, Transform
from station.devices.aurora.session import AuroraSession
from station.devices.aurora.tracker import AuroraTracker
from station.devices.interfaces import Severity
from station.devices.kernel.quality import Quality
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.simulated_aurora import pump
from tests.harness.aurora_bench import REST, AuroraBench

#: Places of the two coils of the simulated unit.
AT_1, AT_2 = "(handle 0A)", "(handle 0B)"


def commands(bench: AuroraBench) -> list[str]:
    return [command for command in bench.unit.executed if command[:2] not in ("BX", "TX")]


def test_unit_after_power_on_is_set_up_step_by_step():
    bench = AuroraBench()
    bench.run(1.0)

    assert commands(bench) == [
        *("INIT:", "COMM:50000", "VER:0", "PHSR:01", "PHSR:02", "PINIT:0A", "PHSR:03", "PENA:0AD", "PHSR:00"),
        *("PHINF:0A0001", "TSTART:"),
    ]
    assert bench.unit.baud == 115200
    assert bench.report.quality is Quality.GOOD
    assert bench.report.trouble == ""
    assert bench.tracker.details()["firmware"] == "AURORA Rev 009"
    assert bench.tracker.details()["tool"]["serial"] == "3A5C1D00"


def test_every_frame_is_received_once_early_and_with_the_true_tip():
    bench = AuroraBench()

    def tip(now: float) -> np.ndarray:
        return REST + np.array([0.010 * math.sin(now), 0.0, 0.015 * math.cos(now)])

    bench.run(1.0, tip)
    read = bench.run(5.0, tip)
    frames = [reading.frame for _, reading in read]

    assert frames == list(range(frames[0], frames[0] + len(frames)))
    assert len(read) == pytest.approx(200, abs=2)
    for now, reading in read:
        # Frame n was measured at n / 40 s; ticks of 2 ms and the line delay the driver's time by at most 5 ms.
        assert 0.0 <= reading.time - reading.frame / 40.0 < 0.005
        assert 0.020 < now - reading.time < 0.040
        # tolerance: positions have single precision
        assert reading.position == pytest.approx(tip(reading.frame / 40.0), abs=1e-7)
    # the driver polls only slightly more often than frames are measured
    assert bench.tracker.details()["repeated"] < 0.15 * len(read)


@pytest.mark.parametrize("firmware", ["AURORA Rev 007", "AURORA Rev 008"])
def test_old_firmware_is_polled_with_tx(firmware):
    bench = AuroraBench(firmware=firmware)
    read = bench.run(3.0)

    assert {command for command in bench.unit.executed if command[1:2] == "X"} == {"TX:0801"}
    assert len(read) > 80
    assert read[-1][1].position == pytest.approx(REST, abs=0.6e-5)  # TX prints hundredths of a millimetre


@pytest.mark.parametrize("lacks", [("BX",), ("BX", "VER")])
def test_unit_without_bx_is_polled_with_tx(lacks):
    bench = AuroraBench(lacks=lacks)

    assert len(bench.run(3.0)) > 60
    assert bench.report.quality is Quality.GOOD


def test_unit_left_tracking_at_the_fast_rate_is_found():
    bench = AuroraBench()
    bench.run(1.0)
    bench.tracker = AuroraTracker(bench.port, registration=GENERATOR_POSE)
    bench.run(3.0)

    assert bench.report.quality is Quality.GOOD
    assert commands(bench).count("COMM:50000") == 1


def test_unit_at_an_unexpected_rate_is_reset_by_a_break():
    bench = AuroraBench(AuroraSettings(baud=230400))
    bench.run(1.0)
    bench.tracker = AuroraTracker(bench.port, AuroraSettings(baud=115200), GENERATOR_POSE)
    bench.run(6.0)

    assert bench.report.quality is Quality.GOOD
    assert bench.unit.baud == 115200


def test_break_lasts_a_quarter_of_a_second_without_blocking():
    session, orders = AuroraSession(AuroraSettings()), []
    for tick in range(5000):  # no unit answers
        orders += [(tick * 0.001, order) for order in session.due(tick * 0.001) if isinstance(order, SerialBreak)]

    (start, low), (end, high) = orders[:2]
    assert (low, high) == (SerialBreak(True), SerialBreak(False))
    assert end - start == pytest.approx(0.25, abs=2e-3)


@pytest.mark.parametrize("seconds", [0.3, 1.7, 4.4, 9.0])
def test_unit_that_starts_late_is_waited_for_with_the_reason(seconds):
    bench = AuroraBench()
    bench.unit.faults.mute = True
    bench.run(seconds)
    assert seconds < 1.5 or "the tracker cannot start: no answer to INIT" in str(bench.tracker.trouble(bench.now))
    bench.unit.faults.mute = False
    bench.unit.restart(bench.now)
    bench.run(7.0)
    assert bench.report.quality is Quality.GOOD


def test_unit_is_set_up_again_after_a_power_cycle():
    bench = AuroraBench()
    bench.run(2.0)
    bench.unit.restart(bench.now)
    during = bench.run(0.3)
    after = bench.run(8.0)

    assert not during
    assert bench.report.quality is Quality.GOOD
    assert bench.tracker.details()["connects"] == 2
    assert after[-1][1].position == pytest.approx(REST, abs=1e-8)


@pytest.mark.parametrize("beyond", [0.020, 0.200])  # at 20 mm the coil is still measured, at 200 mm no more
def test_no_reading_outside_the_half_metre_cube(beyond):
    bench = AuroraBench()
    bench.run(1.0)
    speed = 0.3
    distance = (0.250 - REST[0]) + beyond
    start = bench.now

    def tip(now: float) -> np.ndarray:
        return REST + np.array([min(distance, speed * (now - start)), 0.0, 0.0])

    inside = bench.run(distance / speed + 0.1, tip)
    outside = bench.run(0.5, tip)

    assert max(reading.position[0] for _, reading in inside) <= 0.250 + 1e-7
    assert not outside
    assert bench.report.quality is Quality.OUT_OF_VOLUME


def test_replugged_tool_is_used_under_its_new_handle():
    bench = AuroraBench()
    bench.run(1.0)
    bench.unit.unplug()
    during = bench.run(2.0)
    pulled = bench.report
    bench.unit.plug()
    after = bench.run(3.0)

    assert len(during) <= 2
    assert pulled.quality is Quality.DISABLED
    assert pulled.trouble == "no usable tool is plugged in; connected tools: none"
    assert bench.report.quality is Quality.GOOD
    assert after
    assert "PINIT:0B" in bench.unit.executed


@pytest.mark.parametrize("unprogrammed", [False, True])
def test_wrong_serial_number_is_named_with_its_key_and_the_connected_tools(unprogrammed):
    bench = AuroraBench(AuroraSettings(tool=Coil("12345678")), target="3A5C1D01", unprogrammed=unprogrammed)
    assert not bench.run(4.0)
    assert bench.report.trouble == (
        f"tool 12345678 is not plugged in, or 'tool' is wrong; connected tools: 3A5C1D00 {AT_1}, 3A5C1D01 {AT_2}"
        + unprogrammed * ", PINIT:0C: the tool could not be initialised (ERROR13)"
    )


@pytest.mark.parametrize("serial", ["", "3A5C1D00"])
def test_unprogrammed_tool_does_not_hide_the_coil_at_the_tip(serial):
    bench = AuroraBench(AuroraSettings(tool=Coil(serial)), unprogrammed=True)
    bench.run(1.0)

    assert len(bench.run(1.0)) == pytest.approx(40, abs=1)
    assert bench.report.trouble == ""


@pytest.mark.parametrize(
    ("settings", "second", "words"),
    [
        (AuroraSettings(), "3A5C1D01", "'tool' is not set and several tools are connected: set 'tool' to the serial"),
        (AuroraSettings(target=Coil("3A5C1D00")), "3A5C1D00", "2 coils have the serial number 3A5C1D00: set 't"),
    ],
)
def test_two_tools_that_match_are_named_and_refused(settings, second, words):
    bench = AuroraBench(settings, target=second)

    assert not bench.run(3.0)
    assert bench.report.trouble.startswith(words)
    assert re.search(rf"connected tools: 3A5C1D00 \(.*handle 0A\), {second} \(.*handle 0B\)$", bench.report.trouble)


@pytest.mark.parametrize("dual", [True, False])
def test_two_coils_with_one_serial_number_are_refused_and_chosen_by_port_or_channel(dual):
    """Two coils of one plug have one number, and the second one its handle only when the first is initialised."""
    bench = AuroraBench(AuroraSettings(tool=Coil("3A5C1D00")), target="3A5C1D00", dual=dual)
    assert not bench.run(3.0)
    second = "port 1, channel 1" if dual else "port 2, channel 0"
    assert bench.report.trouble == (
        "2 coils have the serial number 3A5C1D00: set 'tool_port' and 'tool_channel' to those of one, or unplug all but"
        f" one; connected tools: 3A5C1D00 (port 1, channel 0, handle 0A), 3A5C1D00 ({second}, handle 0B)"
    )
    for k in (0, 1):
        coil = Coil("3A5C1D00", channel=k) if dual else Coil("3A5C1D00", port=1 + k)
        bench = AuroraBench(AuroraSettings(tool=coil), target="3A5C1D00", dual=dual)
        read = bench.run(3.0, target=lambda time: REST + 0.02)
        assert read[-1][1].position == pytest.approx(REST + 0.02 * k, abs=1e-5)


def test_coils_with_one_serial_number_whose_places_are_unknown_are_refused_without_keys():
    bench = AuroraBench(AuroraSettings(tool=Coil("3A5C1D00")), target="3A5C1D00")
    information = bench.unit.handles.information
    bench.unit.handles.information = lambda parameters: information(parameters.replace("0021", "0025"))  # ERROR23
    bench.run(3.0)
    assert bench.report.trouble == (
        "2 coils have the serial number 3A5C1D00: unplug all but one; "
        f"connected tools: 3A5C1D00 {AT_1}, 3A5C1D00 {AT_2}"
    )


def test_mute_unit_is_reported_and_found_when_it_answers_again():
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


@pytest.mark.parametrize(("options", "hold_after"), [({}, 0.25), ({"stale_after": 1.0}, 1.0)])
def test_silent_tracker_is_a_warning_until_the_configured_time_and_then_a_hold(options, hold_after, paper, monkeypatch):
    bench = AuroraBench()
    monkeypatch.setattr(tracker, "SerialLink", lambda _port, _baud: bench.port)
    bench.tracker = tracker.aurora({"port": "/dev/ttyUSB0", **options}, paper)()
    bench.run(1.0)
    bench.unit.faults.mute = True
    bench.run(hold_after - 0.05)
    early = bench.tracker.trouble(bench.now)
    bench.run(0.1)
    late = bench.tracker.trouble(bench.now)
    assert (early.severity, late.severity) == (Severity.WARN, Severity.HOLD)


def test_tracker_rejects_another_tool_after_a_lost_cable():
    bench = AuroraBench()
    bench.run(1.0)
    other = AuroraBench(serial="99999999")
    bench.port.device.unplug()
    bench.run(0.1)
    bench.unit, bench.port = other.unit, other.port
    bench.tracker.attach(bench.port)

    assert not bench.run(3.0)
    assert bench.report.trouble == (
        "tool 3A5C1D00 is not plugged in, or 'tool' is wrong; connected tools: 99999999 " + AT_1
    )


def test_disturbed_line_loses_frames_but_never_gives_a_wrong_one():
    bench = AuroraBench()
    bench.unit.faults.drop = bench.unit.faults.flip = 1e-3
    read = bench.run(20.0)

    assert len(read) > 300
    for _, reading in read:
        assert reading.position == pytest.approx(REST, abs=1e-8)
    assert bench.tracker.details()["noise_bytes"] > 0


def test_late_replies_get_the_times_of_their_frames():
    bench = AuroraBench()
    bench.run(2.0)
    bench.unit.faults.delay = 0.015
    read = bench.run(2.0)

    assert len(read) > 60
    for _, reading in read:
        assert reading.time == pytest.approx(reading.frame / 40.0, abs=0.006)


@pytest.mark.parametrize(("rate", "severity"), [(2.0, Severity.HOLD), (20.0, Severity.WARN), (80.0, Severity.WARN)])
def test_unit_with_another_frame_rate_than_configured_is_named_with_the_key_and_gives_no_early_time(rate, severity):
    bench = AuroraBench(rate=rate)
    bench.run(8.0)
    bench.run((9.4 if rate < 4.0 else 8.004) - bench.now)
    fault = bench.tracker.trouble(bench.now)
    read = bench.run(3.0)

    assert fault is not None
    assert fault.severity is severity
    named = re.search(r"measures about (\S+) frames/s, and 'frame_rate' is 40: set 'frame_rate'", fault.text)
    assert named
    assert float(named[1]) == pytest.approx(rate, rel=0.05)
    for now, reading in read:
        assert reading.frame / rate <= reading.time <= now


def test_device_that_is_no_aurora_is_quoted_with_the_keys_to_check():
    session = AuroraSession(AuroraSettings())
    for tick in range(3000):
        for order in session.due(tick * 0.002):
            if isinstance(order, bytes):
                session.receive(b"$GPGGA,12\r\n", tick * 0.002)

    assert session.dialogue.trouble.startswith("INIT: was answered by ")
    assert "GPGGA" in session.dialogue.trouble
    assert "check the keys 'port' and 'baud'" in session.dialogue.trouble


def test_unsupported_rate_is_refused():
    with pytest.raises(AuroraError, match="12345 baud is not one of 9600"):
        AuroraSettings(baud=12345)


def test_close_stops_the_tracking():
    bench = AuroraBench()
    bench.run(1.0)
    bench.tracker.close()
    pump(bench.port.device, bench.unit, bench.now)
    pump(bench.port.device, bench.unit, bench.now + 0.1)

    assert not bench.unit.tracking


def test_tip_is_ahead_of_its_coil_along_the_coils_axis():
    """The coil's axis is column z of the rotation matrix that belongs to the quaternion."""
    w, x, y, z = quaternion = (v := np.random.default_rng(0).normal(size=4)) / np.linalg.norm(v)
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z])
    coil = Transform(tuple(quaternion.tolist()), (10.0, -20.0, 30.0), 0.1)

    assert np.array(coil.ahead(4.0)) == pytest.approx(np.array(coil.position) + 4.0 * axis)
    assert np.linalg.norm(np.subtract(coil.ahead(4.0), coil.position)) == pytest.approx(4.0)
    assert coil.ahead(0.0) == coil.position


def test_driver_measures_the_tip_with_a_coil_behind_it():
    """The simulated coil points along the generator's z axis, which points down."""
    read = AuroraBench(AuroraSettings(coil_to_tip=4.0)).run(1.0)
    assert read
    for _, reading in read:
        assert reading.position == pytest.approx(REST - np.array([0.0, 0.0, 0.004]), abs=1e-7)


def test_driver_measures_the_coils_direction_unless_disabled():
    (_, reading), *_ = AuroraBench().run(1.0)
    assert reading.direction == pytest.approx(GENERATOR_POSE.rotation[:, 2], abs=1e-6)
    (_, reading), *_ = AuroraBench(AuroraSettings(measures_axis=False)).run(1.0)
    assert reading.direction is None
