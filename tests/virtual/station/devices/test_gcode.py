"""Special features of G-code boards, simulated in virtual time: planner queue, alarms and restarts."""

import numpy as np
import pytest

from station.devices.interfaces import Condition, Severity
from station.lab.simulated_line import Faults
from tests.harness.stages_bench import StagesBench

SPEEDS = [0.3, -0.3, 0.015]


@pytest.fixture(params=["grbl", "marlin"])
def bench(paper, request) -> StagesBench:
    return StagesBench(paper, request.param).connect().run(1.0, lambda now: SPEEDS)


def time_to_fault(bench: StagesBench) -> float:
    start = bench.now
    bench.run(1.0, lambda now: SPEEDS, until=lambda: bench.stages.condition is Condition.FAULT)
    return bench.now - start


def test_stop_empties_a_full_planner_within_100_ms(bench):
    # The planner is filled with 16 motions of 0.1 s each, as another program may do.
    for number in range(1, 19):
        degrees = f"{4.0 + number:.2f}"
        line = f"$J=G53X{degrees}F600\n" if bench.simulated.dialect == "grbl" else f"G1 X{degrees} F600\n"
        bench.simulated.receive(line.encode(), bench.now)
        bench.let_pass()
    assert bench.simulated.planner.full
    start = bench.now
    bench.stages.stop(bench.now)
    bench.run(2.0, until=lambda: not bench.simulated.planner.moving)
    assert bench.now - start <= 0.1
    bench.run(0.2)
    assert not bench.simulated.planner.moving


def test_restart_of_the_board_replaces_its_silence_as_cause_of_the_fault(bench):
    bench.simulated.power_cycle(1)
    time_to_fault(bench)
    assert "no answer of the board" in bench.cause
    bench.run(1.0, lambda now: SPEEDS)
    assert bench.cause.startswith("the board has reset itself and lost its position; ")
    assert not any(bench.stages.details()[name]["homed"] for name in ("outer_rotation", "inner_translation"))
    assert bench.connect().stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready


@pytest.mark.parametrize("dialect", ["grbl", "marlin"])
def test_board_that_restarts_while_it_is_connected_is_set_up_again(paper, dialect):
    bench = StagesBench(paper, dialect)
    bench.stages.connect(bench.now)
    bench.run(0.05)
    bench.simulated.power_cycle(1)
    bench.run(10.0, until=lambda: bench.stages.condition is not Condition.CONNECTING)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready


def test_false_banner_is_a_fault_after_which_the_board_connects_again(bench):
    banner = b"Grbl 1.1h ['$' for help]" if bench.simulated.dialect == "grbl" else b"start"
    bench.host.device.to_host.extend(b"\r\n" + banner + b"\r\n")
    time_to_fault(bench)
    assert bench.cause.startswith("the board has reset itself")
    assert bench.connect().stages.condition is Condition.CONNECTED, bench.cause


def test_unfinished_line_is_not_executed_when_the_board_is_connected_again(bench):
    bench.stages.stop(bench.now)
    bench.run(0.3)
    before = bench.positions
    part = b"$J=G53X90.0000Y1.0000F999" if bench.simulated.dialect == "grbl" else b"N9 G1 X90.0000 Y1.0000 F999"
    bench.simulated.receive(part, bench.now)
    bench.connect()
    assert bench.stages.ready, bench.cause
    assert bench.positions.tolist() == before.tolist()


def test_board_connects_although_replies_are_lost(bench):
    lost = 0

    def lose() -> bool:
        nonlocal lost
        if lost < 3 and (at := bench.host.device.to_host.find(b"ok\r\n")) >= 0:
            del bench.host.device.to_host[at : at + 4]
            lost += 1
        return bench.stages.condition is not Condition.CONNECTING

    bench.stages.connect(bench.now)
    bench.run(20.0, until=lose)
    assert lost == 3
    assert bench.stages.ready, bench.cause


def test_driver_rejects_one_wrong_position_in_a_valid_format(bench):
    bench.stages.stop(bench.now)
    bench.run(0.5)
    before = bench.reading.positions
    status = "<Idle|MPos:{0:.3f},{0:.3f},{0:.3f}|FS:0,0>\r\n"
    reply = "X:{0:.2f} Y:{0:.2f} Z:{0:.2f} Count X:{1} Y:{1} Z:{1}\r\nok\r\n"
    text = status if bench.simulated.dialect == "grbl" else reply
    bench.host.device.to_host.extend(text.format(12.0, 51200).encode())
    bench.run(0.002)
    assert bench.reading.positions.tolist() == before.tolist()
    bench.run(0.5)
    assert bench.reading.positions == pytest.approx(bench.positions, abs=1e-5)
    assert bench.stages.condition is Condition.CONNECTED, bench.cause


