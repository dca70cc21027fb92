"""A simulated Net F/T box on a network in memory, and a host that sends and reads hexadecimal text."""

import struct
from typing import NamedTuple

import numpy as np

from station.devices.ati.protocol import RECORD
from station.lab.config import BaseSensorConfig
from station.lab.simulated_netft import BoxSettings, SimulatedNetft
from station.lab.wires import MemoryDatagramEnd, MemoryDatagrams

PERFECT = BaseSensorConfig(
    force_noise=0.0, moment_noise=0.0, force_count=0.0, moment_count=0.0, drift=0.0, moment_drift=0.0,
    force_offset=0.0, moment_offset=0.0,
)  # fmt: skip
WRENCH = np.array([1.0, -2.0, 3.0, 0.01, -0.02, 0.03])
STREAM = "1234000200000000"
TICK = 0.002


class Bench:
    """A simulated Net F/T box, and a host that sends requests as hexadecimal text."""

    def __init__(self, config: BaseSensorConfig = PERFECT, seed: int = 1, **settings: object) -> None:
        self.end = MemoryDatagramEnd()
        self.host = self.end.link("host")
        self.box = SimulatedNetft(self.end, config, np.random.default_rng(seed), BoxSettings(**settings))
        self.now = 0.0

    def request(self, message: str, host: MemoryDatagrams | None = None) -> None:
        (host or self.host).send(bytes.fromhex(message))

    def run(self, time: float, wrench: np.ndarray = WRENCH) -> list[tuple[int, ...]]:
        """Return the records that the host receives in `time` [s]."""
        datagrams = []
        for _ in range(round(time / TICK)):
            self.now += TICK
            self.box.advance(self.now, wrench)
            datagrams += self.host.receive()
        return [fields for datagram in datagrams for fields in struct.iter_unpack(">IIIiiiiii", datagram)]


class Record(NamedTuple):
    """One record as received."""

    rdt_sequence: int  #: number of the record, from 1 after each stream request
    ft_sequence: int  #: the box's internal sample counter
    status: int  #: status word
    counts: tuple[int, ...]  #: Fx Fy Fz Tx Ty Tz


def records(datagram: bytes) -> list[Record] | None:
    """Return the records of a datagram; None if the datagram does not consist of whole records."""
    if not datagram or len(datagram) % RECORD.size:
        return None
    return [Record(fields[0], fields[1], fields[2], fields[3:]) for fields in RECORD.iter_unpack(datagram)]
