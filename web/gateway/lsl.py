"""Lab Streaming Layer: every row of telemetry as a stream, changes of state as markers, by LSL's own clock.

LabRecorder writes them into one XDF file with whatever else the laboratory records.
"""

import time

import numpy as np
import pylsl

from core.robot.robot import Robot
from station.config.controllers import PERIOD
from station.control.clock import StationClock
from station.control.telemetry import Channels
from web.gateway.seen import Look, Told

#: Found by programs of this computer only. What is found is asked for by TCP, on all of the computer's addresses:
#: liblsl has no setting for that.
_CONFIG = "[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n"
#: Kept for one who reads late [s].
_KEPT = 30


class LslOutlet:
    """Two streams: `ctr-station` and `ctr-station events`."""

    def __init__(self, robot: Robot, channels: Channels, clock: StationClock) -> None:
        """Streams of this robot's channels."""
        pylsl.set_config_content(_CONFIG)
        who = f"ctr-station {robot.name}"
        rate = clock.rate / PERIOD
        rows = pylsl.StreamInfo("ctr-station", "Telemetry", len(channels), rate, pylsl.cf_double64, f"{who} telemetry")
        rows.set_channel_labels([channel.name for channel in channels.all])
        rows.set_channel_units([channel.unit or "none" for channel in channels.all])
        rows.desc().append_child_value("frame", "world")
        events = pylsl.StreamInfo(
            "ctr-station events", "Markers", 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, f"{who} events"
        )
        self._rows = pylsl.StreamOutlet(rows, max_buffered=_KEPT)
        self._events = pylsl.StreamOutlet(events, max_buffered=_KEPT)
        self._told: Told | None = None

    @property
    def watched(self) -> bool:
        """Rows go out as they are: nobody has to be drawn for it."""
        return False

    def publish(self, look: Look) -> None:
        """All rows since the last look, each with its time."""
        # LSL's clock and the wall's, at one moment.
        ahead = pylsl.local_clock() - time.time()
        if len(look.rows):
            times = 1e-9 * look.stamps.astype(np.float64) + ahead
            self._rows.push_chunk(look.rows, times.tolist())
        told = look.told
        before, self._told = self._told, told
        if before is None or told.text != before.text:
            self._events.push_sample([told.text], pylsl.local_clock())

    async def close(self) -> None:
        """End both streams."""
        del self._rows, self._events
