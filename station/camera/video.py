"""Video of one camera during a run: H.264 in an MCAP file next to the run's recording, and its export as MP4.

The video has its own file, `cameras/NAME.mcap` in the run's folder, which the camera's process writes. So a camera that
fills the disk, hangs or is killed never damages the telemetry of the run. Both files have the same time, so Foxglove
shows them together. The file consists of chunks like the other recordings, so a kill loses only the last chunk.

Each frame is a message without references to later frames, and each key frame starts with the parameter sets.
"""

import os
import struct
import time
from collections.abc import Iterator, Sequence
from fractions import Fraction
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
from av.error import FFmpegError
from av.video.codeccontext import VideoCodecContext

from core.robot.robot import Array
from station.devices.cameras import CameraFile
from station.devices.projection import view_of
from station.lab.rendering import Picture
from station.recording.chunks import chunks_with, messages
from station.recording.data_section import NO_ROWS, DataSection, Topic, WrittenMessage
from station.recording.drawing import quaternion_of
from station.recording.foxglove import FrameTransforms, json_topic
from station.recording.metadata import texts, values_of, versions
from station.recording.read import indexed, undamaged
from station.recording.run_folder import RECORDING_SUFFIX, replacing, video_files
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.summary import finish_file
from station.recording.writer import PARTIAL_SUFFIX
from station.regular_file import open_in

#: Interval between two chunks, and between two key frames or calibration messages [s].
CHUNK_INTERVAL_S, KEY_INTERVAL_S = 0.5, 1.0
#: Quality of the video: libx264's constant rate factor, 0 ... 51, lower is better.
QUALITY = 23
#: Unit of the frames' times in the encoder [s].
TIME_BASE = Fraction(1, 1_000_000)
#: H.264 type of the unit with which a key frame starts: its sequence parameter set.
SEQUENCE_SET = 7
VIDEO, CALIBRATION, TRANSFORM = 1, 2, 3  #: ids of the MCAP topics
VIDEO_SCHEMA = "foxglove_msgs/CompressedVideo"
VIDEO_DEFINITION = "time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
CALIBRATION_SCHEMA = "foxglove_msgs/CameraCalibration"
CALIBRATION_DEFINITION = (
    "time timestamp\nstring frame_id\nuint32 width\nuint32 height\nstring distortion_model\n"
    "float64[] D\nfloat64[9] K\nfloat64[9] R\nfloat64[12] P\n"
)


def video_topic(name: str) -> str:
    """Return the MCAP topic of a camera's video."""
    return f"/camera/{name}/video"


class VideoWriter:
    """Writes the video of one camera; only this process may use it."""

    def __init__(self, path: Path, name: str, camera: CameraFile, epoch: int) -> None:
        """Create the file under its provisional name.

        Args:
            path: final path of the file.
            name: name of the camera.
            camera: size, rate, lens and pose.
            epoch: wall time at which the station's clock was 0 [ns since 1970].

        Raises:
            RecordingError: the file cannot be created.
        """
        self._name, self._camera, self._epoch = name, camera, epoch
        self._encoder = _encoder(camera)
        self._messages: list[WrittenMessage] = []
        self._flushed = self._calibrated = -np.inf  # exposures of the last chunk and of the last calibration [s]
        self._first: float | None = None
        self.frames = 0  #: number of frames that were written
        frame_id = f"camera_{name}"
        self._frame_id, self._transforms = frame_id, FrameTransforms((frame_id,))
        self._calibration = _calibration(camera, frame_id)
        topics = (
            Topic(video_topic(name), "ros1", VIDEO_SCHEMA, "ros1msg", VIDEO_DEFINITION),
            Topic(f"/camera/{name}/calibration", "ros1", CALIBRATION_SCHEMA, "ros1msg", CALIBRATION_DEFINITION),
            json_topic("/tf", "foxglove.FrameTransforms"),
        )
        about = {"name": name, "started": time.time(), "versions": versions(), **camera.model_dump(mode="json")}
        try:
            path.parent.mkdir(exist_ok=True)
            # The run's folder is renamed during the recording; its descriptor stays valid.
            self._folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
            self._path = Path(f"/proc/self/fd/{self._folder}", path.name)
            partial = self._path.with_name(path.name + PARTIAL_SUFFIX)
            self._section = DataSection(partial, {"camera": texts(about)}, topics)
        except OSError as error:
            raise RecordingError(f"camera {name}: cannot be recorded: {error.strerror}") from None

    def write(self, picture: Picture, exposed: float) -> None:
        """Encode a frame that was exposed at the time `exposed` of the station's clock [s].

        Raises:
            RecordingError: the disk is full; the video has ended with the last complete chunk.
        """
        self._first = exposed if self._first is None else self._first
        stamp = self._epoch + round(1e9 * exposed)
        if self._calibration and exposed - self._calibrated >= KEY_INTERVAL_S:
            self._calibrated = exposed
            self._messages += self._view_messages(stamp)
        planes = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420), np.uint8)
        frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        frame.pts, frame.time_base = round((exposed - self._first) / TIME_BASE), TIME_BASE
        for packet in self._encoder.encode(frame):
            self._messages.append(WrittenMessage(VIDEO, stamp, _video_message(stamp, self._frame_id, bytes(packet))))
            self.frames += 1
        if exposed - self._flushed >= CHUNK_INTERVAL_S:
            self._flushed = exposed
            self._flush()

    def close(self) -> None:
        """Finish the file.

        Raises:
            RecordingError: the disk is full; the next recovery finishes the file.
        """
        try:
            self._flush()
            self._section.cut()
            result = {"label": RunOutcome.COMPLETE, "cause": "", "ended": time.time(), "frames": self.frames}
            finish_file(self._section.file, texts(result))
            self._section.path.rename(self._path)
        except OSError as error:
            raise RecordingError(f"camera {self._name}: the video cannot be finished: {error.strerror}") from None
        finally:
            self._section.close()  # unlocks the file: only now a recovery may take it
            os.close(self._folder)

    def _flush(self) -> None:
        messages, self._messages = self._messages, []
        try:
            self._section.write_chunk(NO_ROWS, VIDEO, messages)
        except OSError as error:
            raise RecordingError(f"camera {self._name}: the video has ended: {error.strerror}") from None

    def _view_messages(self, stamp: int) -> Iterator[WrittenMessage]:
        """Yield the calibration of the lens and the pose of the camera."""
        view = view_of(self._camera)
        if view is not None:
            yield WrittenMessage(CALIBRATION, stamp, _time(stamp) + self._calibration)
            pose = (view.position.tolist(), quaternion_of(view.rotation.T))
            yield WrittenMessage(TRANSFORM, stamp, self._transforms.message(stamp, [pose]))


