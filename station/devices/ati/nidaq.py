"""Driver of base sensors on analog cards: computes one wrench per sensor from the mean voltages since the last poll.

The mean over a tick has less noise than the last sample; its time is the middle of the tick. A card has its own sample
clock, so the driver computes the time of a sample from the number of the sample.
"""

import contextlib
import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from core.errors import CtrError
from core.robot.robot import Array
from station.config.robots import RobotFile
from station.config.strict import MAX_SILENCE_S, ConfigError, Name, Strict, check
from station.devices.ati.calibration import GaugeCalibration, read_calibration
from station.devices.config import Mount, mounted, sensor_tables, twins
from station.devices.interfaces import BaseSensors, Condition, DeviceFault, WrenchReading
from station.devices.kernel.quality import Quality, Sampled, sample_fault
from station.devices.kernel.sampled import SampleClock
from station.devices.links.link import LinkError, PortLock

#: Capacity of NI's buffer: if the control loop does not read for longer, samples are lost [s].
BUFFER_S = 10.0
INSTALL_HINT = "install it with: pip install 'ctr-station[nidaq]', and NI's driver NI-DAQmx from ni.com"


def device_of(inputs: str) -> str:
    """Return the name of the card to which inputs belong: `Dev1` for `Dev1/ai0:5`."""
    return inputs.partition("/")[0]


class NiCard:
    """One card. One NI-DAQmx task samples all inputs of the card, because the card has one converter."""

    def __init__(self, sensors: Sequence[tuple[str, float]], rate: float) -> None:
        """Open the card, and start to sample.

        Args:
            sensors: for each sensor its six differential inputs, in NI's notation (`Dev1/ai0:5`), and the largest
                voltage of either sign [V].
            rate: sampling rate of each input [1/s].

        Raises:
            LinkError: the package or NI's driver is not installed, the card or a channel does not exist, the rate is
                not supported, or another program uses the card.
        """
        self.name = device_of(sensors[0][0])
        try:
            daq = importlib.import_module("nidaqmx")
            constants = importlib.import_module("nidaqmx.constants")
            readers = importlib.import_module("nidaqmx.stream_readers")
        except ImportError:
            raise LinkError(f"{self.name}: an NI card needs the package nidaqmx; {INSTALL_HINT}") from None
        self._error: type[Exception] = daq.errors.Error
        self._lock = PortLock(f"nidaq://{self.name}")
        task: Any = None
        try:
            task = daq.Task()
            before = 0
            for inputs, volts in sensors:
                task.ai_channels.add_ai_voltage_chan(
                    inputs, terminal_config=constants.TerminalConfiguration.DIFF, min_val=-volts, max_val=volts
                )
                count = int(task.number_of_channels) - before
                if count != 6:
                    raise LinkError(f"{inputs} are {count} inputs; a sensor needs 6, such as {self.name}/ai0:5")
                before += count
            mode = constants.AcquisitionType.CONTINUOUS
            task.timing.cfg_samp_clk_timing(rate, sample_mode=mode, samps_per_chan=round(BUFFER_S * rate))
            task.start()
            #: Actual sampling rate of the card [1/s].
            self.rate = float(task.timing.samp_clk_rate)
            self._reader = readers.AnalogMultiChannelReader(task.in_stream)
        except (self._error, LinkError) as error:
            if task is not None:
                task.close()
            self._lock.release()
            if isinstance(error, LinkError):
                raise
            names = ", ".join(inputs for inputs, _ in sensors)
            raise LinkError(f"{names} cannot be sampled: {' '.join(str(error).split())}") from None
        self._task, self._channels = task, 6 * len(sensors)

    def read(self) -> Array:
        """Return the voltages (channels, k) sampled since the last read [V], without waiting.

        Raises:
            LinkError: the card is lost, or samples were lost because the last read was too long ago.
        """
        try:
            there = int(self._task.in_stream.avail_samp_per_chan)
            voltages = np.empty((self._channels, there))
            if there:
                self._reader.read_many_sample(voltages, number_of_samples_per_channel=there, timeout=0.0)
        except self._error as error:
            raise LinkError(f"{self.name}: {' '.join(str(error).split())}") from None
        return voltages

    def close(self) -> None:
        """Release the card."""
        self._task.close()
        self._lock.release()


#: Largest drift between a card's clock and the computer's [s/s].
MAX_CLOCK_DRIFT = 2e-4


