"""Commands and messages of Zaber ASCII devices, and their line: an `AnsweringLine` of `kernel/answered.py`."""

from collections.abc import Iterator, Sequence

from station.devices.kernel.answered import Answer, AnsweringAxis, AnsweringLine, Message
from station.devices.kernel.estimate import AxisEstimate
from station.devices.zaber_ascii.protocol import (
    ACCELERATION_FACTOR,
    BYTE_TIME_S,
    MAX_ID,
    SPEED_FACTOR,
    Alert,
    LineReader,
    encode,
)
from station.devices.zaber_ascii.setup import DEADLINE_S, AsciiSetup


class AsciiWire:
    """Commands and messages of the axes of Zaber ASCII devices."""

    byte_time, max_number, stop, position = BYTE_TIME_S, MAX_ID, "stop", "get pos"
    serial_number = "get system.serial"

    def __init__(self, setups: Sequence[AsciiSetup]) -> None:
        self.reader = LineReader()
        self._addresses = [(setup.device, setup.axis) for setup in setups]

    def velocity(self, data: int) -> str:
        """Return the text of the command that moves an axis at a velocity."""
        return f"move vel {data}"

    def speed(self, data: int) -> float:
        """Convert the data of a velocity command to a speed [microsteps/s]."""
        return data / SPEED_FACTOR

    def encode(self, axis: int | None, text: str, number: int, *, whole_device: bool = False) -> bytes:
        """Return the bytes of a command to an axis or to its whole device; `axis` None: to all devices."""
        device, on_device = (0, 0) if axis is None else self._addresses[axis]
        return encode(device, 0 if whole_device else on_device, number, text)

    def read(self, data: bytes) -> Iterator[Message]:
        """Return the messages that `data` completes."""
        for message in self.reader.feed(data):
            axes = [
                i
                for i, (device, axis) in enumerate(self._addresses)
                if device == message.device and message.axis in (0, axis)
            ]
            if isinstance(message, Alert):
                yield Message(axes, None, Answer(False, "", message.busy, message.flag))
            else:
                answer = Answer(message.accepted, message.data, message.busy, message.flag)
                yield Message(axes, message.identity, answer)


def ascii_chain(wire: AsciiWire, setups: Sequence[AsciiSetup], deadline: float = DEADLINE_S) -> AnsweringLine:
    """Return the line of the axes on one chain."""
    axes = [
        AnsweringAxis(
            s.top,
            s.minimum,
            AxisEstimate(s.top / SPEED_FACTOR, s.acceleration / ACCELERATION_FACTOR, s.maximum - s.minimum),
        )
        for s in setups
    ]
    return AnsweringLine(wire, axes, deadline)
