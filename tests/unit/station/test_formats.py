"""Files of earlier versions are read; files of later formats are refused with an instruction.

`tests/kept/VERSION` has files that each version has written: robot, lab, station, an experiment with its run, and a
calibration.
"""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import pytest

from station.calibration.results import Results
from station.client import Station, StationError
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.control.bench_calibration import REGISTRATION_FILE, ROBOT_FILE, SENSORS_FILE, BenchCalibration
from station.experiments.experiment import load_experiment
from station.lab.config import load_lab
from station.recording.export import export_run
from station.recording.metadata import FORMAT
from station.recording.read import open_case, read_case
from station.recording.recover import unrecoverable
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.writer import PARTIAL_SUFFIX
from station.report.run import read_run
from station.service.station_file import load_station
from tests.harness.recordings import channels, make_rows, open_writer, recorded

__all__ = ["channels", "make_rows", "open_writer", "recorded"]

KEPT = Path(__file__).parents[2] / "kept"
VERSIONS = sorted(KEPT.iterdir())


@pytest.mark.parametrize("version", VERSIONS, ids=lambda path: path.name)
def test_station_of_an_earlier_version_is_read_with_its_robot_lab_and_experiment(version: Path):
    bench = load_station(version / "station.toml").bench()
    assert (bench.robot.name, bench.lab.title, bench.seed) == ("mine", "virtual lab: mine", 1)
    (case,) = load_experiment(str(version / "short.toml")).cases
    assert (case.robot, case.lab) == (bench.robot, bench.lab)


@pytest.mark.parametrize("version", VERSIONS, ids=lambda path: path.name)
def test_calibration_of_an_earlier_version_is_read_and_listed(version: Path):
    known = BenchCalibration.load(version / "calibration", load_robot(str(version / "robot.toml")))
    assert known.registration is not None
    assert known.registration.position == pytest.approx([0.0, 0.0, -0.2], abs=0.002)
    assert known.robot.tubes[0].bending_stiffness == pytest.approx(
        1.05 * 0.0147, rel=0.01
    )  # the calibration has found the stiffness of its virtual lab
    assert known.corrections.sensors.weight == pytest.approx([0.000302091, -9.94554e-05])
    (kept,) = Results(version).all()
    assert (kept.name, kept.numbers.procedure) == ("calibration", "tubes")


@pytest.mark.parametrize("file", [REGISTRATION_FILE, SENSORS_FILE, ROBOT_FILE])
def test_calibration_without_a_format_is_read_and_a_later_format_is_refused(file: str, tmp_path: Path):
    described = load_robot(str(VERSIONS[-1] / "robot.toml"))
    folder = tmp_path / "calibration"
    shutil.copytree(VERSIONS[-1] / "calibration", folder)
    text = (folder / file).read_text(encoding="utf-8")
    assert text.count("\nformat = 1\n") == 1
    (folder / file).write_text(text.replace("\nformat = 1\n", "\n"), encoding="utf-8")
    assert BenchCalibration.load(folder, described).registration is not None
    (folder / file).write_text(text.replace("\nformat = 1\n", "\nformat = 2\nnew = 1\n"), encoding="utf-8")
    with pytest.raises(ConfigError, match=rf"{file}: format = 2 is later than 1.*; update ctr-station"):
        BenchCalibration.load(folder, described)


@pytest.mark.parametrize("version", VERSIONS, ids=lambda path: path.name)
def test_run_of_an_earlier_version_is_read_exported_and_reported(version: Path, tmp_path: Path):
    case = read_case(version / "run" / "short.mcap")
    assert (case.label, case.rows.shape[0]) == (RunOutcome.COMPLETE, 50)
    assert case.of("joints")[0] == pytest.approx((0.0, 1.5708, -0.05), abs=0.005)
    (table,) = export_run(version / "run", "csv", tmp_path)
    assert len(table.read_text().splitlines()) == 51
    (reported,) = read_run(version / "run").cases
    assert reported.file["load"] == {"kind": "constant", "magnitude": 0.1}