def _encoder(camera: CameraFile) -> VideoCodecContext:
    encoder: VideoCodecContext = av.CodecContext.create("libx264", "w")  # pyright: ignore[reportAssignmentType]
    encoder.width, encoder.height, encoder.pix_fmt = camera.width, camera.height, "yuv420p"
    encoder.time_base, encoder.framerate = TIME_BASE, Fraction(camera.rate).limit_denominator(1000)
    encoder.thread_count = 1
    kilobits, gop = round(camera.video_bit_rate / 1000.0), max(1, round(KEY_INTERVAL_S * camera.rate))
    parameters = f"repeat-headers=1:annexb=1:bframes=0:scenecut=0:vbv-maxrate={kilobits}:vbv-bufsize={kilobits}"
    encoder.options = {
        "preset": "ultrafast", "tune": "zerolatency", "crf": str(QUALITY), "g": str(gop), "bf": "0",
        "x264-params": parameters,
    }  # fmt: skip
    return encoder


def _time(stamp: int) -> bytes:
    return struct.pack("<II", *divmod(stamp, 10**9))


def _text(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def _video_message(stamp: int, frame_id: str, data: bytes) -> bytes:
    return _time(stamp) + _text(frame_id) + struct.pack("<I", len(data)) + data + _text("h264")


def _calibration(camera: CameraFile, frame_id: str) -> bytes:
    """Return a CameraCalibration message without its time; empty if lens and pose are not known."""
    view = view_of(camera)
    if view is None:
        return b""
    projection = np.zeros((3, 4))
    projection[:, :3] = view.matrix
    numbers: list[Array] = [view.matrix, np.eye(3), projection]
    head = _text(frame_id) + struct.pack("<II", camera.width, camera.height) + _text("plumb_bob")
    distortion = struct.pack("<I", len(view.distortion)) + view.distortion.astype("<f8").tobytes()
    return head + distortion + b"".join(each.astype("<f8").tobytes() for each in numbers)


class RecordedFrame(NamedTuple):
    """Encoded frame of a video."""

    time: int  #: wall time of the exposure [ns since 1970]
    data: bytes  #: H.264 in Annex B


def read_frames(path: Path) -> Iterator[RecordedFrame]:
    """Yield the encoded frames of a video file in the order of their time.

    Damaged frames are left out, and so are the following ones up to the next key frame, which depend on them.

    Raises:
        RecordingError: the file cannot be read or is not a video of this program.
    """
    with undamaged(path), open_in(path.parent, path.name) as file, indexed(file) as recording:
        whole = False  # the first frame is a key frame, unless it is damaged
        for content in chunks_with(recording.file, recording.summary, VIDEO):
            whole = whole and content is not None
            for message in messages(content or b"", VIDEO):
                frame = _recorded_frame(message.time, message.data(content or b""))
                whole = whole or _is_key(frame.data)
                if whole:
                    yield frame


def _recorded_frame(stamp: int, data: bytes) -> RecordedFrame:
    """Return the frame in a message that `_video_message` has created."""
    (length,) = struct.unpack_from("<I", data, 8)
    start = 12 + length
    (size,) = struct.unpack_from("<I", data, start)
    return RecordedFrame(stamp, data[start + 4 : start + 4 + size])


def stills(path: Path, times: Sequence[int]) -> list[tuple[int, Picture]]:
    """Return the frames nearest to the wall times `times` [ns since 1970]: wall time [ns] and picture
    (rows, columns, 3), blue, green, red.

    Only these frames and those since the key frame before each are decoded. A video without frames has no stills.

    Raises:
        RecordingError: the file cannot be read.
    """
    stamps = np.array([frame.time for frame in read_frames(path)])
    if len(stamps) == 0:
        return []
    wanted = [int(np.abs(stamps - time).argmin()) for time in times]
    found: dict[int, tuple[int, Picture]] = {}
    group: list[tuple[int, RecordedFrame]] = []  # the frames since the last key frame, with their numbers
    for number, frame in enumerate(chain(read_frames(path), [None])):
        if frame is None or _is_key(frame.data):
            for last in {one for one in wanted if group and group[0][0] <= one <= group[-1][0]}:
                found[last] = _decoded([frame for number, frame in group if number <= last])
            group = []
        if frame is not None:
            group.append((number, frame))
    return [found[one] for one in wanted]


def _is_key(data: bytes) -> bool:
    """Return whether a frame starts with the parameter sets of a key frame."""
    return data[4:5] != b"" and data[4] & 31 == SEQUENCE_SET


def _decoded(frames: Sequence[RecordedFrame]) -> tuple[int, Picture]:
    """Return time and picture of the last of successive frames; the first frame must be a key frame."""
    decoder: Any = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    pictures = [one for frame in frames for one in decoder.decode(av.Packet(frame.data))]
    pictures += decoder.decode(None)
    if not pictures:
        raise RecordingError("a key frame of the video cannot be decoded")
    return frames[-1].time, pictures[-1].to_ndarray(format="bgr24")


def camera_of(path: Path) -> tuple[str, CameraFile]:
    """Return name and settings of the camera of a video file.

    Raises:
        RecordingError: the file cannot be read or is not a video of this program.
    """
    with undamaged(path), open_in(path.parent, path.name) as file, indexed(file) as recording:
        values = values_of(recording.metadata["camera"])
        known = {key: value for key, value in values.items() if key in CameraFile.model_fields}
        return str(values["name"]), CameraFile.model_validate(known, strict=False)


def write_mp4(path: Path, target: Path) -> int:
    """Write a video file as MP4 without encoding it again; return the number of frames.

    Raises:
        RecordingError: the video cannot be read or has no frames, or the disk is full.
    """
    frames = list(read_frames(path))
    if not frames:
        raise RecordingError(f"{path}: the video has no frames")
    stream = BytesIO(b"".join(frame.data for frame in frames))
    try:
        with (
            replacing(target) as unfinished,
            av.open(stream, "r", format="h264") as source,
            av.open(unfinished, "w", format="mp4") as out,
        ):
            template = source.streams.video[0]
            written = out.add_stream_from_template(template)
            written.time_base = TIME_BASE
            packets = (packet for packet in source.demux(template) if packet.size)
            for frame, packet in zip(frames, packets, strict=False):
                packet.stream, packet.time_base = written, TIME_BASE
                packet.pts = packet.dts = round((frame.time - frames[0].time) / 1e3)
                out.mux(packet)
    except (OSError, FFmpegError) as error:
        raise RecordingError(f"{target}: cannot be written: {error}") from None
    return len(frames)


def export_videos(folder: Path, out: Path | None, camera: str = "") -> list[Path]:
    """Write the videos of a run as `NAME.mp4`, and return their paths.

    Args:
        folder: folder of the run.
        out: folder for the files; None: the folder of the run.
        camera: name of the only camera to write; empty: all cameras.

    Raises:
        RecordingError: the run has no such video, one cannot be read, or the disk is full.
    """
    videos = {path.stem: path for path in video_files(folder)}
    if not videos:
        raise RecordingError(f"{folder}: the run has no video; add a camera to the station file before a run")
    if camera and camera not in videos:
        raise RecordingError(f"{folder}: there is no video '{camera}'; the videos are {', '.join(videos)}")
    target = out or folder
    target.mkdir(parents=True, exist_ok=True)
    chosen = {name: path for name, path in videos.items() if camera in ("", name)}
    for name, path in chosen.items():
        write_mp4(path, target / f"{name}.mp4")
    return [target / f"{name}.mp4" for name in chosen]


def next_video(folder: Path, name: str) -> Path:
    """Return the path of a camera's next video in the folder `cameras` of a run.

    A camera whose process was replaced during a run has several videos: `NAME`, `NAME-2` and so on.
    """
    number = 1
    while True:
        path = folder / f"{name if number == 1 else f'{name}-{number}'}{RECORDING_SUFFIX}"
        if not path.exists() and not path.with_name(path.name + PARTIAL_SUFFIX).exists():
            return path
        number += 1
