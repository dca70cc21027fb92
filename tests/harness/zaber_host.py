"""The host's side of a Zaber chain in virtual time, on a line with a realistic transfer time."""

from station.devices.zaber.chain import Axis, LineSettings, ZaberChain
from station.devices.zaber.protocol import MESSAGE_TIME_S, ZaberMessage, decode, encode

AXES = (Axis(1, 9102, 38, 3_072_000), Axis(2, 9102, 38, 3_072_000), Axis(3, 4300, 18, 251_968))
TICK = 0.002


class Host:
    """A host's chain in virtual time; units at rest answer its requests with the delays of a 9600 baud line."""

    def __init__(self, line: LineSettings | None = None, places=(1_536_000, 1_536_000, 60_000), axes=AXES) -> None:
        self.chain = ZaberChain(axes, line)
        self.chain.polling = True
        self.places = list(places)
        self.now = 0.0
        self.sent: list[tuple[float, ZaberMessage]] = []
        self.happened: list[object] = []
        self.silent: set[int] = set()
        self.status = 0
        self._back: list[tuple[float, bytes]] = []
        self._line_free = 0.0
        self.message_time = MESSAGE_TIME_S  #: time that the line really takes for a message [s]

    @property
    def behind(self) -> float:
        """Time for which the line still transfers messages that the host considers sent [s]."""
        return max(0.0, self._line_free - max(self.chain._free, self.now))

    def held_up(self, seconds: float) -> None:
        """Let the adapter send nothing for `seconds`."""
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

    def _reply(self, message: ZaberMessage) -> None:
        device, command, _ = message
        if device not in self.silent and command in (54, 60):
            data = self.status if command == 54 else self.places[device - 1]
            self._back.append((self._line_free + MESSAGE_TIME_S, encode(ZaberMessage(device, command, data))))

    def commands(self, device: int, command: int) -> list[float]:
        return [time for time, message in self.sent if message[:2] == (device, command)]


def changing(host: Host):
    """Return a function that commands new speeds at every tick, too slow to distinguish from a unit at rest."""

    def each(now: float) -> None:
        for axis in range(3):
            host.chain.command(axis, 4 + round(now / TICK) % 7)

    return each
