"""Owner of the cameras' processes in the station process: it starts, monitors and replaces them.

A failed camera never ends a motion. It gives a warning in the status, and its process is replaced.
"""

import contextlib
import threading
import time
import traceback
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from station.camera.messages import CameraMessage, CameraPicture, CameraReport, EndVideo, ShowBoard, StartVideo, Watch
from station.camera.process import CameraSetup, run_camera
from station.config.robots import RobotFile
from station.control.child_process import ChildProcess
from station.control.clock import StationClock
from station.control.ring import Ring
from station.devices.cameras import CameraFile

#: Time for which a request for pictures is valid [s].
WATCH_S = 1.5
#: Interval between two requests for pictures to a camera, and between two checks of its process [s].
CHECK_INTERVAL_S = 0.1
#: Age of the newest frame or report from which a camera counts as stalled [s].
STALLED_AFTER_S = 1.5
#: Silence after which a camera's process is killed, and time until it is replaced [s]. A camera may take seconds to
#: open.
HUNG_AFTER_S, RESTART_AFTER_S = 15.0, 2.0
#: Longest time for a camera's process to end [s]; after it the process is killed.
EXIT_TIMEOUT_S = 2.0
#: Rate of frames, as a multiple of the configured rate, above which the status warns of surplus frames.
FLOOD = 1.5


class CameraStatus(NamedTuple):
    """Status of one camera."""

    problem: str  #: what is wrong and what to do; empty: nothing
    rate: float  #: rate of the frames [1/s]
    age: float | None  #: time since the exposure of the newest frame [s]; None: no frame yet
    frames: int  #: number of frames since the start of the camera's process
    surplus: int  #: number of frames that came too fast and were dropped
    video: int  #: number of frames in the video of the present run, or of the last one


