"""Fuzz test of the Net F/T code with corrupted bytes: driver, simulated box, configuration page and calibration file.

`python -m tests.fuzz.netft 1000000 [SEED]` runs a million cases and prints the counts of the findings.
"""

import json
import math
import random
import struct
import sys
import time
import xml.etree.ElementTree as ET

import numpy as np

from station.devices.ati.calibration import AXES, CalibrationError, NetftPage, PageError, parse_calibration, read_page
from station.devices.ati.netft import NetftSensors
from station.devices.ati.protocol import LATENCY_S, RdtCommand
from station.lab.config import BaseSensorConfig
from station.lab.endpoints import respond
from station.lab.simulated_netft import SimulatedNetft
from station.lab.wires import MemoryDatagramEnd
from tests.harness.damage import spoiled

#: Time after which a case counts as a hang [s].
HANG = 10.0
#: Number of cases that use the same stream of records, or the same simulated box.
LENGTH = 400
#: Largest error of a sample's time [s], caused by the drift of the box's clock while no record is accepted.
TIME = 0.010
PAGE = (
    b'<?xml version="1.0"?>\n<netft><runstat>0x00000000</runstat><prodname>Net F/T</prodname>'
    b"<cfgcalsn>FT1</cfgcalsn><scfgfu>N</scfgfu><scfgtu>N-mm</scfgtu><cfgcpf>1000000</cfgcpf>"
    b"<cfgcpt>1000</cfgcpt><cfgmr>18;18;18;250;250;250</cfgmr></netft>"
)
CALIBRATION = (
    '<?xml version="1.0" encoding="utf-8"?><FTSensor Serial="FT1" NumGages="6"><Calibration PartNumber="SI-18-0.25" '
    'ForceUnits="N" TorqueUnits="N-mm" DistUnits="mm" OutputRange="20" OutputBipolar="True">'
    + "".join(
        f'<Axis Name="{axis}" values="{" ".join("2.5" if i == k else "-0.125" for k in range(6))}" max="18" scale="4"/>'
        for i, axis in enumerate(AXES)
    )
    + '<BasicTransform Dx="0" Dy="0" Dz="4.5" Rx="0" Ry="0" Rz="0"/></Calibration></FTSensor>'
).encode()


def fuzz(cases: int, seed: int) -> dict[str, int]:
    """Run `cases` cases and return the counts; a false accept is a value that was never measured or is known as bad."""
    rng = random.Random(seed)
    found = {"cases": 0, "exceptions": 0, "hangs": 0, "false_accepts": 0, "accepted": 0, "undetectable": 0}
    kinds, weights = (_host, _device, _http, _page, _calibration), (0.6, 0.2, 0.06, 0.07, 0.07)
    lengths = (LENGTH, LENGTH, 1, 1, 1)  # number of cases in one call of each function
    while found["cases"] < cases:
        (kind,) = rng.choices(kinds, [weight / length for weight, length in zip(weights, lengths, strict=True)])
        before, begin = found["cases"], time.perf_counter()
        try:
            kind(rng, found, min(LENGTH, cases - found["cases"]))
        except Exception as error:  # any exception is a finding of the fuzzer
            found["exceptions"] += 1
            found["cases"] = max(found["cases"], before + 1)
            print(f"{kind.__name__}: {error!r}", file=sys.stderr)  # noqa: T201
        found["hangs"] += time.perf_counter() - begin > HANG
    return found


