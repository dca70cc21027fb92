"""Calibration of a running station: one procedure at a time; only the procedure moves the robot.

The station moves from pose to pose, the operator attaches weights, and a child process plans the poses and computes
the results. STOP ends the procedure.
"""

import contextlib
import threading
from datetime import datetime
from pathlib import Path

import numpy as np

from station.calibration.catalogue import DEFAULT_WEIGHTS_N
from station.calibration.folder import new_folder
from station.calibration.worker import CalibrationJob
from station.config.strict import check
from station.control.states import RefusedError
from station.devices.aurora.tracker import TrackerMounting
from station.devices.config import Mount
from station.lab.aurora_coil import GENERATOR_POSE
from station.service.calibration_session import CalibrationSession, SessionReport
from station.service.permits import Permit
from station.service.rig import Rig
from station.service.supervisor import Supervisor


class LiveCalibration:
    """Calibration procedures on one station; its methods are thread-safe."""

    def __init__(self, supervisor: Supervisor, folder: Path) -> None:
        """Prepare calibrations whose results are written to a new folder inside `folder`."""
        self.supervisor, self.folder = supervisor, folder
        self._session: CalibrationSession | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    @property
    def report(self) -> SessionReport | None:
        """Report of the present or last calibration procedure; None before the first one."""
        return None if self._session is None else self._session.report

    def start(
        self,
        what: str,
        effort: float = 1.0,
        weights: tuple[float, ...] = DEFAULT_WEIGHTS_N,
        permit: Permit | None = None,
    ) -> None:
        """Start a procedure; the caller confirms that the whole workspace of the tubes is free.

        Args:
            what: name in the catalogue.
            effort: factor that multiplies the default number of poses.
            weights: calibration weights that the operator can attach to the tip [N].
            permit: permit of the request; a later STOP or reset ends the procedure.

        Raises:
            VoidError: a STOP or a reset came after the request, or the permit has expired.
            RefusedError: the station is not READY, or a procedure is running.
            ConfigError: the tracker's pose in the station's file is invalid, or the folder cannot be written.
        """
        permit = permit or self.supervisor.permit()
        with self._lock:
            self.supervisor.reserve(f"'calibrate {what}' has reserved the robot; abort it first", permit)
            if self._thread is not None:
                self._thread.join()  # the previous procedure has already released the robot
            try:
                job = _job(self.supervisor, self.folder, what, effort, weights)
                permit.check("calibrate")
                self._session = CalibrationSession(self.supervisor, job, permit.lasting())
            except BaseException:
                self.supervisor.release()
                raise
            self._thread = threading.Thread(target=self._run, args=(self._session,), name="calibration")
            self._thread.start()

    def done(self) -> None:
        """Confirm that the operator has carried out the instruction.

        Raises:
            RefusedError: no procedure is waiting for the operator.
        """
        self._on().done()

    def abort(self, cause: str = "aborted by the operator") -> None:
        """End the present calibration procedure; motion is stopped and no result is kept.

        Raises:
            RefusedError: no procedure is running.
        """
        self._on().abort(cause)

    def close(self) -> None:
        """Abort the present calibration procedure and wait for its end."""
        with contextlib.suppress(RefusedError):
            self.abort("the station has ended")
        if self._thread is not None:
            self._thread.join()

    def _on(self) -> CalibrationSession:
        if self._session is None:
            raise RefusedError("no procedure is running")
        return self._session

    def _run(self, session: CalibrationSession) -> None:
        try:
            session.run()
        finally:
            self.supervisor.release()


def assumed_mount(bench: Rig) -> TrackerMounting:
    """Return the assumed pose of the tracker, which defines the world frame of the telemetry."""
    if bench.calibration is not None and bench.calibration.registration is not None:
        return bench.calibration.registration
    if bench.devices is None:
        return GENERATOR_POSE
    mount = check(Mount, bench.devices.tracker.get("mount", {}), "devices.tracker.mount")
    return TrackerMounting(mount.rotation, np.array(mount.position))


def _job(supervisor: Supervisor, folder: Path, what: str, effort: float, weights: tuple[float, ...]) -> CalibrationJob:
    bench = supervisor.bench
    calibration, now, mount = bench.calibration, datetime.now().astimezone(), assumed_mount(bench)
    return CalibrationJob(
        what,
        effort,
        weights,
        bench.robot if calibration is None else calibration.robot,
        np.array(bench.park),
        mount,
        bench.title,
        bench.seed if bench.devices is None else None,
        supervisor.simulated,
        now.isoformat(timespec="seconds"),
        new_folder(folder, f"{what}-{now:%Y%m%d-%H%M%S}"),
        None if calibration is None else calibration.folder,
    )
