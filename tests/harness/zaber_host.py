"""The host's side of a Zaber chain in virtual time, on a line that takes its time."""

from station.devices.zaber.chain import Axis, Chain, Line
from station.devices.zaber.protocol import MESSAGE_TIME, Message, decode, encode

AXES = (Axis(1, 9102, 38, 3_072_000), Axis(2, 9102, 38, 3_072_000), Axis(3, 4300, 18, 251_968))
TICK = 0.002


class Host:
    """A chain in virtual time, with units at rest that answer what they are asked as a line of 9600 baud would."""

    def __init__(self, line: Line | None = None, places=(1_536_000, 1_536_000, 60_000), axes=AXES) -> None:
        self.chain = Chain(axes, line)
        self.chain.polling = True
        self.places = list(places)
        self.now = 0.0
        self.sent: list[tuple[float, Message]] = []
        self.happened: list[object] = []
        self.silent: set[int] = set()
        self.status = 0
        self._back: list[tuple[float, bytes]] = []
        self._line_free = 0.0
        self.message_time = MESSAGE_TIME  #: as the line really takes it [s]

    @property
    def behind(self) -> float:
        """How much longer the line has to carry what the host thinks is through [s]."""
        return max(0.0, self._line_free - max(self.chain._free, self.now))

    def held_up(self, seconds: float) -> None:
        """For so long nothing goes out of an adapter."""
        self._line_free = max(self._line_free, self.now) + seconds

    def run(self, seconds: float, each=None) -> None:
        for _ in range(round(seconds / TICK)):
            arrived = b"".join(data for time, data in self._back if time <= self.now)
            self._back = [(time, data) for time, data in self._back if time > self.now]
            self.happened += self.chain.feed(arrived, self.now)
            if each:
                each(self.now)
            data = self.chain.due(self.now)
            if data:
                message = decode(data)
                self.sent.append((self.now, message))
                self._line_free = max(self._line_free, self.now) + self.message_time
                self._reply(message)
            self.now += TICK

    def _reply(self, message: Message) -> None:
        device, command, _ = message
        if device not in self.silent and command in (54, 60):
            data = self.status if command == 54 else self.places[device - 1]
            self._back.append((self._line_free + MESSAGE_TIME, encode(Message(device, command, data))))

    def commands(self, device: int, command: int) -> list[float]:
        return [time for time, message in self.sent if message[:2] == (device, command)]


def changing(host: Host):
    """New speeds for all axes at every tick, so slow that a unit at rest cannot be told from one that obeys."""

    def each(now: float) -> None:
        for axis in range(3):
            host.chain.command(axis, 4 + round(now / TICK) % 7)

    return each
