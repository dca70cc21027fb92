"""Calibration of the station's cameras: it takes pictures of a board automatically until they suffice.

A person holds the board, or the virtual lab shows one. A picture counts if the board is at rest and in a new pose.
"""

import contextlib
import threading
from collections.abc import Mapping, Sequence
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from core.errors import CtrError
from core.robot.robot import Array
from station.calibration.files import carry_over, new_folder
from station.camera.host import CameraHost
from station.camera.messages import CameraPicture, ShowBoard
from station.config.strict import Strict
from station.control.calibrated_robot import CAMERAS_FILE
from station.control.states import State
from station.recording.run_folder import write_atomically
from station.service.permits import RefusedError
from station.service.supervisor import Supervisor

if TYPE_CHECKING:
    from station.camera.board import Corners
    from station.camera.lens_calibration import CamerasResult, Pictured

#: Interval between two searches for the board [s].
INTERVAL_S = 0.2
#: Largest motion of the board's corners between two pictures of a board at rest, and smallest distance of the corners
#: of a new pose from those of every earlier picture; both are fractions of the picture's width.
REST, NEW_PLACE = 0.0015, 0.03
#: Numbers of pictures of each camera, and of pairs of pictures, that suffice; a result needs fewer.
ENOUGH_PICTURES, ENOUGH_PAIRS = 20, 12
#: Largest number of pictures of a session; further ones hardly improve the result.
MAX_PICTURES = 120
#: Time for which the virtual lab shows the board in one pose [s].
POSE_S = 1.0
#: Largest difference between the exposures of two cameras' pictures that form a pair [s].
PAIR_S = 0.2
#: Time after which an unfinished calibration is cancelled [s].
MAX_TIME_S = 1200.0


class BoardStage(StrEnum):
    """State of a calibration of cameras."""

    LOOKING = "looking"  #: takes pictures
    SOLVING = "solving"
    DONE = "done"
    ENDED = "ended"  #: ended by the operator, or by an error


class CameraBoardState(Strict):
    """Pictures and corners of the board that one camera has found."""

    pictures: int
    """number of pictures that count for the calibration"""
    corners: tuple[tuple[float, float], ...]
    """column and row of the corners in the newest picture [pixel]"""
    coverage: tuple[tuple[bool, ...], ...]
    """for each cell of the picture, row by row: whether a corner was found in it"""


class BoardState(Strict):
    """State of the calibration of cameras."""

    stage: BoardStage
    cameras: Mapping[str, CameraBoardState]
    pairs: int
    """pictures that both cameras have taken together; 0 with one camera"""
    enough: bool
    """whether the pictures suffice for a result"""
    instruction: str
    """what to do next"""
    result: tuple[str, ...] = ()
    """human-readable result, or the reason why there is none yet"""
    folder: str = ""
    """folder of the result, for the key `calibration` of the station file; empty without a result"""


class CameraCalibration:
    """Calibrations of the cameras of one station; its methods are thread-safe."""

    def __init__(self, supervisor: Supervisor, folder: Path) -> None:
        self._supervisor, self._folder = supervisor, folder
        self._session: _Session | None = None
        self._lock = threading.Lock()

    @property
    def state(self) -> BoardState | None:
        """State of the present or of the last calibration; None before the first one."""
        return None if self._session is None else self._session.state

    def start(self, names: Sequence[str], square: float) -> None:
        """Start to take pictures of a board, whose squares have the side `square` [m], with one or two cameras.

        Raises:
            RefusedError: a calibration or a run is active, or there is no such camera.
        """
        with self._lock:
            if self._session is not None and self._session.active:
                raise RefusedError("the cameras are being calibrated; finish or cancel that first")
            if self._supervisor.status().state is State.RUNNING:
                raise RefusedError("the cameras cannot be calibrated during a run; wait for its end, or press STOP")
            hosts = [host for name in names if (host := self._supervisor.cameras.find(name)) is not None]
            if len(hosts) != len(names) or not 1 <= len(set(names)) == len(names) <= 2:
                known = ", ".join(host.name for host in self._supervisor.cameras) or "none"
                raise RefusedError(f"{', '.join(names)}: expected one or two different cameras of: {known}")
            self._session = _Session(self._supervisor, self._folder, hosts, square)

    def finish(self) -> None:
        """Compute the result from the pictures.

        Raises:
            RefusedError: no calibration is active, or the pictures do not suffice.
        """
        session = self._active()
        if not session.state.enough:
            raise RefusedError(f"the pictures do not suffice: {session.state.instruction}")
        session.finish.set()

    def cancel(self) -> None:
        """End the calibration without a result.

        Raises:
            RefusedError: no calibration is active.
        """
        self._active().cancel.set()

    def close(self) -> None:
        """End the active calibration, because the station is ending."""
        if self._session is not None:
            self._session.close()

    def _active(self) -> "_Session":
        session = self._session
        if session is None or not session.active:
            raise RefusedError("no cameras are being calibrated")
        return session


