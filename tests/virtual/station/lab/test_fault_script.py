"""Faults injected at the simulated devices, seen from the other end of the wire in memory."""

import math
from itertools import pairwise

import numpy as np
import pytest

from station.config.strict import ConfigError
from station.devices.aurora.measurement import Quality
from station.devices.aurora.tracker import AuroraTracker
from station.devices.links.link import LinkError, reopen
from station.devices.netft.protocol import SATURATED, Command, Record, records, request
from station.devices.zaber.protocol import Command as Zaber
from station.devices.zaber.protocol import Message, Parser, encode
from station.lab.aurora.coil import MOUNT
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.simulated_bench import SimulatedBench

TICK = 0.002
AT = np.array([0.05, 0.30, -0.125])
POSITIONS = encode(Message(0, Zaber.POSITION, 0))


class Wire:
    """A lab and, at the other ends of its wires, no driver but for the tracker's, whose frames have to be asked for."""

    def __init__(self, robot) -> None:
        self.lab = SimulatedBench(robot, LabConfig(), 3, AT, homed=True)
        self.zaber, self.boxes = self.lab.hosts.zaber, self.lab.hosts.netft
        self.tracker = AuroraTracker(self.lab.hosts.aurora, registration=MOUNT)
        self.divisor = self.lab.boxes[0].settings.divisor
        self.rate = 7000.0 / self.divisor  # records a second
        self.parser = Parser()
        self.now = 0.0
        self.messages: list[tuple[float, Message]] = []
        self.records: list[list[Record]] = [[], []]
        self.frames = 0
        for box in self.boxes:
            box.send(request(Command.STREAM))

    def run(self, seconds: float) -> "Wire":
        for _ in range(round(seconds / TICK)):
            self.now += TICK
            self.lab.advance(self.now)
            self.listen()
        return self

    def listen(self) -> None:
        try:
            self.messages += [(self.now, m) for m in self.parser.feed(self.zaber.read(), self.now)]
        except LinkError:
            self.messages.append((self.now, Message(0, 0, 0)))
        self.frames += self.tracker.poll(self.now) is not None
        for heard, box in zip(self.records, self.boxes, strict=True):
            heard += [record for datagram in box.receive() for record in records(datagram) or []]

    def fresh(self) -> "Wire":
        self.messages, self.records, self.frames = [], [[], []], 0
        return self

    def inject(self, kind: str, device: str, **more: float) -> "Wire":
        self.lab.inject([LabFault(kind=kind, device=device, **more)], self.now)
        return self

    def ask(self) -> list[int]:
        """Which units tell their position when all are asked."""
        self.fresh().zaber.write(POSITIONS)
        self.run(0.1)
        return [m.device for _, m in self.messages if m.command == Zaber.POSITION]

    @property
    def quality(self) -> Quality:
        return self.tracker.report(self.now).quality


@pytest.fixture
def wire(paper) -> Wire:
    """Everything answers."""
    wire = Wire(paper).run(2.0)
    assert wire.ask() == [1, 2, 3]
    assert wire.fresh().run(0.5).frames == pytest.approx(20, abs=1)
    assert [len(heard) for heard in wire.records] == [pytest.approx(0.5 * wire.rate, abs=2)] * 2
    assert all(record.status == 0 for heard in wire.records for record in heard)
    return wire.fresh()


def test_nothing_is_looked_at_while_nothing_is_due(wire):
    assert wire.lab.faults.due == math.inf
    assert wire.lab.faults.active == ()


def test_a_fault_comes_at_its_time_and_goes_after_its_duration(wire):
    begin = wire.now
    wire.lab.inject([LabFault(kind="saturate", device="inner", at=0.1, duration=0.2)], begin)
    wire.run(0.5)
    spoilt = [record.ft_sequence for record in wire.records[0] if record.status & SATURATED]
    assert len(spoilt) == pytest.approx(0.2 * wire.rate, abs=2)
    assert spoilt == list(range(spoilt[0], spoilt[-1] + 1, wire.divisor))  # one run of samples
    first = wire.records[0][0].ft_sequence
    assert (spoilt[0] - first) / 7000.0 == pytest.approx(0.1, abs=2 * TICK)
    assert not any(record.status for record in wire.records[1])
    assert wire.lab.faults.due == math.inf


def test_new_faults_replace_the_old_ones(wire):
    wire.inject("mute", "stages")
    assert wire.ask() == []
    wire.inject("mute", "tracker", at=0.3)
    assert wire.ask() == [1, 2, 3]
    wire.lab.inject((), wire.now)
    wire.run(0.5)
    assert wire.quality is Quality.GOOD


