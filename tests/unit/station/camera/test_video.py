"""Videos as MCAP: other readers decode them, a kill leaves them readable, and they are exported as MP4."""

import contextlib
import os
import shutil
from functools import cache
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory
from numpy.typing import NDArray

from core.robot.robot import Robot
from station.camera.video import (
    VideoWriter,
    camera_of,
    export_videos,
    next_video,
    read_frames,
    stills,
    write_mp4,
)
from station.devices.cameras import CameraFile, SimulationFile
from station.devices.projection import view_of
from station.lab.plant import TubeShape
from station.lab.rendering import Renderer
from station.recording.recover import recover, recover_file
from station.recording.run_folder import VIDEOS_FOLDER, free_space_problem
from station.recording.run_outcome import RecordingError
from tests.harness.camera_ball import ball_centre
from tests.harness.decoded_video import decode_frames
from tests.harness.full_disk import full_disk

CAMERA = CameraFile(width=320, height=240, rate=30.0, simulation=SimulationFile(noise=2.0, ball=0.01))
EPOCH = 1_700_000_000_000_000_000
#: Types of units in an H.264 stream: slice of a key frame, sequence and picture parameter sets.
KEY_SLICE, SEQUENCE_SET, PICTURE_SET = 5, 7, 8


def tip_at(number: int) -> NDArray[np.float64]:
    return np.array([0.0006 * number - 0.03, 0.0, 0.12])


@cache
def pictures(robot: Robot, count: int) -> list[NDArray[np.uint8]]:
    """Return pictures of straight tubes whose tip moves down."""
    view = view_of(CAMERA)
    assert view is not None
    renderer = Renderer(robot, CAMERA, view, 0)
    shapes: list[TubeShape] = []
    for number in range(count):
        tip = tip_at(number)
        tangent = tip / np.linalg.norm(tip)
        line = np.array([[0.0, 0.0, 0.0, 0.0, *tangent], [float(np.linalg.norm(tip)), *tip, *tangent]])
        shapes.append(TubeShape(line, line[-1:, 0].repeat(2), np.zeros(3), np.inf))
    return [renderer.render(shape) for shape in shapes]


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory, paper_robot: Robot) -> Path:
    """Return a video of 65 frames in the folder of a run."""
    path = tmp_path_factory.mktemp("video") / "run" / VIDEOS_FOLDER / "side.mcap"
    path.parent.parent.mkdir()
    writer = VideoWriter(path, "side", CAMERA, EPOCH)
    for number, picture in enumerate(pictures(paper_robot, 65)):
        writer.write(picture, 100.0 + number / 30.0)
    assert not path.exists()
    writer.close()
    assert writer.frames == 65
    return path


def units(data: bytes) -> list[int]:
    """Return the types of the units in an H.264 stream in Annex B."""
    return [part[0] & 31 for part in data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")[1:]]


def test_every_frame_decodes_and_shows_the_ball_at_its_time(video: Path) -> None:
    view = view_of(CAMERA)
    assert view is not None
    decoded = list(decode_frames(video))

    assert len(decoded) == 65
    for number, (stamp, picture) in enumerate(decoded):
        assert abs(stamp - EPOCH - 1e9 * (100.0 + number / 30.0)) < 1e3
        assert np.abs(ball_centre(picture) - view.project(tip_at(number)[None])[0]).max() < 1.0


def test_stills_are_the_frames_nearest_to_their_times(video: Path) -> None:
    """Times before and after a key frame; times outside of the video have its first or last frame."""
    view = view_of(CAMERA)
    assert view is not None
    numbers = [29.4, 0.0, 30.0, 64.0, -20.0, 90.0]
    found = stills(video, [EPOCH + round(1e9 * (100.0 + number / 30.0)) for number in numbers])

    for (stamp, picture), expected in zip(found, [29, 0, 30, 64, 0, 64], strict=True):
        assert stamp == pytest.approx(EPOCH + 1e9 * (100.0 + expected / 30.0), abs=1e3)
        assert np.abs(ball_centre(picture) - view.project(tip_at(expected)[None])[0]).max() < 1.0


def test_a_video_has_the_settings_of_its_camera(video: Path) -> None:
    assert camera_of(video) == ("side", CAMERA)


def test_each_message_is_one_frame_and_each_key_frame_starts_with_its_parameter_sets(video: Path) -> None:
    frames = list(read_frames(video))
    kinds = [units(frame.data) for frame in frames]

    keys = [number for number, kind in enumerate(kinds) if KEY_SLICE in kind]
    assert keys == [0, 30, 60]
    assert all(kinds[number].index(SEQUENCE_SET) < kinds[number].index(KEY_SLICE) for number in keys)
    assert all(PICTURE_SET in kinds[number] for number in keys)
    # A decoder that starts at a key frame needs no earlier message, and no message needs a later one.
    decoder = av.CodecContext.create("h264", "r")
    found = [len(decoder.decode(av.Packet(frame.data))) for frame in frames[30:]]
    assert sum(found) + len(decoder.decode(None)) == 35


def test_video_is_decoded_by_other_readers_with_its_calibration(video: Path) -> None:
    with video.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert {channel.topic for channel in summary.channels.values()} == {
            "/camera/side/video",
            "/camera/side/calibration",
            "/tf",
        }
        messages = [one for *_, one in reader.iter_decoded_messages(topics=["/camera/side/video"])]
        (first, *_) = [one for *_, one in reader.iter_decoded_messages(topics=["/camera/side/calibration"])]

    assert len(messages) == 65
    assert {message.format for message in messages} == {"h264"}
    assert {message.frame_id for message in messages} == {"camera_side"}
    assert (first.width, first.height, first.distortion_model) == (320, 240, "plumb_bob")
    assert list(first.K) == [320.0, 0.0, 160.0, 0.0, 320.0, 120.0, 0.0, 0.0, 1.0]
    assert list(first.D) == [0.0] * 5


def test_video_of_a_killed_camera_is_recovered_and_a_written_one_is_left_alone(
    tmp_path: Path, paper_robot: Robot
) -> None:
    folder = tmp_path / "run" / VIDEOS_FOLDER
    folder.parent.mkdir()
    frames = pictures(paper_robot, 65)
    process = os.fork()
    if process == 0:
        writer = VideoWriter(folder / "side.mcap", "side", CAMERA, EPOCH)
        for number, picture in enumerate(frames):
            writer.write(picture, 100.0 + number / 30.0)
        os._exit(0)  # like a kill: nothing is finished
    os.waitpid(process, 0)
    writer = VideoWriter(folder / "top.mcap", "top", CAMERA, EPOCH)
    try:
        recover(tmp_path)
        assert sorted(path.name for path in folder.iterdir()) == ["side.mcap", "top.mcap.partial"]
        assert 65 - 16 <= len(list(decode_frames(folder / "side.mcap"))) <= 65
    finally:
        writer.close()


def test_damaged_part_of_a_video_loses_its_frames_up_to_the_next_key_frame_only(video: Path, tmp_path: Path) -> None:
    content = video.read_bytes()
    whole = [frame.time for frame in read_frames(video)]
    keys = [frame.time for frame in read_frames(video) if SEQUENCE_SET in units(frame.data)]
    with video.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    assert len(chunks) >= 4
    for chunk in chunks:
        middle = chunk.chunk_start_offset + chunk.chunk_length // 2
        damaged = tmp_path / "damaged.mcap"
        damaged.write_bytes(content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :])
        shutil.copy(damaged, tmp_path / "recovered.mcap.partial")
        recovered = recover_file(tmp_path / "recovered.mcap.partial")
        assert recovered is not None
        for path in (damaged, recovered):
            frames = [frame.time for frame in read_frames(path)]
            key = next((time for time in keys if time > chunk.message_end_time), np.inf)
            assert frames == [time for time in whole if time < chunk.message_start_time or time >= key]
            assert len(list(decode_frames(path))) == len(frames)
        recovered.unlink()