class _Session:
    """One calibration of cameras, with its thread."""

    def __init__(self, supervisor: Supervisor, folder: Path, hosts: Sequence[CameraHost], square: float) -> None:
        self.finish, self.cancel = threading.Event(), threading.Event()
        self._supervisor, self._folder, self._hosts, self._square = supervisor, folder, hosts, square
        self._number = 0  # number of pictures that count
        empty = CameraBoardState(pictures=0, corners=(), coverage=())
        self.state = BoardState(
            stage=BoardStage.LOOKING, cameras={host.name: empty for host in hosts}, pairs=0, enough=False,
            instruction="waiting for pictures",
        )  # fmt: skip
        self._thread = threading.Thread(target=self._run, name="camera calibration")
        self._thread.start()

    @property
    def active(self) -> bool:
        """Whether the calibration has not ended."""
        return self.state.stage in (BoardStage.LOOKING, BoardStage.SOLVING)

    def close(self) -> None:
        """Cancel the calibration and wait for its end."""
        self.cancel.set()
        self._thread.join()

    def _run(self) -> None:
        import cv2

        from station.camera.board import Corners
        from station.camera.lens_calibration import CalibrationRefused

        cv2.setNumThreads(1)  # the control loop needs the other processors
        watchers = [_Watcher(host, Corners()) for host in self._hosts]
        try:
            self._show_board()
            while self._take(watchers):
                self.state = self.state.model_copy(update={"stage": BoardStage.SOLVING, "instruction": "computing"})
                try:
                    self._write({watcher.host.name: watcher.pictured for watcher in watchers})
                    return
                except CalibrationRefused as error:  # more pictures may help
                    self.finish.clear()
                    self.state = self.state.model_copy(update={"stage": BoardStage.LOOKING, "result": (str(error),)})
            self._end(BoardStage.ENDED, ("cancelled; nothing was written",))
        except CtrError as error:
            self._end(BoardStage.ENDED, (str(error),))
        except Exception as error:
            self._end(BoardStage.ENDED, (f"the calibration failed: {type(error).__name__}: {error}",))
            raise
        finally:
            for host in self._hosts:
                host.show_board(None)

    def _end(self, stage: BoardStage, result: tuple[str, ...], folder: str = "") -> None:
        self.state = self.state.model_copy(
            update={"stage": stage, "instruction": "", "result": result, "folder": folder}
        )

    def _show_board(self) -> None:
        """Let simulated cameras show a board that moves; a person holds the board in front of real ones."""
        from station.camera.simulated_board import board_poses

        cameras = {host.name: self._supervisor.bench.cameras[host.name] for host in self._hosts}
        if not all(camera.simulated for camera in cameras.values()):
            return
        now = self._supervisor.bench.clock.now()
        poses = board_poses(cameras, self._square, self._supervisor.bench.seed)
        for host in self._hosts:
            host.show_board(ShowBoard(self._square, poses, now, POSE_S))

    def _take(self, watchers: "Sequence[_Watcher]") -> bool:
        """Take pictures until the operator finishes, and return True; False: cancelled."""
        end = self._supervisor.bench.clock.now() + MAX_TIME_S
        while not self.finish.is_set():
            if self.cancel.wait(INTERVAL_S) or self._supervisor.bench.clock.now() > end:
                return False
            for watcher in watchers:
                watcher.look()
            new = self._at_rest(watchers) and any(watcher.is_new() for watcher in watchers)
            if new and self._number < MAX_PICTURES:
                self._number += 1
                for watcher in watchers:
                    watcher.keep(f"{self._number:02}")
            self._show(watchers)
        return True

    @staticmethod
    def _at_rest(watchers: "Sequence[_Watcher]") -> bool:
        """Return whether every camera that sees the board sees it at rest, in pictures of the same time."""
        seeing = [watcher for watcher in watchers if watcher.sees]
        times = [watcher.time for watcher in watchers]
        return bool(seeing) and all(watcher.rests for watcher in seeing) and max(times) - min(times) < PAIR_S

    def _show(self, watchers: "Sequence[_Watcher]") -> None:
        from station.camera.lens_calibration import paired

        first, *others = watchers
        pairs = paired(first.pictured.views, others[0].pictured.views) if others else 0
        missing = next((text for watcher in watchers if (text := watcher.missing())), "")
        if not missing and others and pairs < ENOUGH_PAIRS:
            missing = f"hold the board where both cameras see it: {pairs} of {ENOUGH_PAIRS} pairs"
        self.state = self.state.model_copy(
            update={
                "cameras": {watcher.host.name: watcher.state() for watcher in watchers}, "pairs": pairs,
                "enough": not missing, "instruction": missing or "enough pictures; more of them improve the result",
            }
        )  # fmt: skip

    def _write(self, pictures: "Mapping[str, Pictured]") -> None:
        """Compute the result and write it to a new folder, with the files of the calibration in use."""
        from station.camera.lens_calibration import calibrate_cameras

        bench = self._supervisor.bench
        pose = bench.cameras[self._hosts[0].name].view
        result: CamerasResult = calibrate_cameras(pictures, self._square, None if pose is None else pose[1])
        folder = new_folder(self._folder, f"cameras-{datetime.now().astimezone():%Y%m%d-%H%M%S}")
        made = f"'calibrate cameras' of {datetime.now().astimezone().isoformat(timespec='seconds')}, {bench.title}"
        write_atomically(result.toml(bench.robot.name, made), folder / CAMERAS_FILE)
        if bench.calibration is not None and bench.calibration.folder is not None:
            with contextlib.suppress(CtrError):
                carry_over(bench.calibration.folder, folder)
        self._end(BoardStage.DONE, result.sentences, str(folder))


