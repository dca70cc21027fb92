"""Injected faults of the simulated devices, observed at the host ends of wires in memory."""

import math
from itertools import pairwise

import numpy as np
import pytest

from station.config.strict import ConfigError
from station.devices.ati.protocol import SATURATED, RdtCommand, request
from station.devices.aurora.session import FrameQuality
from station.devices.aurora.tracker import AuroraTracker
from station.devices.links.link import LinkError, reopen
from station.devices.zaber.protocol import ZaberCommand as Zaber
from station.devices.zaber.protocol import ZaberMessage, ZaberParser, encode
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.simulated_bench import SimulatedBench
from tests.harness.netft_bench import Record, records

TICK = 0.002
AT = np.array([0.05, 0.30, -0.125])
POSITIONS = encode(ZaberMessage(0, Zaber.POSITION, 0))


class Wire:
    """A lab with plain host ends, except for a tracker driver, because frames need requests."""

    def __init__(self, robot) -> None:
        self.lab = SimulatedBench(robot, LabConfig(), 3, AT, homed=True)
        self.zaber, self.boxes = self.lab.hosts.stages, self.lab.hosts.netft
        self.tracker = AuroraTracker(self.lab.hosts.aurora, registration=GENERATOR_POSE)
        self.divisor = self.lab.boxes[0].settings.divisor
        self.rate = 7000.0 / self.divisor  # records per second
        self.parser = ZaberParser()
        self.now = 0.0
        self.messages: list[tuple[float, ZaberMessage]] = []
        self.records: list[list[Record]] = [[], []]
        self.frames = 0
        for box in self.boxes:
            box.send(request(RdtCommand.STREAM))

    def run(self, seconds: float) -> "Wire":
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            self.lab.advance(self.now)
            self.receive()
        return self

    def receive(self) -> None:
        try:
            self.messages += [(self.now, m) for m in self.parser.feed(self.zaber.read(), self.now)]
        except LinkError:
            self.messages.append((self.now, ZaberMessage(0, 0, 0)))
        self.frames += self.tracker.poll(self.now) is not None
        for received, box in zip(self.records, self.boxes, strict=True):
            received += [record for datagram in box.receive() for record in records(datagram) or []]

    def clear(self) -> "Wire":
        self.messages, self.records, self.frames = [], [[], []], 0
        return self

    def inject(self, kind: str, device: str, **more: float) -> "Wire":
        self.lab.inject([LabFault(kind=kind, device=device, **more)], self.now)
        return self

    def responding_units(self) -> list[int]:
        """Return the numbers of the units that answer a position request to all units."""
        self.clear().zaber.write(POSITIONS)
        self.run(0.1)
        return [m.device for _, m in self.messages if m.command == Zaber.POSITION]

    @property
    def quality(self) -> FrameQuality:
        return self.tracker.report(self.now).quality


@pytest.fixture
def wire(paper) -> Wire:
    """Return the host ends of a lab in which every device answers."""
    wire = Wire(paper).run(2.0)
    assert wire.responding_units() == [1, 2, 3]
    assert wire.clear().run(0.5).frames == pytest.approx(20, abs=1)
    assert [len(received) for received in wire.records] == [pytest.approx(0.5 * wire.rate, abs=2)] * 2
    assert all(record.status == 0 for received in wire.records for record in received)
    return wire.clear()


def test_fault_script_without_faults_is_never_due(wire):
    assert wire.lab.faults.due == math.inf
    assert wire.lab.faults.active == ()


def test_injected_fault_starts_at_its_time_and_ends_after_its_duration(wire):
    start = wire.now
    wire.lab.inject([LabFault(kind="saturate", device="inner", at=0.1, duration=0.2)], start)
    wire.run(0.5)
    spoilt = [record.ft_sequence for record in wire.records[0] if record.status & SATURATED]
    assert len(spoilt) == pytest.approx(0.2 * wire.rate, abs=2)
    assert spoilt == list(range(spoilt[0], spoilt[-1] + 1, wire.divisor))  # the affected samples are consecutive
    first = wire.records[0][0].ft_sequence
    assert (spoilt[0] - first) / 7000.0 == pytest.approx(0.1, abs=2 * TICK)
    assert not any(record.status for record in wire.records[1])
    assert wire.lab.faults.due == math.inf


def test_newly_injected_faults_replace_the_old_ones(wire):
    wire.inject("mute", "stages")
    assert wire.responding_units() == []
    wire.inject("mute", "tracker", at=0.3)
    assert wire.responding_units() == [1, 2, 3]
    wire.lab.inject((), wire.now)
    wire.run(0.5)
    assert wire.quality is FrameQuality.GOOD


