"""Serves the virtual lab to other programs: the simulated devices have real endpoints and run in real time.

Stages and tracker have serial lines, which are TCP connections or pseudo-terminals. Each force sensor is a box on the
network, which sends datagrams by UDP and its configuration page by HTTP. One loop serves all devices without threads.
"""

import contextlib
import math
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

from core.robot.robot import Array
from station.config.loads import Load
from station.config.robots import RobotFile
from station.config.strict import check
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.realtime import freeze_garbage_collection, request_fifo
from station.devices.aurora import tracker as aurora
from station.devices.cameras import measuring
from station.devices.config import BenchFile
from station.devices.stereo import tracker as stereo
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import LabConfig
from station.lab.endpoints import HOST, PageServer, PtyDeviceEnd, Readable, TcpDeviceEnd, UdpDeviceEnd
from station.lab.shape_server import ShapeServer
from station.lab.simulated_aurora import TARGET_SERIAL
from station.lab.simulated_bench import SimulatedBench
from station.lab.simulated_stages import STAGES
from station.lab.wires import Wires

PERIOD_S = 0.001  #: longest time between two polls of the devices; about the duration of a byte at 9600 baud [s]
#: Real-time priority of the lab: below the control loop's, so that the loop is never late because of it.
PRIORITY = 40


def devices_at(endpoints: Mapping[str, Any], config: LabConfig, clock: StationClock = REAL_TIME_CLOCK) -> BenchFile:
    """Return the tables `[devices]` of a lab with these endpoints; `clock` sets the timeouts of the drivers."""
    at, boxes = config.sensors.at, {box["tube"]: _box(box) for box in endpoints["netft"]}
    sensors = boxes if at == "robot" else {"tubes": boxes}
    tables: dict[str, dict[str, Any]] = {
        "stages": dict(STAGES[config.stages].table(endpoints[config.stages], clock)),
        "tracker": {
            "driver": "aurora",
            "port": endpoints["aurora"],
            "frame_rate": config.tracker.rate,
            "latency": config.tracker.latency,
            "stale_after": max(aurora.HOLD_AFTER_S, clock.patience),
            # The generator is upside down, as in `GENERATOR_POSE`: half a turn about x.
            "mount": {"position": GENERATOR_POSE.position.tolist(), "rotation_vector": [math.pi, 0.0, 0.0]},
        },
        "sensors": {"driver": "netft", "at": at, **sensors, "stale_after": clock.patience},
    }
    if config.target is not None:
        tables["tracker"]["target"] = TARGET_SERIAL
    if config.cameras:
        tables["tracker"] = {
            "driver": "stereo", "cameras": tuple(config.cameras), "views": measuring(config.cameras),
            "stale_after": max(stereo.HOLD_AFTER_S, clock.patience),
        }  # fmt: skip
    return check(BenchFile, {kind: tables[kind] for kind in tables if kind not in config.without}, "virtual lab")


def _box(endpoint: Mapping[str, str]) -> dict[str, Any]:
    page, rdt = urlsplit(endpoint["page"]), urlsplit(endpoint["rdt"])
    return {"host": rdt.hostname, "rdt_port": rdt.port, "http_port": page.port}