class Wiring(NamedTuple):
    """Inputs of one sensor's strain gauges, and their calibration."""

    card: int  #: index of the card
    first: int  #: index of the first of the sensor's six inputs on this card
    calibration: GaugeCalibration


class CardSensors:
    """Base sensors on analog cards, in the order of the tubes."""

    def __init__(
        self, opens: Callable[[], Sequence[NiCard]], wirings: Sequence[Wiring], stale_after: float = 0.05
    ) -> None:
        """`opens` opens the cards that `wirings` refer to, or raises LinkError."""
        self._opens, self._wirings, self._stale_after = opens, tuple(wirings), stale_after
        self._use(opens())
        self._started = False

    def _use(self, cards: Sequence[NiCard]) -> None:
        self._cards = tuple(cards)
        self._clocks = [SampleClock(card.rate, MAX_CLOCK_DRIFT) for card in self._cards]
        self._counts = [0] * len(self._cards)  # number of samples of each card so far
        self._lost = ["" for _ in self._cards]
        count = len(self._wirings)
        self._flags = [Quality.STALE | Quality.SILENT] * count
        self._last_usable = [-math.inf] * count  # time of the last usable sample [s]
        self._times = [-math.inf] * count
        self._reading = WrenchReading(0.0, np.zeros((count, 6)), usable=False)
        self._samples, self._saturated = 0, [0] * count

    @property
    def condition(self) -> Condition:
        """FAULT after the loss of a card; CONNECTED after every sensor has had a usable sample."""
        if any(self._lost):
            return Condition.FAULT
        if not self._started:
            return Condition.CLOSED
        return Condition.CONNECTED if all(map(math.isfinite, self._times)) else Condition.CONNECTING

    @property
    def quality(self) -> tuple[Quality, ...]:
        """Quality of each sensor at the last poll."""
        return tuple(self._flags)

    def connect(self, now: float) -> None:  # noqa: ARG002 - the cards have sampled since they were opened
        """Start to use the sensors; if a card is lost, open all cards again."""
        self._started = True
        if any(self._lost):
            for card in self._cards:
                card.close()
            try:
                self._use(self._opens())
            except LinkError as error:
                self._lost = [str(error)] * len(self._cards)

    def poll(self, now: float) -> WrenchReading:
        """Return the mean wrenches since the last poll; an unusable sensor keeps its last valid wrench."""
        wrenches = self._reading.wrenches
        for index, card in enumerate(self._cards):
            if self._lost[index]:
                continue
            try:
                voltages = card.read()
            except LinkError as error:
                self._lost[index] = str(error)
                continue
            if samples := voltages.shape[1]:
                self._counts[index] += samples
                self._clocks[index].observe(self._counts[index], now)
                middle = self._clocks[index].time(self._counts[index] - 0.5 * (samples - 1))
                wrenches = self._take(index, voltages, middle, now, wrenches)
        for i, wiring in enumerate(self._wirings):
            flags = self._flags[i] & Quality.SATURATED
            if now - self._last_usable[i] > self._stale_after:
                flags |= Quality.STALE | (Quality.GOOD if flags else Quality.SILENT)
            self._flags[i] = flags | (Quality.LOST if self._lost[wiring.card] else Quality.GOOD)
        time = min(self._times)
        self._reading = WrenchReading(time if math.isfinite(time) else now, wrenches, not any(self._flags))
        return self._reading

    def trouble(self, now: float) -> DeviceFault | None:
        """Return a HOLD if a sensor had no valid sample at the last poll, and a WARN if a card's clock is wrong."""
        found: list[Sampled] = []
        for i, (wiring, quality) in enumerate(zip(self._wirings, self._flags, strict=True)):
            card, rate = self._cards[wiring.card], self._clocks[wiring.card].wrong_rate
            if not quality and rate is None:
                continue
            because = "" if quality or rate is None else f"sends {rate:.0f} samples/s; its card reports {card.rate:g}"
            details = self._lost[wiring.card] or ", ".join(quality.words or ["usable"])
            name = f"force sensor {i + 1}"
            found.append(Sampled(name, quality, now - self._times[i], f"{name} on {card.name}: {details}", because))
        return sample_fault(found, 0.0 if any(self._flags) else math.inf) if found else None

    def details(self) -> Mapping[str, Any]:
        """Return identities and counters of the sensors."""
        return {
            f"{number} ({self._cards[wiring.card].name})": {
                "calibration": wiring.calibration.serial,
                "rate": self._cards[wiring.card].rate,
                "quality": quality.words,
                "saturated": saturated,
            }
            for number, (wiring, quality, saturated) in enumerate(
                zip(self._wirings, self._flags, self._saturated, strict=True), 1
            )
        }

    def close(self) -> None:
        """Release the cards."""
        for card in self._cards:
            card.close()

    def _take(self, card: int, voltages: Array, time: float, now: float, wrenches: Array) -> Array:
        """Return the wrenches (q, 6) of all sensors, updated by one card's samples."""
        wrenches = wrenches.copy()
        for i, wiring in enumerate(self._wirings):
            if wiring.card != card:
                continue
            gauges = voltages[wiring.first : wiring.first + 6]
            wrench = wiring.calibration.mean_wrench(gauges)
            self._flags[i] = Quality.GOOD if wrench is not None else Quality.SATURATED
            if wrench is None:
                self._saturated[i] += 1
            else:
                wrenches[i], self._last_usable[i], self._times[i] = wrench, now, time
        return wrenches