def test_video_survives_the_renaming_of_its_folder(tmp_path: Path, paper_robot: Robot) -> None:
    partial = tmp_path / "run.partial"
    partial.mkdir()
    writer = VideoWriter(partial / VIDEOS_FOLDER / "side.mcap", "side", CAMERA, EPOCH)
    picture = pictures(paper_robot, 1)[0]
    writer.write(picture, 100.0)
    partial.rename(tmp_path / "run")
    writer.write(picture, 100.1)
    writer.close()

    assert len(list(read_frames(tmp_path / "run" / VIDEOS_FOLDER / "side.mcap"))) == 2


def test_full_disk_ends_the_video_with_the_reason_and_keeps_its_chunks(tmp_path: Path, paper_robot: Robot) -> None:
    (tmp_path / "run").mkdir()
    path = tmp_path / "run" / VIDEOS_FOLDER / "side.mcap"
    writer = VideoWriter(path, "side", CAMERA, EPOCH)
    frames = pictures(paper_robot, 65)

    def fill() -> None:
        for number in range(650):
            writer.write(frames[number % 65], 100.0 + number / 30.0)

    with full_disk(60_000):
        with pytest.raises(RecordingError, match="camera side: the video has ended"):
            fill()
        with contextlib.suppress(RecordingError):  # the end of the file may fit
            writer.close()
    recover(tmp_path)
    assert len(list(decode_frames(path))) > 15


def test_mp4_has_every_frame_at_its_time(video: Path, tmp_path: Path) -> None:
    (target,) = export_videos(video.parent.parent, tmp_path)
    assert target == tmp_path / "side.mp4"

    with av.open(target) as file:
        times = [float(frame.time) for frame in file.decode(video=0)]
    assert np.allclose(times, np.arange(65) / 30.0, atol=1e-4)
    capture = cv2.VideoCapture(str(target))
    assert capture.read()[0]
    capture.release()


def test_export_of_a_run_without_the_video_is_refused(tmp_path: Path, video: Path) -> None:
    with pytest.raises(RecordingError, match="the run has no video"):
        export_videos(tmp_path, None)
    with pytest.raises(RecordingError, match="no video 'front'; the videos are side"):
        export_videos(video.parent.parent, None, "front")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(video.read_bytes()[:2000])
    with pytest.raises(RecordingError, match="damaged"):
        write_mp4(damaged, tmp_path / "x.mp4")


def test_next_video_of_a_replaced_camera_has_a_number(tmp_path: Path) -> None:
    assert next_video(tmp_path, "side").name == "side.mcap"
    (tmp_path / "side.mcap.partial").touch()
    assert next_video(tmp_path, "side").name == "side-2.mcap"


def test_bit_rate_is_bounded_and_counted_before_the_start(video: Path, tmp_path: Path) -> None:
    size, duration = sum(len(frame.data) for frame in read_frames(video)), 65 / 30.0
    assert 8.0 * size < 1.5 * CAMERA.video_bit_rate * duration  # one second of the rate may be saved in the buffer

    free = os.statvfs(tmp_path).f_bavail * os.statvfs(tmp_path).f_frsize
    assert free_space_problem(tmp_path, 10.0, videos=0.0) == ""
    assert "MB are free" in free_space_problem(tmp_path, 10.0, videos=free / 5.0)
