"""The library liblsl receives the streams, through pylsl's inlet; the sender uses the same library."""

import time

import numpy as np
import pylsl
import pytest

from station.control.states import State
from tests.harness.gateway import MEASURED, gateway
from web.gateway.options import GatewayOptions
from web.gateway.snapshot import StationInfo


def test_lsl_rows_and_events_arrive_with_names_units_and_times() -> None:
    with gateway(GatewayOptions(lsl=True)) as running:
        rows, events = (_inlet(name) for name in ("ctr-station", "ctr-station events"))
        info, channels = rows.info(30.0), running.feed.channels
        assert info.get_channel_labels() == [channel.name for channel in channels.all]
        assert info.get_channel_units() == [channel.unit or "none" for channel in channels.all]
        assert (info.nominal_srate(), info.type(), info.channel_format()) == (500.0, "Telemetry", pylsl.cf_double64)
        assert events.info(30.0).type() == "Markers"
        rows.open_stream(30.0)
        events.open_stream(30.0)
        samples, times = [], []
        while len(samples) < 1000:
            more, when = rows.pull_chunk(timeout=1.0, max_samples=1000)
            samples += list(more)
            times += list(when)
        # Every row arrives unchanged and in order, because the writer numbers the rows.
        first = round(samples[0][0] / 0.002)
        for number, sample in enumerate(samples[:50]):
            assert np.array_equal(sample, running.feed.row(first + number))
        assert list(channels.of(np.array(samples[-1]), "tip_measured")) == list(MEASURED)
        assert np.diff([sample[0] for sample in samples]) == pytest.approx(0.002)
        # The times are those of LSL's clock, which differs from the wall clock.
        assert abs(pylsl.local_clock() - times[-1]) < 5.0
        assert np.all(np.diff(times) > 0.0)
        for told, text in (
            (StationInfo(State.HOLD, "der Taster löst aus"), "HOLD: der Taster löst aus"),
            (StationInfo(), "OFF"),
        ):
            running.tell(told)
            marker, when = events.pull_sample(timeout=30.0)
            while marker[0] != text:
                marker, when = events.pull_sample(timeout=30.0)
            assert abs(pylsl.local_clock() - when) < 30.0
        del rows, events


def _inlet(name: str) -> pylsl.StreamInlet:
    deadline = time.monotonic() + 30.0
    while not (found := pylsl.resolve_byprop("name", name, 1, 1.0)):
        assert time.monotonic() < deadline, f"no stream {name}"
    return pylsl.StreamInlet(found[0])
