"""Streams of positions with the sender's `time`, compared with what the client meant and with streams without it."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from core.robot.robot import Array
from station.control.task import StreamedMotion, StreamRequest
from station.service.commands import StreamAgreement
from station.service.setpoint_stream import SetpointStream

PERIOD, DURATION = 0.002, 6.0
#: Shortest transport delay of a message [s].
DELAY = 0.005
#: Time after which a stream is compared: the start from rest is not part of it [s].
SETTLED = 1.2

Network = Callable[[Array, np.random.Generator], Array]
Clock = Callable[[Array, np.random.Generator], Array]


def jitter(longest: float) -> Network:
    return lambda sent, random: random.uniform(0.0, longest, len(sent))


def bursts(interval: float) -> Network:
    """Messages are passed on together, once per interval."""
    return lambda sent, _: np.ceil(sent / interval) * interval - sent


def tails(mean: float) -> Network:
    """Most messages are fast, and a few are very late."""
    return lambda sent, random: np.minimum(random.exponential(mean, len(sent)), 0.3)


def stalls(sent: Array, random: np.random.Generator) -> Array:
    """Every 2 s nothing passes for 0.2 s, otherwise there is jitter."""
    return np.maximum(0.2 - np.mod(sent, 2.0), 0.0) + random.uniform(0.0, 0.03, len(sent))


def longer_route(sent: Array, random: np.random.Generator) -> Array:
    return 0.08 * (sent > 3.0) + random.uniform(0.0, 0.03, len(sent))


def even(sent: Array, _: np.random.Generator) -> Array:
    return np.zeros(len(sent))


def clock(zero: float = 0.0, rate: float = 1.0, step: float = 0.0, resolution: float = 0.0) -> Clock:
    """Return a clock with any zero [s] and rate, which is set at 3 s by `step` [s], with a resolution [s]."""

    def read(sent: Array, _: np.random.Generator) -> Array:
        times = zero + rate * sent + step * (sent > 3.0)
        return np.floor(times / resolution) * resolution if resolution else times

    return read


def wrong_once(by: float) -> Clock:
    return lambda sent, _: sent + by * (np.arange(len(sent)) == np.searchsorted(sent, 2.0))


class Case(NamedTuple):
    """A network and a sender's clock."""

    network: Network
    clock: Clock
    lost: float = 0.0  #: fraction of the messages that are lost
    silence: float = 0.2  #: time without a message after which the tip comes to rest [s]
    gain: float = 1.0  #: largest RMS error on the figure eight, relative to that without times


#: Difference of the RMS error [m], and of the largest error [m], that counts as none.
ALLOWANCE, LARGEST_ALLOWANCE = 3e-5, 2.5e-4

CASES = {
    "even": Case(even, clock()),
    "jitter of 10 ms": Case(jitter(0.01), clock(), gain=0.8),
    "jitter of 30 ms": Case(jitter(0.03), clock(5000.0), gain=0.6),
    "jitter of 60 ms": Case(jitter(0.06), clock(5000.0), gain=0.6),
    "jitter of 90 ms": Case(jitter(0.09), clock(), gain=0.7),
    "jitter of 90 ms, a short silence": Case(jitter(0.09), clock(), silence=0.05, gain=0.7),
    "bursts of 50 ms": Case(bursts(0.05), clock()),
    "bursts of 100 ms": Case(bursts(0.1), clock()),
    "few very late messages": Case(tails(0.02), clock(), gain=0.8),
    "stalls": Case(stalls, clock()),
    "lost messages": Case(jitter(0.06), clock(), lost=0.2, gain=0.9),
    "a longer route": Case(longer_route, clock()),
    "a clock in the future that drifts": Case(jitter(0.03), clock(3600.0, 1.0 + 2e-4), gain=0.6),
    "a clock in the past that drifts": Case(jitter(0.03), clock(-3600.0, 1.0 - 2e-4), gain=0.6),
    "a clock that is set by 1 s": Case(jitter(0.03), clock(step=1.0), gain=0.6),
    "a clock that is set back by 1 s": Case(jitter(0.03), clock(step=-1.0), gain=0.8),
    "a clock that is set back by 80 ms": Case(even, clock(step=-0.08)),
    "a coarse clock": Case(even, clock(resolution=1 / 64)),
    "a coarse clock and jitter": Case(jitter(0.03), clock(resolution=1 / 64)),
    "a clock with whole seconds": Case(even, clock(resolution=1.0)),
    "a clock that does not advance": Case(even, clock(7.0, 0.0)),
    "a clock that does not advance, and jitter": Case(jitter(0.03), clock(7.0, 0.0)),
    "a clock that runs backwards": Case(even, clock(9000.0, -1.0)),
    "a time that is once too late": Case(even, wrong_once(0.08)),
    "a time that is once too early": Case(even, wrong_once(-0.08)),
}