def test_what_cannot_happen_is_refused_and_what_happens_goes_on(wire):
    wire.inject("mute", "stages").run(0.01)
    with pytest.raises(ConfigError, match="device = 'middle'"):
        wire.inject("stall", "middle")
    assert wire.ask() == []


# Stages


@pytest.mark.parametrize(("device", "heard"), [("outer_rotation", [2, 3]), ("inner_rotation", [1, 3]), ("stages", [])])
def test_mute_units_do_not_answer(wire, device, heard):
    wire.inject("mute", device, duration=0.5).run(0.01)
    assert wire.ask() == heard
    wire.run(0.5)
    assert wire.ask() == [1, 2, 3]


@pytest.mark.parametrize(
    ("device", "heard"), [("outer_rotation", []), ("inner_rotation", [1]), ("inner_translation", [1, 2])]
)
def test_a_cable_of_the_chain_cuts_off_those_behind_it(wire, device, heard):
    wire.inject("disconnect", device).run(0.01)
    assert wire.ask() == heard


def test_the_chains_port_is_gone_until_it_is_plugged_in_and_opened_again(wire):
    wire.inject("disconnect", "stages", duration=0.5).run(0.01)
    for use in (wire.zaber.read, lambda: wire.zaber.write(POSITIONS), lambda: reopen(wire.zaber)):
        with pytest.raises(LinkError):
            use()
    wire.run(0.5)
    with pytest.raises(LinkError):
        wire.zaber.read()
    reopen(wire.zaber)
    assert wire.ask() == [1, 2, 3]


def test_a_delayed_reply_comes_later_by_as_much(wire):
    def arrival() -> float:
        asked = wire.now
        wire.fresh().zaber.write(encode(Message(1, Zaber.POSITION, 0)))
        wire.run(0.2)
        return wire.messages[0][0] - asked

    usual = arrival()
    wire.inject("delay", "stages", value=0.05).run(0.01)
    assert arrival() - usual == pytest.approx(0.05, abs=1.5 * TICK)


@pytest.mark.parametrize("kind", ["drop_bytes", "flip_bits"])
def test_a_disturbed_line_spoils_replies(wire, kind):
    before = wire.parser.dropped
    sound = sum(wire.ask() == [1, 2, 3] for _ in range(10))
    assert (sound, wire.parser.dropped) == (10, before)
    wire.inject(kind, "stages", value=0.05).run(0.01)
    assert sum(wire.ask() == [1, 2, 3] for _ in range(10)) < 5


def test_a_stalled_motor_counts_on_and_stays(wire):
    wire.inject("stall", "inner_translation").run(0.01)
    before = wire.lab.positions
    wire.zaber.write(encode(Message(3, Zaber.MOVE_SPEED, 1000)))
    wire.run(0.5)
    told = [m.data for _, m in wire.fresh().run(0.0).messages]
    assert told == []
    assert np.array_equal(wire.lab.positions, before)
    wire.fresh().zaber.write(encode(Message(3, Zaber.POSITION, 0)))
    wire.run(0.05)
    counted = wire.messages[-1][1].data * 0.49609375e-6 - 0.130
    assert counted - before[2] > 1e-3


def test_a_restarted_unit_has_lost_its_position(wire):
    wire.inject("restart", "inner_rotation").run(1.0)
    assert wire.ask() == [1, 2, 3]
    positions = {m.device: m.data for _, m in wire.messages}
    assert positions[2] == 0
    assert positions[1] > 1_000_000
    assert wire.lab.faults.active == ()


# Tracker


@pytest.mark.parametrize(
    ("kind", "quality"),
    [
        ("mute", Quality.CONNECTING),
        ("lose_tool", Quality.MISSING),
        ("unplug", Quality.DISABLED),
        ("disconnect", Quality.LOST),
    ],
)
def test_a_lost_tracker_gives_no_frames(wire, kind, quality):
    wire.inject(kind, "tracker", duration=2.0).run(1.9)
    assert wire.frames <= 2  # those that had been measured before
    assert wire.quality is quality
    if kind == "disconnect":
        wire.run(0.2)
        wire.tracker.attach(reopen(wire.lab.hosts.aurora))
    wire.run(6.0).fresh().run(0.5)
    assert wire.quality is Quality.GOOD
    assert wire.frames == pytest.approx(20, abs=1)