def test_impossible_injected_fault_is_refused_and_active_faults_continue(wire):
    wire.inject("mute", "stages").run(0.01)
    with pytest.raises(ConfigError, match="device = 'middle'"):
        wire.inject("stall", "middle")
    assert wire.responding_units() == []


# Stages


@pytest.mark.parametrize(
    ("device", "received"), [("outer_rotation", [2, 3]), ("inner_rotation", [1, 3]), ("stages", [])]
)
def test_mute_stages_do_not_answer(wire, device, received):
    wire.inject("mute", device, duration=0.5).run(0.01)
    assert wire.responding_units() == received
    wire.run(0.5)
    assert wire.responding_units() == [1, 2, 3]


@pytest.mark.parametrize(
    ("device", "received"), [("outer_rotation", []), ("inner_rotation", [1]), ("inner_translation", [1, 2])]
)
def test_disconnected_cable_of_the_chain_cuts_off_the_units_behind_it(wire, device, received):
    wire.inject("disconnect", device).run(0.01)
    assert wire.responding_units() == received


def test_port_of_the_chain_is_gone_until_it_is_plugged_in_and_reopened(wire):
    wire.inject("disconnect", "stages", duration=0.5).run(0.01)
    for use in (wire.zaber.read, lambda: wire.zaber.write(POSITIONS), lambda: reopen(wire.zaber)):
        with pytest.raises(LinkError):
            use()
    wire.run(0.5)
    with pytest.raises(LinkError):
        wire.zaber.read()
    reopen(wire.zaber)
    assert wire.responding_units() == [1, 2, 3]


def test_delay_fault_delays_each_reply_of_the_stages(wire):
    def arrival() -> float:
        requested = wire.now
        wire.clear().zaber.write(encode(ZaberMessage(1, Zaber.POSITION, 0)))
        wire.run(0.2)
        return wire.messages[0][0] - requested

    usual = arrival()
    wire.inject("delay", "stages", value=0.05).run(0.01)
    assert arrival() - usual == pytest.approx(0.05, abs=1.5 * TICK)


@pytest.mark.parametrize("kind", ["drop_bytes", "flip_bits"])
def test_disturbed_line_of_the_stages_corrupts_replies(wire, kind):
    before = wire.parser.dropped
    sound = sum(wire.responding_units() == [1, 2, 3] for _ in range(10))
    assert (sound, wire.parser.dropped) == (10, before)
    wire.inject(kind, "stages", value=0.05).run(0.01)
    assert sum(wire.responding_units() == [1, 2, 3] for _ in range(10)) < 5


def test_stage_with_a_stalled_motor_counts_without_moving(wire):
    wire.inject("stall", "inner_translation").run(0.01)
    before = wire.lab.positions
    wire.zaber.write(encode(ZaberMessage(3, Zaber.MOVE_SPEED, 1000)))
    wire.run(0.5)
    positions = [m.data for _, m in wire.clear().run(0.0).messages]
    assert positions == []
    assert np.array_equal(wire.lab.positions, before)
    wire.clear().zaber.write(encode(ZaberMessage(3, Zaber.POSITION, 0)))
    wire.run(0.05)
    counted = wire.messages[-1][1].data * 0.49609375e-6 - 0.130
    assert counted - before[2] > 1e-3


def test_restarted_stage_has_lost_its_position(wire):
    wire.inject("restart", "inner_rotation").run(1.0)
    assert wire.responding_units() == [1, 2, 3]
    positions = {m.device: m.data for _, m in wire.messages}
    assert positions[2] == 0
    assert positions[1] > 1_000_000
    assert wire.lab.faults.active == ()


# Tracker


@pytest.mark.parametrize(
    ("kind", "quality"),
    [
        ("mute", FrameQuality.CONNECTING),
        ("lose_tool", FrameQuality.MISSING),
        ("unplug", FrameQuality.DISABLED),
        ("disconnect", FrameQuality.LOST),
    ],
)
def test_lost_tracker_gives_no_frames(wire, kind, quality):
    wire.inject(kind, "tracker", duration=2.0).run(1.9)
    assert wire.frames <= 2  # frames that had been measured before the fault
    assert wire.quality is quality
    if kind == "disconnect":
        wire.run(0.2)
        wire.tracker.attach(reopen(wire.lab.hosts.aurora))
    wire.run(6.0).clear().run(0.5)
    assert wire.quality is FrameQuality.GOOD
    assert wire.frames == pytest.approx(20, abs=1)


def test_frozen_tracker_repeats_its_frame(wire):
    wire.inject("freeze", "tracker", duration=0.5).run(0.49)
    assert wire.frames <= 2
    repeated = wire.tracker.details()["repeated"]
    assert wire.quality is FrameQuality.SILENT
    assert repeated > 20
    wire.run(0.2).clear().run(0.5)
    assert wire.quality is FrameQuality.GOOD
    assert wire.frames == pytest.approx(20, abs=1)


