"""The supervisor models the calibrated robot, and merges simultaneous calls of a function into one."""

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from core.errors import CtrError
from station.config.strict import preset
from station.service.station_file import load_station
from station.service.supervisor import SingleFlight, Supervisor


def test_drawn_and_checked_model_is_that_of_the_calibrated_tubes(tmp_path: Path, write: Callable[..., Path]) -> None:
    folder = tmp_path / "calibrated"
    folder.mkdir()
    described = preset("robots", "paper").read_text(encoding="utf-8")
    calibrated = described.replace("bending_stiffness = 0.0413", "bending_stiffness = 0.0333")
    (folder / "robot.toml").write_text(calibrated, encoding="utf-8")
    supervisor = Supervisor(load_station(write(f'calibration = "{folder}"\n')).bench())
    try:
        stiffness = {tube.bending_stiffness for tube in supervisor.statics.robot.tubes}
        assert 0.0333 in stiffness
        assert 0.0413 not in stiffness
    finally:
        supervisor.ring.close(remove=True)


def test_simultaneous_calls_of_a_single_flight_function_get_the_same_result() -> None:
    started, proceed, done = threading.Event(), threading.Event(), list[int]()

    def act() -> int:
        started.set()
        proceed.wait()
        done.append(len(done))
        return len(done)

    once = SingleFlight(act)
    answers: list[Future[int]] = []
    with ThreadPoolExecutor(4) as threads:
        answers.append(threads.submit(once))
        started.wait()
        called = threading.Semaphore(0)

        def second() -> int:
            called.release()
            return once()

        answers += [threads.submit(second) for _ in range(3)]
        for _ in range(3):
            called.acquire()
        proceed.set()
        found = [answer.result() for answer in answers]
    assert found[0] == 1
    assert len(done) == max(found)  # a later call runs the function again
    assert once() == len(done)


def test_single_flight_function_runs_again_after_a_failed_call() -> None:
    tries: list[int] = []

    def act() -> None:
        tries.append(1)
        raise CtrError("it cannot be")

    once = SingleFlight(act)
    for _ in range(2):
        with pytest.raises(CtrError, match="it cannot be"):
            once()
    assert len(tries) == 2
