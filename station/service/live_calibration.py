"""Calibration of a running station: one procedure at a time, and nobody else moves the robot meanwhile.

The station goes from pose to pose, a person hangs the weights, a child process plans and computes. STOP ends it.
"""

import contextlib
import threading
from datetime import datetime
from pathlib import Path

import numpy as np

from station.calibration.catalogue import WEIGHTS
from station.calibration.folder import new_folder
from station.calibration.worker import Job
from station.config.strict import check
from station.control.states import RefusedError
from station.devices.aurora.tracker import Registration
from station.devices.config import Mount
from station.lab.aurora.coil import MOUNT
from station.service.bench import Bench
from station.service.calibration_session import CalibrationSession, Report
from station.service.supervisor import Supervisor


class LiveCalibration:
    """Procedures on one station; any thread may ask."""

    def __init__(self, supervisor: Supervisor, folder: Path) -> None:
        """Results go into `folder`, a new one in there for each."""
        self.supervisor, self.folder = supervisor, folder
        self._course: CalibrationSession | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def report(self) -> Report | None:
        """Of the procedure that is on, or of the last one; None before the first."""
        return None if self._course is None else self._course.report

    def start(self, what: str, effort: float = 1.0, weights: tuple[float, ...] = WEIGHTS) -> None:
        """Begin a procedure; a person has seen that the tubes may move through their whole workspace.

        Args:
            what: name in the catalogue.
            effort: so many times the usual number of poses.
            weights: known, that there are to hang at the tip [N].

        Raises:
            RefusedError: the station is not READY, or a procedure is on.
            ConfigError: where the station's file says that its tracker stands makes no sense, or the folder cannot be
                written to.
        """
        with self._lock:
            self.supervisor.reserve(f"'calibrate {what}' has the robot to itself; abort it first")
            if self._thread is not None:
                self._thread.join()  # it has let go of the station
            try:
                job = _job(self.supervisor.bench, self.folder, what, effort, weights)
                self._course = CalibrationSession(self.supervisor, job)
            except BaseException:
                self.supervisor.release()
                raise
            self._thread = threading.Thread(target=self._run, args=(self._course,), name="calibration")
            self._thread.start()

    def done(self) -> None:
        """A person has done what was asked for.

        Raises:
            RefusedError: nothing is asked for.
        """
        self._on().done()

    def abort(self, cause: str = "aborted by the operator") -> None:
        """End the procedure that is on; what moves is stopped, and nothing is kept.

        Raises:
            RefusedError: none is on.
        """
        self._on().abort(cause)

    def close(self) -> None:
        """End what is on."""
        with contextlib.suppress(RefusedError):
            self.abort("the station has ended")
        if self._thread is not None:
            self._thread.join()

    def _on(self) -> CalibrationSession:
        if self._course is None:
            raise RefusedError("no procedure is on")
        return self._course

    def _run(self, course: CalibrationSession) -> None:
        try:
            course.run()
        finally:
            self.supervisor.release()


def believed_mount(bench: Bench) -> Registration:
    """Where the tracker is believed to stand: what telemetry calls the world is seen through it."""
    if bench.calibration is not None and bench.calibration.registration is not None:
        return bench.calibration.registration
    if bench.devices is None:
        return MOUNT
    mount = check(Mount, bench.devices.tracker.get("mount", {}), "devices.tracker.mount")
    return Registration(mount.rotation, np.array(mount.position))


def _job(bench: Bench, folder: Path, what: str, effort: float, weights: tuple[float, ...]) -> Job:
    known, now, mount = bench.calibration, datetime.now().astimezone(), believed_mount(bench)
    return Job(
        what,
        effort,
        weights,
        bench.robot if known is None else known.robot,
        np.array(bench.park),
        mount,
        bench.title,
        bench.seed if bench.devices is None else None,
        now.isoformat(timespec="seconds"),
        new_folder(folder, f"{what}-{now:%Y%m%d-%H%M%S}"),
        None if known is None else known.folder,
    )
