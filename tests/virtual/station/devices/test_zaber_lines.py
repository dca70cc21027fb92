"""The Zaber driver on simulated units over a real pseudo-terminal and a real socket."""

import os
import socket
import time
import tty
from collections.abc import Callable

import numpy as np
import pytest

from station.devices.links import SerialLink
from station.devices.zaber_chain import Line
from station.devices.zaber_setup import Port
from station.devices.zaber_stages import Condition, ZaberStages
from station.lab.simulated_zaber import pump
from tests.harness.file_link import FileLink
from tests.harness.zaber_bench import START, Bench


@pytest.mark.parametrize("kind", ["pty", "socket"])
def test_real_time_over_a_pty_and_a_socket(paper, kind):
    bench = Bench(paper)
    if kind == "pty":
        master, slave = os.openpty()
        tty.setraw(slave)
        near, far = SerialLink(os.ttyname(slave), 9600), FileLink(master)
        os.close(slave)
        rest: Callable[[], None] = far.close
    else:
        with socket.create_server(("127.0.0.1", 0)) as server:
            near = SerialLink(f"socket://127.0.0.1:{server.getsockname()[1]}", 9600)
            connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # or the replies come in lumps
        far, rest = FileLink(connection.fileno()), connection.close
    stages = ZaberStages(bench.setups, [Port(near, (0, 1, 2))], Line(deadline=2.0))

    def until(reached: Callable[[], bool]) -> None:
        give_up = time.monotonic() + 60.0
        while not reached() and time.monotonic() < give_up:
            stages.poll(time.monotonic())
            pump(far, bench.chain, time.monotonic())
            time.sleep(1e-3)
        assert reached(), stages.problem

    try:
        stages.connect(time.monotonic())
        until(lambda: stages.condition is not Condition.CONNECTING)
        assert stages.ready, stages.problem
        stages.command(np.array([0.2, -0.2, 0.01]), time.monotonic())
        until(lambda: bench.places[0] > START[0] + 0.05 and bench.places[2] > START[2] + 0.001)
        stages.stop(time.monotonic())
        until(lambda: stages.at_rest)
        assert bench.moving == [False, False, False]
        until(lambda: np.abs(stages.poll(time.monotonic()).positions - bench.places).max() < 1e-5)
    finally:
        stages.close()
        rest()
