"""Example of a custom driver: stages whose box takes lines `v1 v2 v3` by TCP and keeps sending `q1 q2 q3`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from core.errors import CtrError
from station.config.robots import RobotFile
from station.config.strict import Strict, check
from station.devices.interfaces import Clock, Condition, DeviceFault, JointReading, NotStopped, Severity
from station.devices.links.link import LinkError, SerialLink, reopen


class Options(Strict):
    """Keys of `[devices.stages]` in the station file."""

    host: str
    port: int

    @property
    def url(self) -> str:
        return f"socket://{self.host}:{self.port}"


class LineStages:
    """Driver of the stages. The control loop polls it, so it never waits, and after `connect` it never raises."""

    def __init__(self, options: Options, joints: int) -> None:
        self._link = SerialLink(options.url, 9600)  # raises LinkError if the box cannot be reached
        self._positions, self._sent = np.full(joints, np.nan), np.zeros(joints)
        self._received, self._problem, self._newest = b"", "", -np.inf

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
            self._received += self._link.read()
            *lines, self._received = self._received.split(b"\n")
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

    def trouble(self, now: float) -> DeviceFault | None:
        if self._problem or now - self._newest > 0.1:
            text = "the stages send no positions; are they on?"
            return DeviceFault(Severity.FAULT, text, self._problem or self._link.name)
        return None

    def details(self) -> Mapping[str, Any]:
        return {"port": self._link.name}

    def close(self) -> None:
        self._link.close()


def open_stages(options: Mapping[str, Any], robot: RobotFile) -> LineStages:
    """Entry point of the driver: open the stages."""
    return LineStages(check(Options, options, "devices.stages"), len(robot.joints))


def emergency_stop(options: Mapping[str, Any], robot: RobotFile, clock: Clock) -> str:
    """Stop every axis; another process calls this after the process with the driver has died."""
    start = clock.now()
    link = SerialLink(check(Options, options, "devices.stages").url, 9600)
    try:
        link.write(b"stop\n")
        answer = b""
        while b"stopped" not in answer:
            if clock.now() - start > 2.0:
                raise NotStopped(f"the stages at {link.name} confirm no stop: press the emergency stop")
            clock.sleep(0.005)
            answer += link.read()
    finally:
        link.close()
    return f"{len(robot.joints)} stages at {link.name} report that they have stopped"


open_stages.emergency_stop = emergency_stop
