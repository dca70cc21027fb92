"""Injected faults reach the named simulated devices at their times; the tests of each device show their effects."""

import math

import numpy as np
import pytest

from station.config.strict import ConfigError
from station.devices.ati.protocol import RdtCommand, request
from station.devices.links.link import LinkError, reopen
from station.devices.zaber.protocol import ZaberCommand, ZaberMessage, encode
from station.lab.config import LabConfig
from station.lab.faults import ANALOG_BOARD, LabFault
from station.lab.simulated_aurora import POWER_UP_BAUD, AuroraFaults
from station.lab.simulated_bench import SimulatedBench
from station.lab.simulated_line import Faults
from station.lab.simulated_netft import NetftFaults
from tests.harness.netft_bench import records

TICK = 0.002
AT = np.array([0.05, 0.30, -0.125])
OUTER, INNER = 1, 0  #: indices of the force sensors


@pytest.fixture
def lab(paper) -> SimulatedBench:
    lab = SimulatedBench(paper, LabConfig(), 3, AT, homed=True)
    run(lab, 0.1)
    return lab


def run(lab: SimulatedBench, seconds: float) -> None:
    start = lab.time
    for number in range(1, round(seconds / TICK) + 1):
        lab.advance(start + number * TICK)


def inject(lab: SimulatedBench, kind: str, device: str, **more: float) -> None:
    lab.inject([LabFault(kind=kind, device=device, **more)], lab.time)
    run(lab, 2 * TICK)


def present(lab: SimulatedBench) -> list[object]:
    """Return the active faults of stages, tracker and force sensors."""
    return [lab.chain.faults, lab.aurora.faults, *(box.faults for box in lab.boxes)]


HEALTHY = [Faults(), AuroraFaults(), NetftFaults(), NetftFaults()]


def with_faults(**changes: object) -> list[object]:
    """Return the faults of all devices, healthy except for the given ones."""
    names = ("stages", "tracker", "inner", "outer")
    return [changes.get(name, healthy) for name, healthy in zip(names, HEALTHY, strict=True)]


@pytest.mark.parametrize(
    ("kind", "device", "value", "expected"),
    [
        ("mute", "stages", None, with_faults(stages=Faults(mute=frozenset({1, 2, 3})))),
        ("mute", "inner_rotation", None, with_faults(stages=Faults(mute=frozenset({2})))),
        ("stall", "inner_translation", None, with_faults(stages=Faults(stalled=frozenset({3})))),
        ("disconnect", "inner_rotation", None, with_faults(stages=Faults(cut=2))),
        ("drop_bytes", "stages", 0.1, with_faults(stages=Faults(drop=0.1))),
        ("flip_bits", "stages", 0.1, with_faults(stages=Faults(flip=0.1))),
        ("delay", "stages", 0.05, with_faults(stages=Faults(delay=0.05))),
        ("mute", "tracker", None, with_faults(tracker=AuroraFaults(mute=True))),
        ("lose_tool", "tracker", None, with_faults(tracker=AuroraFaults(tool_lost=True))),
        ("lose_target", "tracker", None, with_faults(tracker=AuroraFaults(target_lost=True))),
        ("freeze", "tracker", None, with_faults(tracker=AuroraFaults(freeze=True))),
        ("jump", "tracker", 0.05, with_faults(tracker=AuroraFaults(jump=0.05))),
        ("noise", "tracker", 0.002, with_faults(tracker=AuroraFaults(noise=0.002))),
        ("flip_bits", "tracker", 0.1, with_faults(tracker=AuroraFaults(flip=0.1))),
        ("delay", "tracker", 0.04, with_faults(tracker=AuroraFaults(delay=0.04))),
        ("saturate", "sensors", None, with_faults(inner=NetftFaults(saturate=True), outer=NetftFaults(saturate=True))),
        ("disconnect", "outer", None, with_faults(outer=NetftFaults(mute=True))),
        ("mute", "outer", None, with_faults(outer=NetftFaults(mute=True))),
        ("bad_status", "inner", None, with_faults(inner=NetftFaults(status=ANALOG_BOARD))),
        ("freeze", "inner", None, with_faults(inner=NetftFaults(freeze=True))),
        ("drop_bytes", "inner", 0.5, with_faults(inner=NetftFaults(drop=0.5))),
        ("flip_bits", "inner", 1.0, with_faults(inner=NetftFaults(flip=1.0))),
        ("delay", "inner", 0.05, with_faults(inner=NetftFaults(delay=0.05))),
    ],
)  # fmt: skip
def test_injected_fault_affects_the_named_devices_until_its_end(lab, kind, device, value, expected):
    inject(lab, kind, device, value=value, duration=0.1)
    assert present(lab) == expected
    run(lab, 0.11)
    assert present(lab) == HEALTHY
    assert (lab.faults.due, lab.faults.active) == (math.inf, ())