def test_a_tracker_that_stands_still_repeats_its_frame(wire):
    wire.inject("freeze", "tracker", duration=0.5).run(0.49)
    assert wire.frames <= 2
    repeated = wire.tracker.report(wire.now).counts.repeated
    assert wire.quality is Quality.SILENT
    assert repeated > 20
    wire.run(0.2).fresh().run(0.5)
    assert wire.quality is Quality.GOOD
    assert wire.frames == pytest.approx(20, abs=1)


def test_a_jump_is_a_coil_elsewhere(wire):
    assert wire.run(0.1).quality is Quality.GOOD
    wire.fresh().inject("jump", "tracker", value=0.05).run(0.15)
    assert wire.quality is Quality.JUMP
    assert wire.frames <= 2  # from before
    wire.inject("jump", "tracker", value=0.05, duration=0.1, at=0.1).run(0.3)
    assert wire.quality is Quality.GOOD


def test_a_disturbed_trackers_line_costs_frames(wire):
    wire.inject("flip_bits", "tracker", value=0.005).run(2.0)
    assert 5 < wire.frames < 75


def test_a_delayed_tracker_is_slower(wire):
    wire.inject("delay", "tracker", value=0.04).run(1.0)
    assert wire.frames == pytest.approx(21, abs=2)  # of 40: one question and its answer at a time


def test_a_restarted_tracker_is_set_up_again(wire):
    before = wire.tracker.report(wire.now).counts.connects
    wire.inject("restart", "tracker").run(8.0)
    assert wire.quality is Quality.GOOD
    assert wire.tracker.report(wire.now).counts.connects == before + 1


# Force sensors


def test_a_saturated_sensor_says_so(wire):
    wire.inject("saturate", "sensors").run(0.1)
    for heard in wire.records:
        assert all(record.status & SATURATED for record in heard[5:])


@pytest.mark.parametrize("kind", ["mute", "disconnect"])
def test_a_sensor_that_is_cut_off_sends_nothing(wire, kind):
    wire.inject(kind, "outer", duration=0.5).run(0.4)
    assert len(wire.records[0]) == pytest.approx(0.4 * wire.rate, abs=2)
    assert len(wire.records[1]) <= 1
    assert wire.lab.boxes[1].page() is None
    wire.fresh().run(0.5)
    assert len(wire.records[1]) == pytest.approx(0.4 * wire.rate, abs=3)  # the box has gone on sending


def test_a_bad_status_is_an_error_that_is_no_saturation(wire):
    wire.inject("bad_status", "inner").run(0.1)
    last = wire.records[0][-1].status
    assert last >> 31
    assert not last & SATURATED


def test_a_frozen_sensor_repeats_itself(wire):
    wire.inject("freeze", "inner").run(0.2)
    assert len({record.ft_sequence for record in wire.records[0][5:]}) == 1
    assert len({record.ft_sequence for record in wire.records[1]}) == len(wire.records[1])


def test_lost_datagrams_leave_gaps(wire):
    wire.inject("drop_bytes", "inner", value=0.5).run(1.0)
    assert 0.4 * wire.rate < len(wire.records[0]) < 0.6 * wire.rate
    assert len(wire.records[1]) == pytest.approx(wire.rate, abs=2)


def test_a_turned_bit_reaches_the_host(wire):
    wire.inject("flip_bits", "inner", value=1.0).run(0.2)
    spoilt, sound = (heard[5:] for heard in wire.records)

    def in_a_row(heard: list[Record]) -> int:
        return sum(b.rdt_sequence - a.rdt_sequence == 1 for a, b in pairwise(heard))

    assert in_a_row(sound) == len(sound) - 1
    assert in_a_row(spoilt) < len(spoilt) - 1


def test_a_delayed_sensors_records_come_later(wire):
    def behind() -> float:
        first, second = (heard[-1].ft_sequence for heard in wire.records)
        return (second - first) / 7000.0

    wire.run(0.1)
    usual = behind()
    wire.inject("delay", "inner", value=0.05).run(0.2)
    assert behind() - usual == pytest.approx(0.05, abs=2 * TICK)


def test_a_restarted_box_has_forgotten_its_stream(wire):
    wire.inject("restart", "inner").run(0.3)
    assert len(wire.records[0]) <= 1
    wire.boxes[0].send(request(Command.STREAM))
    wire.run(0.1)
    assert wire.records[0][-1].ft_sequence < 7000  # its counter began anew


# All together


def test_the_same_seed_disturbs_the_same(paper):
    def heard() -> list[tuple[float, Message]]:
        wire = Wire(paper).inject("drop_bytes", "stages", value=0.1)
        for _ in range(10):
            wire.zaber.write(POSITIONS)
            wire.run(0.05)
        return wire.messages

    first = heard()
    assert first == heard()
    assert 0 < len(first) < 30