def _flip(rng: random.Random, data: bytes, bits: int) -> bytes:
    spoilt = bytearray(data)
    for bit in rng.sample(range(8 * len(data)), bits):
        spoilt[bit // 8] ^= 1 << bit % 8
    return bytes(spoilt)


def _host(rng: random.Random, found: dict[str, int], cases: int) -> None:
    """Let the driver of one sensor read a stream of records that are lost, late, repeated or corrupted."""
    end = MemoryDatagramEnd()
    link = end.link("box")
    sensors = NetftSensors([link], [NetftPage("Net F/T", "FT1", 1e-6, 1e-6, (18.0,) * 3 + (0.25,) * 3)])
    divisor = rng.choice([1, 2, 7, 14, 70, 140])
    period = divisor / (7000.0 * (1.0 + rng.uniform(-0.005, 0.005)))
    rdt, ft = rng.choice([0, 2**32 - rng.randint(1, 200)]), rng.choice([rng.randrange(2**32), 2**32 - 300])
    measured: dict[int, float] = {}  # time of each record by its force along x [counts], which no other record has
    undetectable: set[tuple[int, ...]] = set()
    held: list[bytes] = []
    now = number = 0
    sensors.start(0.0)
    previous = sensors.poll(0.0)
    for _ in range(cases):
        found["cases"] += 1
        number += rng.choice([1, 1, 1, 1, 1, 1, 1, 1, 2, 30]) if rng.random() < 0.5 else 1
        now = number * period
        record_of = ((rdt + number) % 2**32, (ft + number * divisor) % 2**32)
        status = rng.choice([0, 0, 0, 0, 0, 0x80010000, 0x80020000, 0x80000004, 1 << rng.randrange(32)])
        bad = status not in (0, 0x80010000)
        counts = (
            number,
            *(rng.randint(-17_000_000, 17_000_000) for _ in range(2)),
            *(rng.randint(-249_000, 249_000) for _ in range(3)),
        )
        if not bad and rng.random() < 0.05:
            counts, bad = (*counts[:5], rng.choice([-1, 1]) * rng.randint(250_001, 2**31 - 1)), True
        if not bad:
            measured[number] = now
        data = struct.pack(">IIIiiiiii", *record_of, status, *counts)
        dice = rng.random()
        if dice < 0.75:
            sent = [data]
        elif dice < 0.80:
            sent = [data, data]
        elif dice < 0.85:
            held.append(data)
            sent = []
        elif dice < 0.90:
            sent = [spoiled(data, rng)]
        else:
            sent = [_flip(rng, data, rng.randint(1, 2))]
        for datagram in sent:
            # UDP's checksum would detect flipped bits in the counts, or in a status that then appears healthy.
            if len(datagram) == 36 and (datagram[12:] != data[12:] or bad):
                undetectable.add(struct.unpack(">6i", datagram[12:]))
        if held and rng.random() < 0.5:
            sent += held
            held = []
        for datagram in sent:
            end.send(datagram, link.address)
        reading = sensors.poll(now + LATENCY_S)
        values = reading.wrenches[0]
        if (
            not np.isfinite(values).all()
            or not math.isfinite(reading.time)
            or (np.abs(values) > [18] * 3 + [0.25] * 3).any()
        ):
            found["false_accepts"] += 1
        if reading is previous or (values == previous.wrenches[0]).all():
            continue
        previous = reading
        found["accepted"] += 1
        counts = tuple(round(value * 1e6) for value in values.tolist())
        if counts in undetectable:
            found["undetectable"] += 1
        elif counts[0] not in measured or abs(reading.time - measured[counts[0]]) > TIME:
            found["false_accepts"] += 1


class _Recorder:
    """End of the wire that records to which address the box sends."""

    def __init__(self) -> None:
        self.requests: list[tuple[bytes, tuple[str, int]]] = []
        self.served: set[tuple[str, int]] = set()

    def receive(self):
        requests, self.requests = self.requests, []
        return requests

    def send(self, datagram, to):
        self.served.add(to)
        if len(datagram) % 36:
            raise AssertionError(f"a datagram of {len(datagram)} bytes")

    def close(self):
        pass


def _device(rng: random.Random, found: dict[str, int], cases: int) -> None:
    """Send requests of all kinds to a box, which must serve only the last client with a valid request."""
    end, client, wrench = _Recorder(), None, np.zeros(6)
    box = SimulatedNetft(end, BaseSensorConfig(), np.random.default_rng(rng.randrange(2**32)))
    commands = [*RdtCommand, 1, 4, rng.randrange(2**15)]
    for number in range(1, cases + 1):
        found["cases"] += 1
        host = ("10.0.0.1", rng.randint(1, 5))
        data = struct.pack(">HHI", 0x1234, rng.choice(commands), rng.choice([0, 1, 3, 2**32 - 1, rng.randrange(2**32)]))
        if rng.random() < 0.4:
            data = spoiled(data, rng)
        end.requests.append((data, host))
        if data[:2] == b"\x12\x34" and len(data) == 8:
            client = {b"\x00\x02": host, b"\x00\x00": None}.get(data[2:4], client)
        end.served.clear()
        box.advance(number * 0.004, wrench)
        if not end.served <= {client}:
            found["false_accepts"] += 1


def _http(rng: random.Random, found: dict[str, int], cases: int) -> None:
    """Send a corrupted HTTP request to the box's page."""
    found["cases"] += 1
    data = spoiled(b"GET /netftapi2.xml?index=0 HTTP/1.1\r\nHost: box\r\nAccept: */*\r\n\r\n", rng)
    answer = respond(data, lambda: PAGE)
    line = data.split(b"\r\n")[0].decode("latin-1").split(" ")
    asked = b"\r\n\r\n" in data and line[0] == "GET" and line[1].partition("?")[0] == "/netftapi2.xml"
    asked = asked and line[2:] in (["HTTP/1.0"], ["HTTP/1.1"]) and line[1].isascii() and line[1].isprintable()
    if (answer and not answer.startswith(b"HTTP/1.1 ")) or (answer.endswith(PAGE) and not asked):
        found["false_accepts"] += 1


def _page(rng: random.Random, found: dict[str, int], cases: int) -> None:
    """Read a corrupted configuration page, and compare the result with that of another XML reader."""
    found["cases"] += 1
    data = spoiled(PAGE, rng)
    try:
        page = read_page(data)
    except PageError:
        return
    found["accepted"] += 1
    root = ET.fromstring(data)
    texts = {name: root.findall(f".//{name}") for name in ("prodname", "cfgcpf", "cfgcpt", "scfgfu", "scfgtu")}
    once = all(len(elements) == 1 and not len(elements[0]) for elements in texts.values())
    units = {"N": 1.0, "kN": 1e3, "N-mm": 1e-3, "N-m": 1.0, "Nmm": 1e-3, "Nm": 1.0, "kN-m": 1e3}
    if not once or b"<!DOCTYPE" in data:
        found["false_accepts"] += 1
        return
    force = units[texts["scfgfu"][0].text.strip()] / float(texts["cfgcpf"][0].text)
    torque = units[texts["scfgtu"][0].text.strip()] / float(texts["cfgcpt"][0].text)
    if not (math.isclose(page.force_count, force) and math.isclose(page.torque_count, torque)):
        found["false_accepts"] += 1


def _calibration(rng: random.Random, found: dict[str, int], cases: int) -> None:
    """Read a corrupted calibration file."""
    found["cases"] += 1
    try:
        calibration = parse_calibration(spoiled(CALIBRATION, rng))
    except CalibrationError:
        return
    found["accepted"] += 1
    numbers = [*calibration.matrix.ravel(), *calibration.ranges, calibration.volts]
    if not np.isfinite(numbers).all() or min(calibration.ranges) <= 0.0 or calibration.volts <= 0.0:
        found["false_accepts"] += 1


if __name__ == "__main__":
    result = fuzz(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000, int(sys.argv[2]) if len(sys.argv) > 2 else 1)
    print(json.dumps(result))  # noqa: T201