class LabServer:
    """A `SimulatedBench` with devices at real endpoints. Use it as a context manager."""

    def __init__(
        self,
        robot: RobotFile,
        config: LabConfig,
        seed: int,
        positions: Array,
        pty: bool = False,
        netft_port: int = 0,
        homed: bool = False,
        folder: Path | None = None,
        clock: StationClock = REAL_TIME_CLOCK,
        *,
        shape: bool = False,
    ) -> None:
        """Create the endpoints, and the bench with the joints at `positions` (n,).

        `pty`: pseudo-terminals instead of TCP. `netft_port`: UDP port of the first force sensor, before those of the
        others; 0: any. `homed`: whether the stages are homed. `folder`: folder for links to the terminals, which stay
        valid when a terminal changes. `clock`: clock of the devices. `shape`: give the true shape to simulated cameras.

        Raises:
            AddressInUse: another program has a given port.
            PoseError, NoSolution: the plant (simulated real robot) has no equilibrium shape at `positions`.
        """
        self.readable = Readable()  #: file descriptors with unread data, updated in each cycle
        with contextlib.ExitStack() as opened:

            def line(name: str) -> PtyDeviceEnd | TcpDeviceEnd:
                return PtyDeviceEnd(None if folder is None else folder / name) if pty else TcpDeviceEnd(self.readable)

            self._lines = (line(config.stages), line("aurora"))
            for end in self._lines:
                opened.callback(end.close)
            boxes: list[UdpDeviceEnd] = []
            for number in range(len(robot.sensor_names)):
                boxes.append(UdpDeviceEnd(HOST, netft_port + number if netft_port else 0, self.readable))
                opened.callback(boxes[-1].close)
            self.lab = SimulatedBench(robot, config, seed, positions, Wires(*self._lines, tuple(boxes)), homed)
            self._pages: list[PageServer] = []
            for box in self.lab.boxes:
                self._pages.append(PageServer(HOST, 0, box.page, self.readable))
                opened.callback(self._pages[-1].close)
            self.shape = ShapeServer(self.readable) if shape else None
            if self.shape is not None:
                opened.callback(self.shape.close)
            self._ends = (*self._lines, *boxes, *self._pages, *(() if self.shape is None else (self.shape,)))
            self._opened = opened.pop_all()
        self.clock = clock
        self.start_time = clock.now()  #: time of the clock at the lab's time 0 [s]
        #: Endpoints of the devices, as `ctr-station lab` prints them.
        self.endpoints: dict[str, Any] = {
            config.stages: self._lines[0].name,
            "aurora": self._lines[1].name,
            "netft": [
                {"tube": name, "rdt": f"udp://{HOST}:{box.port}", "page": f"http://{HOST}:{page.port}/netftapi2.xml"}
                for name, box, page in zip(robot.sensor_names, boxes, self._pages, strict=True)
            ],
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all endpoints."""
        self._opened.close()

    def run(self, stopped: Callable[[], bool], files: Iterable[int] = ()) -> None:
        """Run the lab by its clock until `stopped`, which is called in each cycle, returns true.

        `files`: further file descriptors for `readable`; data in them also end the wait for the next cycle.

        A robot that cannot follow its stages is reported on stderr.
        """
        clock, start, due, early, trouble = self.clock, self.start_time, 0.0, False, ""
        while not stopped():
            wait = max(0.0, start + due - clock.now())
            if early:  # sleep for the rest of the period, because a flood of bytes must not use a whole processor
                clock.sleep(wait)
                wait = 0.0
            self.readable.wait((*files, *(file for end in self._ends for file in end.files)), clock.real(wait))
            now = clock.now() - start
            early = now < due
            self.lab.advance(now)
            if self.lab.trouble and not trouble:
                sys.stderr.write(f"the robot stays where it is: {' '.join(self.lab.trouble.split())}\n")
            trouble = self.lab.trouble
            if self.shape is not None:
                self.shape.poll(self.lab.shape, start + now)
            if now >= due:
                for page in self._pages:
                    page.poll()
                # The deadlines are absolute, so delays do not add up; missed deadlines are skipped.
                due = (math.floor(now / PERIOD_S) + 1) * PERIOD_S


def be_punctual(fifo: bool) -> bool:
    """Prepare the calling process so that its simulated devices reply in time on a busy computer, as real ones do.

    Args:
        fifo: request real-time scheduling.

    Returns:
        False when the system refuses real-time scheduling.
    """
    freeze_garbage_collection()
    # Round robin, because the labs of two stations may share a processor.
    return not fifo or request_fifo(PRIORITY, in_turns=True)


def serve(lab: LabServer, load: Load, ready: Callable[[dict[str, Any]], None], fifo: bool = True) -> None:
    """Run the lab with a load on the tip until SIGINT or SIGTERM; `ready` receives the endpoints.

    `fifo`: request real-time scheduling.
    """
    lab.lab.apply_load(load, 0.0)
    with _signals() as received, lab:
        lab.lab.advance(lab.clock.now() - lab.start_time)  # compiles the code before the first tick of `run`
        if not be_punctual(fifo):
            sys.stderr.write(
                "real-time scheduling is refused: on a busy computer the simulated devices may answer too late;"
                " ctr-station doctor explains how to enable it\n"
            )
        ready(lab.endpoints)
        lab.run(lambda: bool(received))


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """Provide a list to which each SIGINT and SIGTERM is added."""
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: received.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield received
    finally:
        for number, action in before.items():
            signal.signal(number, action)