def test_injected_fault_starts_at_its_time_and_ends_after_its_duration(lab):
    divisor = lab.boxes[INNER].settings.divisor
    host = lab.hosts.netft[INNER]
    host.send(request(RdtCommand.STREAM))
    run(lab, 0.1)
    host.receive()
    lab.inject([LabFault(kind="saturate", device="inner", at=0.1, duration=0.2)], lab.time)
    run(lab, 0.5)
    received = [record for datagram in host.receive() for record in records(datagram) or []]
    spoilt = [record.ft_sequence for record in received if record.status]
    assert len(spoilt) == pytest.approx(0.2 * 7000.0 / divisor, abs=2)
    assert spoilt == list(range(spoilt[0], spoilt[-1] + 1, divisor))  # the affected samples are consecutive
    assert (spoilt[0] - received[0].ft_sequence) / 7000.0 == pytest.approx(0.1, abs=2 * TICK)


def test_newly_injected_faults_replace_the_old_ones(lab):
    inject(lab, "mute", "stages")
    inject(lab, "mute", "tracker", at=0.3)
    assert present(lab) == HEALTHY
    lab.inject((), lab.time)
    run(lab, 0.5)
    assert present(lab) == HEALTHY


def test_impossible_injected_fault_is_refused_and_active_faults_continue(lab):
    inject(lab, "stall", "inner_rotation")
    with pytest.raises(ConfigError, match="device = 'middle'"):
        inject(lab, "stall", "middle")
    assert present(lab) == with_faults(stages=Faults(stalled=frozenset({2})))


@pytest.mark.parametrize(("device", "host"), [("stages", "stages"), ("tracker", "aurora")])
def test_port_is_gone_until_it_is_plugged_in_and_reopened(lab, device, host):
    port = getattr(lab.hosts, host)
    inject(lab, "disconnect", device, duration=0.5)
    for use in (port.read, lambda: port.write(b"x"), lambda: reopen(port)):
        with pytest.raises(LinkError):
            use()
    run(lab, 0.5)
    with pytest.raises(LinkError):
        port.read()
    reopen(port)
    port.write(b"x")


def test_plug_of_the_coil_is_pulled_and_plugged_in_again(lab):
    inject(lab, "unplug", "tracker", duration=0.1)
    assert [port.gone for port in lab.aurora.handles.ports] == [True]
    run(lab, 0.11)
    assert [port.gone for port in lab.aurora.handles.ports] == [True, False]


def test_restarted_devices_have_lost_their_state(lab):
    before = [unit.position for unit in lab.chain.units]
    inject(lab, "restart", "inner_rotation")
    assert [unit.position for unit in lab.chain.units] == [before[0], 0, before[2]]
    lab.aurora.baud = 115200
    inject(lab, "restart", "tracker")
    assert lab.aurora.baud == POWER_UP_BAUD
    lab.hosts.netft[OUTER].send(request(RdtCommand.STREAM))
    run(lab, 0.1)
    assert lab.hosts.netft[OUTER].receive()
    inject(lab, "restart", "outer")
    lab.hosts.netft[OUTER].receive()
    run(lab, 0.1)
    assert lab.hosts.netft[OUTER].receive() == []
    assert present(lab) == HEALTHY
    assert lab.faults.active == ()


def test_same_seed_gives_the_same_disturbances_on_the_wires(paper):
    def received() -> bytes:
        lab = SimulatedBench(paper, LabConfig(), 3, AT, homed=True)
        inject(lab, "drop_bytes", "stages", value=0.1)
        data = b""
        for _ in range(10):
            lab.hosts.stages.write(encode(ZaberMessage(0, ZaberCommand.POSITION, 0)))
            run(lab, 0.05)
            data += lab.hosts.stages.read()
        return data

    first = received()
    assert first == received()
    assert 0 < len(first) < 10 * 18
