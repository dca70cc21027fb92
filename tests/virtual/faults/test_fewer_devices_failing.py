"""Benches with fewer devices: each of their devices fails in each phase of a run, and in a jog.

A lost tracker or force sensor causes HOLD, and lost stages cause FAULT. What can be reached comes to rest, nothing
resumes by itself, and a reset after the repair makes the station READY again.
"""

from collections.abc import Callable

import numpy as np
import pytest

from station.config.motions import CircleMotion, Orders
from station.control.states import State
from station.control.task import MotionTask, Phase
from station.lab.faults import FAULT_KINDS
from tests.harness.virtual_station import VirtualStation
from tests.virtual.station.control.test_fewer_devices import Kind, bench_without

CIRCLE = CircleMotion(radius=0.005, period=10.0)
#: Path of the joints from the usual pose to the start of a run [rad, m].
NEAR = np.array([0.05, -0.05, 0.002])
JOG = np.array([0.1, 0.0, -0.002])


def run(station: VirtualStation, phase: Phase) -> None:
    task = MotionTask(station.loop.controller, Orders(CIRCLE, station.case.robot.robot()), 60.0, station.places + NEAR)
    station.loop.start(task)
    station.until(lambda: station.loop.phase is phase)
    station.seconds(0.04)


def jog(station: VirtualStation) -> None:
    station.loop.jog(station.now, "joints", JOG)
    station.seconds(0.04)


PHASES: dict[str, Callable[[VirtualStation], None]] = {
    "approach": lambda station: run(station, Phase.APPROACHING),
    "settling": lambda station: run(station, Phase.SETTLING),
    "motion": lambda station: run(station, Phase.MOVING),
    "jog": jog,
}


def ends(station: VirtualStation, device: str, state: State, fault: str = "disconnect") -> None:
    """Let a device of a running station fail, and mend it; check that the fault ended the motion for good."""
    assert station.state is State.RUNNING
    station.fail(fault, device)
    # A jog is renewed while its button is pressed; the renewal after the loss is refused.
    if station.loop.phase is Phase.JOGGING:
        station.loop.jog(station.now, "joints", JOG)
    station.becomes(state, 0.4)
    assert station.loop.cause
    cause, since = station.loop.cause, len(station.rows)
    if device != "stages":
        station.seconds(0.2)
        assert station.rests()
    station.mend()
    station.seconds(0.6)
    assert (station.state, station.loop.phase, station.loop.cause) == (state, Phase.NONE, cause)
    assert not station.of("velocity_commanded", station.rows[since + 1 :]).any()


#: Faults after which a device gives no usable measurement: all without a size, but for that of the coil on the target.
FAULTS = [
    (absent, device, kind, phase)
    for absent, device, part in (("sensors", "tracker", "tracker"), ("tracker", "outer", "sensor"))
    for kind, properties in FAULT_KINDS.items()
    if part in properties.parts and properties.maximum is None and kind != "lose_target"
    for phase in (PHASES if kind == "disconnect" else ("motion",))
]


@pytest.mark.parametrize(("absent", "device", "fault", "phase"), FAULTS)
def test_failed_device_of_a_bench_with_fewer_devices_holds_in(
    benches: dict[Kind, VirtualStation], absent: Kind, device: str, fault: str, phase: str
) -> None:
    station = benches[absent]
    PHASES[phase](station.ready())
    ends(station, device, State.HOLD, fault)
    station.loop.reset(station.now)
    station.ready()
    assert station.rests()


@pytest.mark.parametrize("phase", ["approach", "motion", "jog"])
def test_lost_stages_of_a_bench_with_stages_alone_cause_fault_in(phase: str) -> None:
    station = bench_without("tracker", "sensors").ready()
    PHASES[phase](station)
    ends(station, "stages", State.FAULT)
    station.loop.reset(station.now)
    station.becomes(State.CONNECTED)  # the stages, which ran on while they were unplugged, have been stopped
    assert station.rests()


@pytest.fixture(scope="module")
def benches() -> dict[Kind, VirtualStation]:
    """Stations without sensors and without a tracker; each test leaves its station READY."""
    return {"sensors": bench_without("sensors"), "tracker": bench_without("tracker")}
