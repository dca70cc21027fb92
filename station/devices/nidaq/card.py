"""Analog inputs of a National Instruments card, sampled by the card's own clock; needs the extra `nidaq`."""

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.devices.links.link import LinkError
from station.devices.links.port_lock import PortInUse, PortLock

#: Capacity of NI's buffer: if the control loop does not read for longer, samples are lost [s].
BUFFER_S = 10.0
INSTALL_HINT = "install it with: pip install 'ctr-station[nidaq]', and NI's driver NI-DAQmx from ni.com"


def device_of(inputs: str) -> str:
    """Return the name of the card of some inputs: `Dev1` for `Dev1/ai0:5`."""
    return inputs.partition("/")[0]


class NiCard:
    """One card. One NI-DAQmx task samples all inputs of the card, because the card has one converter."""

    def __init__(self, sensors: Sequence[tuple[str, float]], rate: float) -> None:
        """Start to sample.

        Args:
            sensors: for each sensor its six differential inputs, in NI's notation (`Dev1/ai0:5`), and the largest
                voltage of either sign [V].
            rate: sampling rate of each input [1/s].

        Raises:
            LinkError: package or driver is not installed, card or channel does not exist, the rate is not supported,
                or another program uses the card.
        """
        self.name = device_of(sensors[0][0])
        try:
            daq = importlib.import_module("nidaqmx")
            constants = importlib.import_module("nidaqmx.constants")
            readers = importlib.import_module("nidaqmx.stream_readers")
        except ImportError:
            raise LinkError(f"{self.name}: an NI card needs the package nidaqmx; {INSTALL_HINT}") from None
        self._error: type[Exception] = daq.errors.Error
        try:
            self._lock = PortLock(f"nidaq://{self.name}")
        except PortInUse as error:
            raise LinkError(str(error)) from None
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
                    raise LinkError(f"{inputs} are {count} inputs; a sensor has 6, such as {self.name}/ai0:5")
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
