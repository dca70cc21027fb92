"""Example of a custom driver: the stages' controller box receives lines `v1 v2 v3` by TCP and sends `q1 q2 q3`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from core.errors import CtrError
from station.config.robots import RobotFile
from station.config.strict import Strict, check
from station.devices.interfaces import Clock, Condition, DeviceFault, JointReading, NotStopped, Severity
from station.devices.links.link import LinkError, SerialLink, reopen

SILENCE_S = 0.1  # longest time without a line: ten periods of the box


class Options(Strict):
    """Keys of `[devices.stages]` in the station file."""

    host: str
    port: int


class LineStages:
    """Driver of the stages. The control loop polls it, so it never waits, and after `connect` it never raises."""

    def __init__(self, options: Options, robot: RobotFile) -> None:
        self._link = SerialLink(f"socket://{options.host}:{options.port}", 9600)  # raises LinkError
        self._speeds = np.array([joint.speed for joint in robot.joints])
        self._positions, self._sent = np.nan * self._speeds, 0.0 * self._speeds
        self.condition, self._problem, self._received, self._newest = Condition.CLOSED, "", b"", -np.inf

    def connect(self, now: float) -> None:
        try:
            if self._problem:
                reopen(self._link)
        except LinkError as error:
            self._fail(str(error))
        else:
            self.condition, self._problem, self._received, self._newest = Condition.CONNECTING, "", b"", now
            self.stop(now)  # after a lost connection the axes may still move

    @property
    def ready(self) -> bool:
        return self.condition is Condition.CONNECTED

    def home(self, now: float) -> None:
        raise CtrError("these stages have absolute encoders and need no homing")

    def poll(self, now: float) -> JointReading:
        if self.condition in (Condition.CONNECTING, Condition.CONNECTED):
            try:
                *lines, self._received = (self._received + self._link.read()).split(b"\n")
                if lines:
                    positions = np.array(lines[-1].split(), float)
                    if positions.shape != self._speeds.shape or not np.isfinite(positions).all():
                        raise ValueError(f"the stages sent {lines[-1]!r}")
                    self._positions, self._newest, self.condition = positions, now, Condition.CONNECTED
            except (LinkError, ValueError) as error:
                self._fail(str(error))
            if now - self._newest > SILENCE_S:
                self._fail(f"no line for {SILENCE_S:g} s from {self._link.name}")
        return JointReading(self._positions, self._sent)

    def command(self, velocities: np.ndarray, now: float) -> None:
        if self.ready:
            valid = np.isfinite(velocities).all()
            self._send(np.clip(velocities, -self._speeds, self._speeds) if valid else 0.0 * self._speeds)

    def stop(self, now: float) -> None:
        self._send(0.0 * self._speeds)

    def _send(self, velocities: np.ndarray) -> None:
        try:
            self._link.write((" ".join(f"{velocity:.9g}" for velocity in velocities) + "\n").encode())
            self._sent = velocities
        except LinkError as error:
            self.condition, self._problem = Condition.FAULT, str(error)

    def _fail(self, problem: str) -> None:
        self._send(0.0 * self._speeds)  # a box that cannot send may still receive this stop
        self.condition, self._problem = Condition.FAULT, problem

    def trouble(self, now: float) -> DeviceFault | None:
        text = "the stages send no positions; are they on?"
        return DeviceFault(Severity.FAULT, text, self._problem) if self._problem else None

    def details(self) -> Mapping[str, Any]:
        return {"port": self._link.name}

    def close(self) -> None:
        self._link.close()
        self.condition = Condition.CLOSED


def emergency_stop(options: Mapping[str, Any], robot: RobotFile, clock: Clock) -> str:
    """Stop every axis; another process calls this after the process with the driver has died."""
    box, start, answer = check(Options, options, "devices.stages"), clock.now(), b""
    link = SerialLink(f"socket://{box.host}:{box.port}", 9600)
    try:
        link.write(b"stop\n")
        while b"stopped" not in answer:
            if clock.now() - start > 2.0:
                raise NotStopped(f"the stages at {link.name} confirm no stop: press the emergency stop")
            clock.sleep(0.005)
            answer += link.read()
    finally:
        link.close()
    return f"{len(robot.joints)} stages at {link.name} report that they have stopped"


def open_stages(options: Mapping[str, Any], robot: RobotFile) -> LineStages:
    """Entry point of the driver: open the stages."""
    return LineStages(check(Options, options, "devices.stages"), robot)


open_stages.emergency_stop = emergency_stop