class CardFile(Strict):
    """One ATI sensor on an NI card."""

    channels: Annotated[str, Field(min_length=1)]
    """six differential inputs in the order of the gauges, as NI names them: Dev1/ai0:5"""
    calibration: str
    """path of ATI's .cal file for this sensor"""
    serial: str | None = None
    """serial number of the sensor that the .cal file must contain; default: any"""
    mount: Mount = Mount()
    """pose of the sensor's frame in the frame at its tube's proximal end (x along alpha = 0, z along the tube)"""


class NidaqFile(Strict):
    """ATI sensors on NI cards."""

    tubes: Mapping[Name, CardFile] = {}
    """inputs of the sensor at each tube, by the name of the tube"""
    robot: CardFile | None = None
    """inputs of the sensor under the whole robot, with `at = "robot"`"""
    rate: Annotated[float, Field(ge=100.0, le=100_000.0)] = 5000.0
    """sampling rate of each input [1/s]"""
    stale_after: Annotated[float, Field(gt=0.0, le=MAX_SILENCE_S)] = 0.05
    """time without a usable sample after which a sensor counts as stale [s]"""


def nidaq(options: Mapping[str, Any], robot: RobotFile) -> Callable[[], BaseSensors]:
    """Check the options, and return the function that opens the ATI sensors on NI cards; raises ConfigError."""
    key = "devices.sensors"
    file = check(NidaqFile, options, key)
    sensors, names = sensor_tables(file.tubes, file.robot, robot)
    cards: dict[str, list[tuple[str, float]]] = {}
    gauges: list[tuple[str, int, GaugeCalibration]] = []
    for name, sensor in zip(names, sensors, strict=True):
        calibration = _calibration(sensor, name)
        inputs = cards.setdefault(device_of(sensor.channels), [])
        gauges.append((device_of(sensor.channels), 6 * len(inputs), calibration))
        inputs.append((sensor.channels, calibration.volts))
    for what, values in (
        ("channels", [sensor.channels for sensor in sensors]),
        ("calibration", [calibration.serial for _, _, calibration in gauges]),
    ):
        if same := twins(dict(zip(names, values, strict=True))):
            raise ConfigError(
                f"{same[1]}.{what}: {same[0].rsplit('.')[-1]} has the same value '{values[names.index(same[1])]}';"
                " give each tube its own sensor"
            )
    wirings = [Wiring(list(cards).index(card), first, calibration) for card, first, calibration in gauges]

    def cards_opened() -> list[NiCard]:
        with contextlib.ExitStack() as opened:
            found: list[NiCard] = []
            for inputs in cards.values():
                found.append(NiCard(inputs, file.rate))
                opened.callback(found[-1].close)
            opened.pop_all()
            return found

    return lambda: mounted(CardSensors(cards_opened, wirings, file.stale_after), [sensor.mount for sensor in sensors])


def _calibration(sensor: CardFile, key: str) -> GaugeCalibration:
    try:
        calibration = read_calibration(Path(sensor.calibration))
    except CtrError as error:
        raise ConfigError(f"{key}.calibration: {error}") from None
    if sensor.serial is not None and calibration.serial != sensor.serial:
        raise ConfigError(
            f"{key}.serial = '{sensor.serial}': {sensor.calibration} is for '{calibration.serial}'; wrong file?"
        )
    return calibration
