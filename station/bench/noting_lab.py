"""The virtual lab in a process that no station owns, and that notes when messages come over the stages' line."""

import signal
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from station.control.child import Child
from station.control.realtime import ask_for_fifo, keep_memory, show_as
from station.devices.config import BenchFile
from station.devices.zaber.protocol import SIZE, decode
from station.lab.endpoints import devices_at
from station.lab.lab_server import LabServer
from station.lab.process import PRIORITY
from station.service.bench import Bench


class Note(NamedTuple):
    """A message has come to the stages' end of the line."""

    time: float  #: by the station's clock [s]
    device: int  #: number or alias of the unit that is meant
    command: int
    data: int


class NotingLab:
    """Owner of the process; the stages are homed and stand where the bench is parked. Use it as a context."""

    def __init__(self, bench: Bench) -> None:
        self._child = Child(_run, bench, name="noting lab")
        self.devices: BenchFile = devices_at(self._child.pipe.recv(), bench.lab, bench.clock)

    def notes(self) -> list[Note]:
        """Those since the last call."""
        self._child.pipe.send("notes")
        return self._child.pipe.recv()

    def __enter__(self) -> "NotingLab":
        return self

    def __exit__(self, *_: object) -> None:
        self._child.close(2.0)


def _run(bench: Bench, pipe: Connection, _parent: int) -> None:
    """Main function of the process; ends with its pipe."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who measures decides when it ends
    show_as("ctr-lab")
    notes: list[Note] = []
    part = b""
    with LabServer(bench.robot, bench.lab, bench.seed, np.array(bench.park), homed=True, clock=bench.clock) as lab:
        receive = lab.lab.chain.receive

        def noted(data: bytes, now: float) -> None:
            nonlocal part
            part += data
            while len(part) >= SIZE:
                notes.append(Note(bench.clock.now(), *decode(part[:SIZE])))
                part = part[SIZE:]
            receive(data, now)

        def asked() -> bool:
            while pipe.poll():
                if _asked(pipe) is None:
                    return True
                pipe.send(notes.copy())
                notes.clear()
            return False

        lab.lab.chain.receive = noted
        lab.lab.advance(bench.clock.now() - lab.begun)  # what is compiled for it keeps nobody waiting later
        keep_memory()
        ask_for_fifo(PRIORITY, in_turns=True)  # as the station's own lab
        pipe.send(lab.endpoints)
        lab.run(asked)


def _asked(pipe: Connection) -> Any:
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None  # whoever measured is gone