class _Watcher:
    """Pictures of the board by one camera."""

    def __init__(self, host: CameraHost, corners: "Corners") -> None:
        from station.camera.lens_calibration import Pictured

        self.host, self._corners = host, corners
        self.pictured: Pictured = Pictured([], (host.camera.width, host.camera.height), host.camera.device)
        self.time = 0.0  #: exposure of the newest picture [s]
        self._picture: CameraPicture | None = None
        self._numbers: tuple[int, ...] = ()
        self._pixels: Array = np.empty((0, 2))
        self._before: dict[int, Array] = {}

    @property
    def sees(self) -> bool:
        """Whether the newest picture shows enough corners of the board."""
        from station.camera.lens_calibration import MIN_CORNERS

        return len(self._numbers) >= MIN_CORNERS

    @property
    def rests(self) -> bool:
        """Whether the board was at rest between the last two pictures."""
        moved = self._distance(self._before)
        return moved is not None and moved < REST * self.pictured.size[0]

    def look(self) -> None:
        """Find the board in a new picture, if there is one."""
        import cv2

        self.host.watch()
        picture = self.host.picture
        if picture is None or picture is self._picture:
            return
        self._picture, self.time = picture, picture.time
        decoded = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)
        if decoded is None:
            return
        self._before = dict(zip(self._numbers, self._pixels, strict=True))
        numbers, self._pixels = self._corners.find(np.asarray(decoded, np.uint8))
        self._numbers = tuple(numbers.tolist())

    def is_new(self) -> bool:
        """Return whether the pose of the board differs from that in every picture that counts."""
        if not self.sees:
            return False
        for view in self.pictured.views:
            near = self._distance(dict(zip(view.numbers.tolist(), view.pixels, strict=True)))
            if near is not None and near < NEW_PLACE * self.pictured.size[0]:
                return False
        return True

    def keep(self, name: str) -> None:
        """Count the newest picture, if it shows the board."""
        from station.camera.lens_calibration import View

        if self.sees:
            self.pictured.views.append(View(name, np.array(self._numbers, np.int64), self._pixels))

    def missing(self) -> str:
        """Return what the operator must do next; empty if the pictures suffice."""
        from station.camera.lens_calibration import MIN_COVERAGE, coverage

        views, name = self.pictured.views, self.host.name
        if problem := self.host.status().problem:
            return f"camera {name}: {problem}"
        if len(views) < ENOUGH_PICTURES:
            return (
                f"camera {name}: hold the board still at another place, also tilted: {len(views)} of {ENOUGH_PICTURES}"
                " pictures"
            )
        share = float(coverage(views, self.pictured.size).mean())
        if share < MIN_COVERAGE:
            return (
                f"camera {name}: hold the board near the empty parts of the picture: {100 * share:.0f} of"
                f" {100 * MIN_COVERAGE:.0f} %"
            )
        return ""

    def state(self) -> CameraBoardState:
        """Return what the camera has seen."""
        from station.camera.lens_calibration import coverage

        return CameraBoardState(
            pictures=len(self.pictured.views),
            corners=tuple((round(float(x), 1), round(float(y), 1)) for x, y in self._pixels),
            coverage=tuple(tuple(row) for row in coverage(self.pictured.views, self.pictured.size).tolist()),
        )

    def _distance(self, before: Mapping[int, Array]) -> float | None:
        """Return the mean distance of the corners from earlier ones [pixel]; None: fewer than four are in both."""
        common = [(pixel, before[number]) for number, pixel in zip(self._numbers, self._pixels, strict=True)
                  if number in before]  # fmt: skip
        if len(common) < 4:
            return None
        return float(np.mean([np.linalg.norm(pixel - earlier) for pixel, earlier in common]))
