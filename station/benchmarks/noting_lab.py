"""Virtual lab in a separate process that records when messages arrive at the stages' end of the serial line."""

import signal
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from station.control.child_process import ChildProcess
from station.control.realtime import freeze_garbage_collection, request_fifo, set_process_name
from station.devices.config import BenchFile
from station.devices.zaber.protocol import MESSAGE_BYTES, decode
from station.lab.lab_server import PRIORITY, LabServer, devices_at
from station.service.rig import Rig


class Note(NamedTuple):
    """Message that has arrived at the stages' end of the serial line."""

    time: float  #: time of arrival on the station's clock [s]
    device: int  #: number or alias of the addressed unit
    command: int
    data: int


class NotingLab:
    """Owner of the lab's process, used in a `with` block; the stages start homed and at the rig's parking pose."""

    def __init__(self, bench: Rig) -> None:
        self._child = ChildProcess(_run, bench, name="noting lab")
        self.devices: BenchFile = devices_at(self._child.pipe.recv(), bench.lab, bench.clock)

    def notes(self) -> list[Note]:
        """Return the messages that have arrived since the previous call."""
        self._child.pipe.send("notes")
        return self._child.pipe.recv()

    def __enter__(self) -> "NotingLab":
        return self

    def __exit__(self, *_: object) -> None:
        self._child.close(2.0)


def _run(bench: Rig, pipe: Connection, _parent: int) -> None:
    """Main function of the lab's process, which ends when the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the measuring process ends it
    set_process_name("ctr-lab")
    notes: list[Note] = []
    part = b""
    with LabServer(bench.robot, bench.lab, bench.seed, np.array(bench.park), homed=True, clock=bench.clock) as lab:
        receive = lab.lab.chain.receive

        def receive_and_note(data: bytes, now: float) -> None:
            nonlocal part
            part += data
            while len(part) >= MESSAGE_BYTES:
                notes.append(Note(bench.clock.now(), *decode(part[:MESSAGE_BYTES])))
                part = part[MESSAGE_BYTES:]
            receive(data, now)

        def answer_requests() -> bool:
            while pipe.poll():
                if _next_request(pipe) is None:
                    return True
                pipe.send(notes.copy())
                notes.clear()
            return False

        lab.lab.chain.receive = receive_and_note
        lab.lab.advance(bench.clock.now() - lab.start_time)  # compile the code now, not during the measurement
        freeze_garbage_collection()
        request_fifo(PRIORITY, in_turns=True)  # as the process of a station's lab does
        pipe.send(lab.endpoints)
        lab.run(answer_requests)


def _next_request(pipe: Connection) -> Any:
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None  # the measuring process has ended