def test_recording_of_format_1_has_the_present_channel_names():
    case = read_case(KEPT / "0.1.0" / "run" / "short.mcap")
    names = [channel.name for channel in case.channels]
    assert names[3] == "estimates_frozen"
    at = names.index("request_kind")
    assert names[at : at + 5] == ["request_kind", "request_time", "request.x", "request.y", "request.z"]
    assert case.of("estimates_frozen").shape == (50, 1)
    assert case.of("request").shape == case.of("request_velocity").shape == (50, 3)
    for old in ("held", "asked_kind", "asked_time", "asked", "asked_velocity"):
        with pytest.raises(RecordingError, match=f"no channels '{old}'"):
            case.of(old)


def test_recording_states_its_format_and_a_later_format_is_refused(recorded, make_rows):
    with open_case(recorded(make_rows(3))) as case:
        assert case.metadata["format"] == FORMAT
    later = recorded(make_rows(3), "later", format=FORMAT + 1, versions={"ctr-station": "9.1"})
    with pytest.raises(RecordingError, match=r"later\.mcap: format = 4 is later than 3.*ctr-station 9\.1: update"):
        read_case(later)


def test_recovery_reports_and_does_not_change_a_run_of_a_later_format(open_writer, make_rows, tmp_path, call):
    """An older version must not write an index for data that it cannot interpret."""
    runs = tmp_path / "runs"
    for name, metadata in (("mine", {}), ("theirs", {"format": FORMAT + 1, "versions": {"ctr-station": "9.1"}})):
        writer = open_writer(name, **metadata)
        writer.write(make_rows(100))
        folder = runs / f"{name}{PARTIAL_SUFFIX}"
        folder.mkdir(parents=True)
        content = (tmp_path / f"{name}.mcap{PARTIAL_SUFFIX}").read_bytes()
        (folder / f"run.mcap{PARTIAL_SUFFIX}").write_bytes(content)
        writer.close(RunOutcome.COMPLETE)
    (sentence,) = unrecoverable(runs)
    assert sentence.startswith(
        f"{runs / 'theirs.partial'}: interrupted, and not recovered: run.mcap.partial: format = 4 is later"
    )
    assert "ctr-station 9.1: update this one" in sentence

    done = call("--data", str(runs), "export", "latest", "--format", "csv")
    assert done.status == 0
    assert done.err == f"ctr-station: {sentence}\n"
    assert sorted(path.name for path in runs.iterdir()) == ["mine", "theirs.partial"]
    assert [path.read_bytes() for path in (runs / "theirs.partial").iterdir()] == [content]


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("robot", lambda path: load_robot(str(path))),
        ("lab", lambda path: load_lab(str(path), load_robot("paper"))),
        ("station", load_station),
        ("short", lambda path: load_experiment(str(path))),
    ],
)
def test_file_of_a_later_format_is_refused_before_its_keys_are_checked(name, read, tmp_path: Path):
    text = (VERSIONS[-1] / f"{name}.toml").read_text(encoding="utf-8")
    path = tmp_path / f"{name}.toml"
    path.write_text(f'format = 2\nnot_known_yet = "x"\n{text}', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"format = 2 is later than 1.*\(line 1\); update ctr-station"):
        read(path)
    path.write_text(f"format = 0\n{text}", encoding="utf-8")
    with pytest.raises(ConfigError, match="format = 0"):
        read(path)


@contextmanager
def answering(status: dict[str, object]) -> Iterator[tuple[str, list[str]]]:
    """Run a server that answers every request with this status; yield its address and the requests."""
    requests: list[str] = []

    class Answer(BaseHTTPRequestHandler):
        def answer(self) -> None:
            requests.append(f"{self.command} {self.path}")
            body = json.dumps({"note": "", **status}).encode()
            self.send_response(200)
            self.send_header("content-length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_POST = do_DELETE = answer

        def log_message(self, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", requests
        server.shutdown()
        thread.join()


def test_client_sends_only_stop_to_a_station_with_a_later_rest_format():
    with answering({"format": 3}) as (url, requests), Station(url) as station:
        with pytest.raises(
            StationError, match=r"format 3, but this client supports at most format 2.*update ctr-station on this"
        ):
            station.tare()
        assert station.stop() == ""
    assert requests == ["GET /api/status", "POST /api/stop", "DELETE /api/operator"]


def test_client_accepts_a_station_that_reports_no_format():
    with answering({}) as (url, requests), Station(url) as station:
        station.tare()
        station.tare()
    assert requests == ["GET /api/status", "POST /api/tare", "POST /api/tare", "DELETE /api/operator"]