def test_board_that_repeats_a_wrong_position_is_a_fault_that_names_the_joint(bench):
    bench.simulated.planner.position[0] += 20.0  # another program has set the coordinate
    time_to_fault(bench)
    assert "outer_rotation" in bench.cause
    assert "does not move" in bench.cause


def test_alarm_of_grbl_is_a_fault_with_its_number_and_the_makers_meaning(paper):
    bench = StagesBench(paper, "grbl").connect().run(1.0, lambda now: SPEEDS)
    bench.simulated.raise_alarm(3)
    assert time_to_fault(bench) <= 0.3
    assert "the board reports: reset during a motion, the position is lost (ALARM:3)" in bench.cause
    bench.connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert not bench.stages.ready


def test_halt_of_marlin_is_a_fault_with_its_text(paper):
    bench = StagesBench(paper, "marlin").connect().run(1.0, lambda now: SPEEDS)
    bench.simulated.raise_alarm(1)
    assert time_to_fault(bench) <= 0.3
    assert "the board reports: Printer halted. kill() called!" in bench.cause


def test_segments_that_grbl_rejects_are_a_fault_with_the_error_and_its_meaning(paper):
    bench = StagesBench(paper, "grbl").connect()
    bench.simulated.settings |= {20: 1.0, 130: 1.0}  # soft limits at 1 degree of X
    bench.run(2.0, lambda now: SPEEDS)
    assert "the board rejects its motions: the target is outside the board's travel ($130 to $132) (error:15)" in (
        bench.cause
    )


def test_setting_that_only_the_operator_may_change_is_named_with_its_value(paper):
    bench = StagesBench(paper, "grbl")
    bench.simulated.settings[101] = 80.0
    assert "$101 of inner_rotation is 80 steps per unit" in bench.connect().cause


def test_marlin_that_is_busy_with_a_long_homing_stays_connected(paper):
    bench = StagesBench(paper, "marlin", homed=False).connect()
    received = bytearray()

    def over() -> bool:
        received.extend(bench.host.device.to_host)
        return bench.stages.condition is not Condition.HOMING

    bench.stages.home(bench.now)
    bench.run(600.0, until=over)
    assert received.count(b"echo:busy: processing") >= 2
    assert bench.stages.ready, bench.cause


def test_line_that_marlin_requests_again_is_sent_again_while_the_stages_move(paper):
    bench = StagesBench(paper, "marlin").connect().run(1.0, lambda now: SPEEDS)
    received, worst = bytearray(), np.zeros(3)
    for number in range(600):
        received.extend(bench.host.device.to_host)
        truth = bench.positions
        worst = np.maximum(worst, np.abs(bench.stages.poll(bench.now).positions - truth))
        bench.stages.command(np.array(SPEEDS), bench.now)
        sent = bench.host.device.to_device
        if number % 50 < 8 and b"G1" in sent and b"Resend" not in bench.host.device.to_host:
            sent[sent.index(b"G1") + 4] ^= 1  # one bit of the segment's first number
        bench.let_pass()
    assert received.count(b"Resend:") >= 12
    assert bench.stages.condition is Condition.CONNECTED, bench.cause
    assert (worst < [0.01, 0.01, 0.0005]).all()


def test_marlin_without_emergency_parser_is_a_warning_when_connecting(paper):
    bench = StagesBench(paper, "marlin")
    bench.simulated.emergency_parser = False
    bench.connect()
    fault = bench.stages.trouble(bench.now)
    assert fault is not None
    assert fault.severity is Severity.WARN
    assert "the firmware has no EMERGENCY_PARSER, so a stop waits for earlier lines" in fault.text
    assert bench.stages.ready


def test_marlin_that_reports_the_end_of_its_queue_as_its_position_is_a_fault(paper):
    bench = StagesBench(paper, "marlin")
    bench.simulated.realtime_position = False
    bench.connect()
    time_to_fault(bench)
    assert "build the firmware with M114_REALTIME" in bench.cause


def test_axes_stop_within_100_ms_when_the_positions_are_missing(bench):
    bench.simulated.faults = Faults(mute=frozenset({1}))
    start = bench.now
    bench.run(0.5, lambda now: SPEEDS, until=lambda: not bench.simulated.planner.moving)
    assert bench.now - start <= 0.1
    bench.run(0.5, lambda now: SPEEDS)
    assert bench.stages.condition is Condition.FAULT
    assert "outer_rotation cannot be reached; last seen at" in bench.cause