class CameraHost:
    """Owner of the process of one camera; its methods are thread-safe and never wait for the camera."""

    def __init__(self, setup: CameraSetup) -> None:
        self.name, self.camera = setup.name, setup.known
        self._setup, self._clock = setup, setup.clock
        self._child = ChildProcess(run_camera, setup, name=f"camera {setup.name}")
        self._started = self._reported = setup.clock.now()
        self._report = CameraReport("the camera's process is starting", 0.0, 0, 0, None)
        self._ended = ""  # how the last process ended; empty while a process runs
        self._watched_until = self._sent = 0.0
        self._video: StartVideo | None = None  # video that the camera must record; None: no video
        self._ordered: StartVideo | None = None  # video that the camera's process was ordered to record
        self._closing = threading.Event()
        self._board: ShowBoard | None = None  # board that the simulated camera must show
        self._shown: ShowBoard | None = None  # board that the camera's process was ordered to show
        self.picture: CameraPicture | None = None  #: newest picture; None: no client needed one
        self._thread = threading.Thread(target=self._run, name=f"camera {setup.name}")

    @property
    def pid(self) -> int | None:
        """Process ID of the camera's process; None while it is replaced."""
        return self._child.pid if not self._ended else None

    def start(self) -> None:
        """Start to receive the camera's messages."""
        self._thread.start()

    def watch(self) -> None:
        """Request pictures for the next `WATCH_S`."""
        self._watched_until = self._clock.now() + WATCH_S

    @property
    def recording(self) -> bool:
        """Whether the camera must record a video."""
        return self._video is not None

    def record(self, folder: Path | None) -> None:
        """Record a video in the `folder` of a run's videos; None: end the video."""
        clock = self._clock
        self._video = None if folder is None else StartVideo(folder, time.time_ns() - round(1e9 * clock.now()))

    def show_board(self, board: ShowBoard | None) -> None:
        """Show a calibration board to a simulated camera; None: show the robot again."""
        self._board = board

    @property
    def watched(self) -> bool:
        """Whether a client has requested pictures within `WATCH_S`."""
        return self._clock.now() < self._watched_until

    def status(self) -> CameraStatus:
        """Return the status of the camera."""
        now, report = self._clock.now(), self._report
        age = None if report.newest is None else now - report.newest
        return CameraStatus(self._problem(now, age), report.rate, age, report.frames, report.surplus, report.video)

    def _problem(self, now: float, age: float | None) -> str:
        report, rate = self._report, self.camera.rate
        if self._ended:
            return f"the camera's process ended {self._ended}; a new one is being started"
        if now - self._reported > STALLED_AFTER_S:
            silence = f"{now - self._reported:.0f} s"
            return f"the camera's process has not reported for {silence}; it is replaced if it stays silent"
        if report.problem:
            return report.problem
        if age is not None and age > STALLED_AFTER_S:
            return f"no frame for {age:.0f} s; check the cable"
        if report.rate > FLOOD * rate:
            return f"the camera delivers {report.rate:.0f} frames/s instead of {rate:g}; surplus frames are dropped"
        return report.video_problem

    def close(self) -> None:
        """End the camera's process."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        self._child.close(self._clock.real(EXIT_TIMEOUT_S))

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                if self._child.pipe.poll(self._clock.real(CHECK_INTERVAL_S)):
                    self._take(self._child.pipe.recv())
                self._check()
            except (EOFError, OSError):
                self._replace()
            except Exception:  # a camera must never end its supervision
                traceback.print_exc()
                self._replace()

    def _take(self, message: CameraMessage) -> None:
        self._reported = self._clock.now()
        if isinstance(message, CameraPicture):
            self.picture = message
        else:
            self._report = message

    def _check(self) -> None:
        now = self._clock.now()
        if now - self._reported > HUNG_AFTER_S:
            self._child.kill()
            self._child.ended(self._clock.real(EXIT_TIMEOUT_S))
            self._replace()
            return
        if now - self._reported > STALLED_AFTER_S:
            return  # a silent process does not empty the pipe, so sending a message could block
        if (video := self._video) is not self._ordered:
            self._ordered = video
            self._child.pipe.send(EndVideo() if video is None else video)
        if (board := self._board) is not self._shown:
            self._shown = board
            self._child.pipe.send(ShowBoard(0.0, (), 0.0, 1.0) if board is None else board)
        if now - self._sent > CHECK_INTERVAL_S and now < self._watched_until:
            self._sent = now
            self._child.pipe.send(Watch(self._watched_until))

    def _replace(self) -> None:
        """Start a new process after a pause, so that a camera that fails at once does not occupy a processor."""
        self._child.kill()
        self._ended = self._child.ended(self._clock.real(EXIT_TIMEOUT_S))
        self._report = self._report._replace(rate=0.0)
        if self._closing.wait(self._clock.real(RESTART_AFTER_S)):
            return
        self._child.pipe.close()
        self._child = ChildProcess(run_camera, self._setup, name=f"camera {self.name}")
        self._reported, self._ended, self._ordered, self._shown = self._clock.now(), "", None, None


class Cameras:
    """All cameras of a station, by name."""

    def __init__(
        self,
        cameras: Mapping[str, CameraFile],
        known: Mapping[str, CameraFile],
        robot: RobotFile,
        ring: Ring,
        width: int,
        clock: StationClock,
        seed: int,
        tracking: Collection[str] = (),
    ) -> None:
        """Prepare the cameras, which `open` starts.

        Args:
            cameras: cameras of the station file and of the virtual lab.
            known: the same cameras, calibrated and without simulated errors.
            robot: robot that a simulated camera renders.
            ring: shared memory with the UDP port at which the virtual lab gives its true shape.
            width: number of channels in a row of the ring.
            clock: clock of the station.
            seed: seed of everything random in simulated cameras.
            tracking: names of the cameras whose pictures measure the tip.
        """
        self._setups = [
            CameraSetup(name, camera, known[name], robot, ring.name, width, clock, seed + number, name in tracking)
            for number, (name, camera) in enumerate(cameras.items())
        ]
        self._hosts: dict[str, CameraHost] = {}
        self._closed = threading.Event()

    @property
    def closed(self) -> bool:
        """Whether the station is ending, so that streams of pictures must end."""
        return self._closed.is_set()

    def open(self) -> None:
        """Start the cameras' processes; call this before the station process has further threads."""
        self._hosts = {setup.name: CameraHost(setup) for setup in self._setups}

    def start(self) -> None:
        """Start to receive the cameras' messages."""
        for host in self:
            host.start()

    def __iter__(self) -> Iterator[CameraHost]:
        return iter(self._hosts.values())

    def __len__(self) -> int:
        return len(self._hosts)

    def find(self, name: str) -> CameraHost | None:
        """Return a camera; None: there is no camera of this name."""
        return self._hosts.get(name)

    def pids(self) -> dict[str, int]:
        """Return the process ID of every camera that runs, by name."""
        return {f"camera {host.name}": host.pid for host in self if host.pid is not None}

    def record(self, folder: Path | None) -> None:
        """Record a video of every camera in the `folder` of a run's videos; None: end the videos."""
        for host in self:
            host.record(folder)

    def end_streams(self) -> None:
        """End the streams of pictures, because the station is ending."""
        self._closed.set()

    def close(self) -> None:
        """End the cameras' processes."""
        self.end_streams()
        for host in self:
            with contextlib.suppress(OSError):
                host.close()
