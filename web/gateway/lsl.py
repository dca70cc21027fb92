"""Lab Streaming Layer (LSL) outlet: one stream of telemetry rows and one of state changes, with times by LSL's clock.

LabRecorder writes both streams into one XDF file together with the other streams of the laboratory.
"""

import time

import numpy as np
import pylsl

from core.robot.robot import Robot
from station.config.controllers import PERIOD_S
from station.control.clock import StationClock
from station.control.telemetry import Channels
from web.gateway.snapshot import Snapshot, StationInfo

#: Configuration of liblsl: the streams can be discovered on this computer only. Their TCP ports still listen on all
#: addresses of the computer, because liblsl has no setting to prevent that.
_CONFIG = "[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n"
#: Time for which data are buffered for a slow reader [s].
_MAX_BUFFERED_S = 30


class LslOutlet:
    """Sender of the two LSL streams `ctr-station` and `ctr-station events`."""

    def __init__(self, robot: Robot, channels: Channels, clock: StationClock) -> None:
        """Open both streams; the first one has a channel for each telemetry channel of this robot."""
        pylsl.set_config_content(_CONFIG)
        source = f"ctr-station {robot.name}"
        rate = clock.rate / PERIOD_S
        rows = pylsl.StreamInfo(
            "ctr-station", "Telemetry", len(channels), rate, pylsl.cf_double64, f"{source} telemetry"
        )
        rows.set_channel_labels([channel.name for channel in channels.all])
        rows.set_channel_units([channel.unit or "none" for channel in channels.all])
        rows.desc().append_child_value("frame", "world")
        events = pylsl.StreamInfo(
            "ctr-station events", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, f"{source} events"
        )
        self._rows = pylsl.StreamOutlet(rows, max_buffered=_MAX_BUFFERED_S)
        self._events = pylsl.StreamOutlet(events, max_buffered=_MAX_BUFFERED_S)
        self._info: StationInfo | None = None

    @property
    def needs_scene(self) -> bool:
        """Whether a client needs the robot's shape: never, because LSL sends the rows unchanged."""
        return False

    def publish(self, snapshot: Snapshot) -> None:
        """Send all rows of a snapshot with their times, and a marker if the state has changed."""
        # Time [s] by which LSL's clock is ahead of the wall clock, which provides the stamps of the rows.
        ahead = pylsl.local_clock() - time.time()
        if len(snapshot.rows):
            times = 1e-9 * snapshot.stamps.astype(np.float64) + ahead
            self._rows.push_chunk(snapshot.rows, times.tolist())
        info = snapshot.info
        before, self._info = self._info, info
        if before is None or info.text != before.text:
            self._events.push_sample([info.text], pylsl.local_clock())

    async def close(self) -> None:
        """Close both streams."""
        del self._rows, self._events
