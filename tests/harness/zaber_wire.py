"""The host's end of a simulated Zaber chain, at the level of bytes, in virtual time."""

from station.devices.zaber.protocol import ZaberMessage, ZaberParser, encode
from station.lab.simulated_line import SimulatedLine
from station.lab.simulated_zaber import Unit, UnitKind

ROTARY = UnitKind(4421, None, 1_536_000)
LINEAR = UnitKind(4332, 604_724, serial=1001)
#: Units of the Zaber protocol's speed [microsteps/s] and acceleration [microsteps/s^2] at a resolution of 64
#: microsteps per step.
SPEED, RAMP = 9.375, 11250.0


class Wire:
    """The host's end of a simulated Zaber chain."""

    def __init__(self, chain: SimulatedLine[Unit]) -> None:
        self.chain = chain
        self.now = 0.0
        self.received: list[tuple[float, ZaberMessage]] = []
        self._parser = ZaberParser()

    def send(self, device: int, command: int, data: int = 0) -> None:
        self.chain.receive(encode(ZaberMessage(device, command, data)), self.now)

    def wait(self, seconds: float, tick: float = 1e-3) -> list[ZaberMessage]:
        """Advance by `seconds` and return the messages that the host has received meanwhile."""
        first = len(self.received)
        for _ in range(round(seconds / tick)):
            self.now += tick
            for message in self._parser.feed(self.chain.advance(self.now), self.now):
                self.received.append((self.now, message))
        return [message for _, message in self.received[first:]]

    def request(self, device: int, command: int, data: int = 0, seconds: float = 0.05) -> list[ZaberMessage]:
        self.send(device, command, data)
        return self.wait(seconds)

    def talk(self, text: str) -> list[str]:
        """Send bytes and return the reply, both in hexadecimal as in Zaber's manual."""
        self.chain.receive(bytes.fromhex(text), self.now)
        return [encode(message).hex(" ") for message in self.wait(0.1)]
