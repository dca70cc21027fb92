"""Base sensors on analog cards: voltages since the last look, averaged, become one wrench a sensor.

The mean of what a tick brings has less noise than its last sample, and the time of its middle. A card samples by
its own clock, so a sample's number says when it was taken.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from enum import IntFlag
from typing import Any, NamedTuple, Protocol

import numpy as np

from core.robot.robot import Array
from station.devices.interfaces import Condition, Severity, Trouble, WrenchReading
from station.devices.links.link import LinkError
from station.devices.nidaq.ati_calibration import Calibration

#: By which a card's clock and the computer's may drift apart, at most [s/s].
DRIFT = 2e-4


class Card(Protocol):
    """Inputs that are sampled at a rate."""

    name: str  #: for messages
    rate: float  #: of each input [1/s]

    def read(self) -> Array:
        """Voltages (channels, k) since the last read [V], without waiting; raises LinkError."""
        ...

    def close(self) -> None:
        """Let go of it."""
        ...


class Wiring(NamedTuple):
    """Where one sensor's gauges are, and what their voltages mean."""

    card: int  #: place among the cards
    first: int  #: of its six inputs on that card
    calibration: Calibration


class Quality(IntFlag):
    """What is wrong with a sensor's reading; 0: nothing."""

    GOOD = 0
    STALE = 1  #: nothing usable for too long, or nothing yet
    SATURATED = 2  #: a gauge at the converter's end
    GONE = 4  #: the card is gone


class SampleClock:
    """Host time of a card's samples: what is read late was taken in time, never after it was read."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._count = 0  # samples so far
        self._offset, self._seen = math.inf, 0.0  # host time of sample 0, as the least delayed read says

    def middle(self, samples: int, now: float) -> float:
        """When the middle of the next `samples` was taken that are read at `now` [s]."""
        self._count += samples
        late = self._offset + DRIFT * (now - self._seen)
        self._offset, self._seen = min(now - self._count / self._rate, late), now
        return self._offset + (self._count - 0.5 * (samples - 1)) / self._rate


def mean_wrench(calibration: Calibration, voltages: Array) -> Array | None:
    """Untared wrench (6,) [N, N m] of gauge voltages (6, k) [V].

    None if any of the samples is at the converter's end: a mean would hide it.
    """
    if calibration.is_saturated(voltages):
        return None
    return calibration.wrench(voltages.mean(axis=1), np.zeros(6))


class CardSensors:
    """Sensors in the order of the tubes."""

    def __init__(
        self,
        opens: Callable[[], Sequence[Card]],
        wirings: Sequence[Wiring],
        stale_after: float = 0.05,
    ) -> None:
        """`opens` the cards, each that `wirings` name; raises LinkError."""
        self._opens, self._wirings, self._stale_after = opens, tuple(wirings), stale_after
        self._use(opens())
        self._started = False

    def _use(self, cards: Sequence[Card]) -> None:
        self._cards = tuple(cards)
        self._clocks = [SampleClock(card.rate) for card in self._cards]
        self._lost = ["" for _ in self._cards]
        count = len(self._wirings)
        self._flags = [int(Quality.STALE)] * count
        self._fresh = [-math.inf] * count  # when there was a usable sample [s]
        self._times = [-math.inf] * count
        self._reading = WrenchReading(0.0, np.zeros((count, 6)), usable=False)
        self._samples, self._saturated = 0, [0] * count

    @property
    def condition(self) -> Condition:
        """CONNECTED once every sensor has told something usable."""
        if any(self._lost):
            return Condition.FAULT
        if not self._started:
            return Condition.CLOSED
        return Condition.CONNECTED if all(map(math.isfinite, self._times)) else Condition.CONNECTING

    @property
    def quality(self) -> tuple[Quality, ...]:
        """Of each sensor at the last poll."""
        return tuple(Quality(flags) for flags in self._flags)

    def connect(self, now: float) -> None:  # noqa: ARG002 - the cards sample since they were opened
        """Begin; cards that have gone are opened anew."""
        self._started = True
        if any(self._lost):
            for card in self._cards:
                card.close()
            try:
                self._use(self._opens())
            except LinkError as error:
                self._lost = [str(error)] * len(self._cards)

    def poll(self, now: float) -> WrenchReading:
        """The mean of what has come since the last poll; a sensor that is not usable keeps its last good wrench."""
        wrenches = self._reading.wrenches
        for place, (card, clock) in enumerate(zip(self._cards, self._clocks, strict=True)):
            if self._lost[place]:
                continue
            try:
                voltages = card.read()
            except LinkError as error:
                self._lost[place] = str(error)
                continue
            if voltages.shape[1]:
                wrenches = self._take(place, voltages, clock.middle(voltages.shape[1], now), now, wrenches)
        for i, wiring in enumerate(self._wirings):
            stale = Quality.STALE if now - self._fresh[i] > self._stale_after else 0
            gone = Quality.GONE if self._lost[wiring.card] else 0
            self._flags[i] = self._flags[i] & Quality.SATURATED | stale | gone
        time = min(self._times)
        self._reading = WrenchReading(time if math.isfinite(time) else now, wrenches, not any(self._flags))
        return self._reading

    def trouble(self, now: float) -> Trouble | None:  # noqa: ARG002 - it is as at the last poll
        """Nothing fit for control from some sensor: HOLD, with the reason."""
        texts = [
            f"force sensor {number} ({self._cards[wiring.card].name}): "
            + (self._lost[wiring.card] or ", ".join(str(flag.name).lower() for flag in Quality if flag & flags))
            for number, (wiring, flags) in enumerate(zip(self._wirings, self._flags, strict=True), 1)
            if flags
        ]
        return Trouble(Severity.HOLD, "; ".join(texts)) if texts else None

    def details(self) -> Mapping[str, Any]:
        """Who the sensors are and what they have counted."""
        return {
            f"{number} ({self._cards[wiring.card].name})": {
                "calibration": wiring.calibration.serial,
                "rate": self._cards[wiring.card].rate,
                "quality": [str(flag.name).lower() for flag in Quality if flag & flags],
                "saturated": saturated,
            }
            for number, (wiring, flags, saturated) in enumerate(
                zip(self._wirings, self._flags, self._saturated, strict=True), 1
            )
        }

    def close(self) -> None:
        """Let go of the cards."""
        for card in self._cards:
            card.close()

    def _take(self, card: int, voltages: Array, time: float, now: float, wrenches: Array) -> Array:
        """What one card's samples make of the wrenches (q, 6)."""
        wrenches = wrenches.copy()
        for i, wiring in enumerate(self._wirings):
            if wiring.card != card:
                continue
            mine = voltages[wiring.first : wiring.first + 6]
            wrench = mean_wrench(wiring.calibration, mine)
            self._flags[i] = 0 if wrench is not None else int(Quality.SATURATED)
            if wrench is None:
                self._saturated[i] += 1
            else:
                wrenches[i], self._fresh[i], self._times[i] = wrench, now, time
        return wrenches
