"""A driver of one's own: stages behind a box that takes lines `v1 v2 v3` by TCP and sends `q1 q2 q3` all the time."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from core.errors import CtrError
from station.config.robots import RobotFile
from station.config.strict import Strict, check
from station.devices.interfaces import Clock, Condition, JointReading, NotStopped, Severity, Trouble
from station.devices.links.link import LinkError, SerialLink, reopen


class Options(Strict):
    """`[devices.stages]` of the station file."""

    host: str
    port: int

    @property
    def url(self) -> str:
        return f"socket://{self.host}:{self.port}"


class LineStages:
    """Polled by the control loop: it never waits, and after `connect` it never raises."""

    def __init__(self, options: Options, joints: int) -> None:
        self._link = SerialLink(options.url, 9600)  # raises LinkError
        self._positions, self._sent = np.full(joints, np.nan), np.zeros(joints)
        self._heard, self._problem, self._newest = b"", "", -np.inf

    @property
    def condition(self) -> Condition:
        if self._problem:
            return Condition.FAULT
        return Condition.CONNECTED if self.ready else Condition.CONNECTING

    @property
    def ready(self) -> bool:
        return not self._problem and bool(np.isfinite(self._positions).all())

    def connect(self, now: float) -> None:
        if self._problem:
            try:
                reopen(self._link)
                self._problem = ""
            except LinkError as error:
                self._problem = str(error)

    def home(self, now: float) -> None:
        raise CtrError("these stages have absolute encoders and need no homing")

    def poll(self, now: float) -> JointReading:
        try:
            self._heard += self._link.read()
            *lines, self._heard = self._heard.split(b"\n")
            if lines:
                self._positions, self._newest = np.array(lines[-1].split(), float), now
        except (LinkError, ValueError) as error:
            self._problem = str(error)
        return JointReading(self._positions, self._sent)

    def command(self, velocities: np.ndarray, now: float) -> None:
        self._sent = velocities
        try:
            self._link.write((" ".join(f"{velocity:.9g}" for velocity in velocities) + "\n").encode())
        except LinkError as error:
            self._problem = str(error)

    def stop(self, now: float) -> None:
        self.command(np.zeros_like(self._sent), now)

    def trouble(self, now: float) -> Trouble | None:
        if self._problem or now - self._newest > 0.1:
            return Trouble(Severity.FAULT, self._problem or f"{self._link.name} says no positions; is the box on?")
        return None

    def details(self) -> Mapping[str, Any]:
        return {"port": self._link.name}

    def close(self) -> None:
        self._link.close()


def open_stages(options: Mapping[str, Any], robot: RobotFile) -> LineStages:
    """The entry point."""
    return LineStages(check(Options, options, "devices.stages"), len(robot.joints))


def emergency_stop(options: Mapping[str, Any], robot: RobotFile, clock: Clock) -> str:
    """Stop every axis from another process: the one with the driver has died."""
    begin = clock.now()
    link = SerialLink(check(Options, options, "devices.stages").url, 9600)
    try:
        link.write(b"stop\n")
        answer = b""
        while b"stopped" not in answer:
            if clock.now() - begin > 2.0:
                raise NotStopped(f"the stages at {link.name} do not say that they stop: press the emergency stop")
            clock.sleep(0.005)
            answer += link.read()
    finally:
        link.close()
    return f"{len(robot.joints)} stages at {link.name} say that they have stopped"


open_stages.emergency_stop = emergency_stop