def test_jump_offsets_the_position_of_the_coil(wire):
    assert wire.run(0.1).quality is FrameQuality.GOOD
    wire.clear().inject("jump", "tracker", value=0.05).run(0.15)
    assert wire.quality is FrameQuality.JUMP
    assert wire.frames <= 2  # frames that had been measured before the jump
    wire.inject("jump", "tracker", value=0.05, duration=0.1, at=0.1).run(0.3)
    assert wire.quality is FrameQuality.GOOD


def test_disturbed_line_of_the_tracker_loses_frames(wire):
    wire.inject("flip_bits", "tracker", value=0.005).run(2.0)
    assert 5 < wire.frames < 75


def test_delayed_tracker_has_fewer_frames(wire):
    wire.inject("delay", "tracker", value=0.04).run(1.0)
    assert wire.frames == pytest.approx(21, abs=2)  # of 40 frames: the driver waits for each reply


def test_restarted_tracker_is_set_up_again(wire):
    before = wire.tracker.details()["connects"]
    wire.inject("restart", "tracker").run(8.0)
    assert wire.quality is FrameQuality.GOOD
    assert wire.tracker.details()["connects"] == before + 1


# Force sensors


def test_saturated_force_sensor_is_reported(wire):
    wire.inject("saturate", "sensors").run(0.1)
    for received in wire.records:
        assert all(record.status & SATURATED for record in received[5:])


@pytest.mark.parametrize("kind", ["mute", "disconnect"])
def test_disconnected_force_sensor_sends_nothing(wire, kind):
    wire.inject(kind, "outer", duration=0.5).run(0.4)
    assert len(wire.records[0]) == pytest.approx(0.4 * wire.rate, abs=2)
    assert len(wire.records[1]) <= 1
    assert wire.lab.boxes[1].page() is None
    wire.clear().run(0.5)
    assert len(wire.records[1]) == pytest.approx(0.4 * wire.rate, abs=3)  # the box kept its stream during the fault


def test_bad_status_of_a_force_sensor_is_an_error_without_saturation(wire):
    wire.inject("bad_status", "inner").run(0.1)
    last = wire.records[0][-1].status
    assert last >> 31
    assert not last & SATURATED


def test_frozen_force_sensor_repeats_its_sample(wire):
    wire.inject("freeze", "inner").run(0.2)
    assert len({record.ft_sequence for record in wire.records[0][5:]}) == 1
    assert len({record.ft_sequence for record in wire.records[1]}) == len(wire.records[1])


def test_lost_datagrams_leave_gaps_in_the_force_records(wire):
    wire.inject("drop_bytes", "inner", value=0.5).run(1.0)
    assert 0.4 * wire.rate < len(wire.records[0]) < 0.6 * wire.rate
    assert len(wire.records[1]) == pytest.approx(wire.rate, abs=2)


def test_flipped_bit_of_a_force_record_reaches_the_host(wire):
    wire.inject("flip_bits", "inner", value=1.0).run(0.2)
    spoilt, sound = (received[5:] for received in wire.records)

    def in_a_row(received: list[Record]) -> int:
        return sum(b.rdt_sequence - a.rdt_sequence == 1 for a, b in pairwise(received))

    assert in_a_row(sound) == len(sound) - 1
    assert in_a_row(spoilt) < len(spoilt) - 1


def test_delayed_force_sensor_has_later_records(wire):
    def behind() -> float:
        first, second = (received[-1].ft_sequence for received in wire.records)
        return (second - first) / 7000.0

    wire.run(0.1)
    usual = behind()
    wire.inject("delay", "inner", value=0.05).run(0.2)
    assert behind() - usual == pytest.approx(0.05, abs=2 * TICK)


def test_restarted_force_sensor_sends_no_records(wire):
    wire.inject("restart", "inner").run(0.3)
    assert len(wire.records[0]) <= 1
    wire.boxes[0].send(request(RdtCommand.STREAM))
    wire.run(0.1)
    assert wire.records[0][-1].ft_sequence < 7000  # the box's sample counter has restarted


# Faults of all devices together


def test_same_seed_gives_the_same_disturbances_on_the_wires(paper):
    def received() -> list[tuple[float, ZaberMessage]]:
        wire = Wire(paper).inject("drop_bytes", "stages", value=0.1)
        for _ in range(10):
            wire.zaber.write(POSITIONS)
            wire.run(0.05)
        return wire.messages

    first = received()
    assert first == received()
    assert 0 < len(first) < 30