def figure_eight(time: Array) -> Array:
    """Return positions (n, 3) on a figure eight at about 10 mm/s [m]."""
    return np.stack((0.0085 * np.sin(0.8 * time), 0.0045 * np.sin(1.6 * time), np.zeros(len(time))), axis=1)


def ramp(time: Array) -> Array:
    """Return positions (n, 3) on a line at 10 mm/s, which brakes from 4.5 s on and rests from 4.9 s on [m]."""
    braking = np.clip(time - 4.5, 0.0, 0.4)
    return np.outer(0.01 * (np.minimum(time, 4.5) + braking - braking**2 / 0.8), (0.6, 0.0, 0.8))


def errors(case: Case, meant: Callable[[Array], Array], rate: float, *, timed: bool) -> Array:
    """Return the distances (n,) of the setpoint from what the client means at the same time [m]."""
    random = np.random.default_rng(1)
    sent = (np.arange(DURATION * rate) + random.uniform(-0.1, 0.1, int(DURATION * rate))) / rate
    sent = np.maximum(sent, 0.0)[random.random(len(sent)) >= case.lost]
    arrivals = np.maximum.accumulate(sent + DELAY + case.network(sent, random)).tolist()
    times, positions = case.clock(sent, random).tolist(), meant(sent).tolist()
    asked = StreamAgreement(silence=case.silence)
    stream, motion = SetpointStream(asked, np.zeros(3), 0.0), StreamedMotion(asked.limits(), 0.0, PERIOD)
    request, next_message, reached = None, 0, []
    ticks = PERIOD * np.arange(round(DURATION / PERIOD), dtype=np.float64)
    for now in ticks.tolist():
        while next_message < len(arrivals) and arrivals[next_message] <= now:
            k, next_message = next_message, next_message + 1
            request = StreamRequest(1, stream.position(positions[k], arrivals[k], times[k] if timed else None))
        setpoint = motion.order(now, 0.0, request)
        assert setpoint is not None
        reached.append(setpoint.position)
    apart = np.linalg.norm(np.array(reached) - meant(ticks + PERIOD), axis=1)
    return apart[ticks > SETTLED]


def rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


@pytest.mark.parametrize("rate", [20.0, 100.0])
@pytest.mark.parametrize("meant", [figure_eight, ramp])
@pytest.mark.parametrize("name", CASES)
def test_stream_with_times_is_never_farther_from_what_was_meant_than_without(
    name: str, meant: Callable[[Array], Array], rate: float
) -> None:
    case = CASES[name]
    without, timed = (errors(case, meant, rate, timed=timed) for timed in (False, True))
    assert rms(timed) <= (case.gain if meant is figure_eight else 1.0) * rms(without) + ALLOWANCE
    assert timed.max() <= 1.15 * without.max() + LARGEST_ALLOWANCE


def test_message_that_is_later_than_a_tenth_of_a_second_counts_as_a_tenth_late() -> None:
    stream = SetpointStream(StreamAgreement(), np.zeros(3), 0.0)
    stream.position((0.0, 0.0, 0.0), 1.0, 50.0)
    assert stream.position((0.0, 0.0, 0.0), 1.3, 50.1).time == pytest.approx(1.2)


def test_messages_whose_delay_lasts_count_as_on_time_after_a_second() -> None:
    stream, late = SetpointStream(StreamAgreement(), np.zeros(3), 0.0), []
    for k in range(200):
        sent, route = 0.02 * k, 0.08 if k >= 100 else 0.0
        late.append(sent + route - stream.position((0.0, 0.0, 0.0), sent + route, sent).time)
    assert late[:100] == pytest.approx([0.0] * 100, abs=1e-9)
    assert late[100:145] == pytest.approx([0.08] * 45, abs=1e-9)
    assert late[150:] == pytest.approx([0.0] * 50, abs=1e-9)
