"""The host's end of a simulated chain, byte by byte in virtual time."""

from station.devices.zaber.protocol import Message, Parser, encode
from station.lab.zaber.simulated import SimulatedChain
from station.lab.zaber.unit import UnitKind

ROTARY = UnitKind(4421, None, 1_536_000)
LINEAR = UnitKind(4332, 604_724, serial=1001)
#: Worked units at R = 64: 9.375 microsteps/s of speed, 11250 microsteps/s^2 of acceleration.
SPEED, RAMP = 9.375, 11250.0


class Wire:
    """The host's end of a simulated chain."""

    def __init__(self, chain: SimulatedChain) -> None:
        self.chain = chain
        self.now = 0.0
        self.heard: list[tuple[float, Message]] = []
        self._parser = Parser()

    def send(self, device: int, command: int, data: int = 0) -> None:
        self.chain.receive(encode(Message(device, command, data)), self.now)

    def wait(self, seconds: float, tick: float = 1e-3) -> list[Message]:
        """What is heard meanwhile."""
        begin = len(self.heard)
        for _ in range(round(seconds / tick)):
            self.now += tick
            for message in self._parser.feed(self.chain.advance(self.now), self.now):
                self.heard.append((self.now, message))
        return [message for _, message in self.heard[begin:]]

    def ask(self, device: int, command: int, data: int = 0, seconds: float = 0.05) -> list[Message]:
        self.send(device, command, data)
        return self.wait(seconds)

    def talk(self, text: str) -> list[str]:
        """Bytes as they are printed in a manual, both ways."""
        self.chain.receive(bytes.fromhex(text), self.now)
        return [encode(message).hex(" ") for message in self.wait(0.1)]
