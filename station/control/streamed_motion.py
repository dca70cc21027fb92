"""Streamed motion: a client sends setpoints of the tip during a run; without messages the run ends."""

from dataclasses import dataclass
from typing import NamedTuple

from core.control.motion_bounds import MotionBounds
from core.control.setpoint_request import DEFAULT_MOTION_BOUNDS, DEFAULT_TURN_BOUNDS, SetpointRequest, StreamedTip
from core.control.trajectories import Setpoint
from core.robot.robot import Array

#: Speed of the position setpoint [m/s] and of the direction setpoint [rad/s] below which the tip counts as at rest.
REST_SPEED_M_S, REST_TURN_RAD_S = 1e-4, 1e-3


class StreamRequest(NamedTuple):
    """Latest request of the client that commands the tip of a run."""

    run: int  #: number of the run
    setpoint: SetpointRequest | None  #: None: the client has disconnected


@dataclass(frozen=True)
class StreamLimits:
    """Bounds and timeouts of a streamed motion, fixed at its start; a streamed task has them in place of orders."""

    bounds: MotionBounds = DEFAULT_MOTION_BOUNDS
    silence: float = 0.2  #: time without a message after which the tip comes to rest [s]
    end: float = 2.0  #: time without a message after which the motion ends [s]
    turning: MotionBounds = (
        DEFAULT_TURN_BOUNDS  #: bounds of the streamed direction's angular velocity and acceleration [rad/s], [rad/s^2]
    )


class StreamedMotion:
    """Motion of a run whose setpoints a client streams."""

    def __init__(self, limits: StreamLimits, start: float, period: float, pointing: Array | None = None) -> None:
        """Start the motion at `start` [s]; a tick takes a `period` [s].

        `pointing` (3,) is the tip's direction at the start; None if the direction is not controlled.
        """
        self._limits, self._period = limits, period
        self._tip = StreamedTip(limits.bounds, limits.turning, pointing)
        self._received = start  # arrival time of the last message, or start of the motion [s]

    def order(self, now: float, blind: float, request: StreamRequest | None) -> Setpoint | None:
        """Return the setpoint of this tick; None after the end of the motion.

        Args:
            now: time [s].
            blind: time without a measurement of the tip [s]; above 0 the tip comes to rest.
            request: latest setpoint request, None before the first one. After a disconnect of the client the tip comes
                to rest and the motion ends.
        """
        setpoint = None if request is None else request.setpoint
        if setpoint is not None:
            self._received = max(self._received, setpoint.time)
        silent = now - self._received
        rests = self._tip.speed < REST_SPEED_M_S and self._tip.turning < REST_TURN_RAD_S
        if (request is not None and setpoint is None and rests) or silent > self._limits.end:
            return None
        return self._tip.advance(now, None if blind > 0.0 or silent > self._limits.silence else setpoint, self._period)
