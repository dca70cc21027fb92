"""Files, recordings and stations of later formats are refused with an instruction."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread

import pytest

from station.calibration.files import carry_over, new_folder
from station.client import Station, StationError
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.control.bench_calibration import REGISTRATION_FILE, BenchCalibration
from station.experiments.experiment import load_experiment
from station.lab.config import load_lab
from station.recording.dataset import export_dataset
from station.recording.history import RunHistory
from station.recording.metadata import FORMAT
from station.recording.read import open_case, read_case
from station.recording.recover import recover
from station.recording.run_folder import MARK_FILE, MARK_TEXT
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.writer import PARTIAL_SUFFIX
from station.report.run import experiment_text, read_json
from station.service.station_file import load_station
from tests.harness.recordings import channels, make_rows, open_writer, recorded

__all__ = ["channels", "make_rows", "open_writer", "recorded"]

#: Encodings with a byte order mark, in which editors save files.
MARKED = ("utf-8-sig", "utf-16")


def test_recording_states_its_format_and_a_later_format_is_refused(recorded, make_rows):
    with open_case(recorded(make_rows(3))) as case:
        assert case.metadata["format"] == FORMAT
    later = recorded(make_rows(3), "later", format=FORMAT + 1, versions={"ctr-station": "9.1"})
    with pytest.raises(RecordingError, match=r"later\.mcap: format = 2 is later than 1.*ctr-station 9\.1: update"):
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
        (folder / MARK_FILE).write_text(MARK_TEXT, encoding="utf-8")
        writer.close(RunOutcome.COMPLETE)
    done = call("--data", str(runs), "export", "latest", "--format", "csv")
    assert done.status == 0
    (sentence,) = recover(runs).problems
    assert done.err == f"ctr-station: {sentence}\n"
    assert sentence.startswith(
        f"{runs / 'theirs.partial'}: interrupted, and not recovered: run.mcap.partial: format = 2 is later"
    )
    assert "ctr-station 9.1: update this ctr-station" in sentence
    assert sorted(path.name for path in runs.iterdir()) == ["mine", "theirs.partial"]
    assert (runs / "theirs.partial" / f"run.mcap{PARTIAL_SUFFIX}").read_bytes() == content


@pytest.mark.parametrize("encoding", ["utf-8", *MARKED])
@pytest.mark.parametrize(
    "read",
    [
        lambda path: load_robot(str(path)),
        lambda path: load_lab(str(path), load_robot("paper")),
        load_station,
        lambda path: load_experiment(str(path)),
        lambda path: BenchCalibration.load(path.parent, load_robot("paper")),
    ],
    ids=["robot", "lab", "station", "experiment", "calibration"],
)
def test_file_of_a_later_format_is_refused_before_its_keys_are_checked(read, encoding, tmp_path: Path):
    path = tmp_path / REGISTRATION_FILE
    path.write_text('format = 2\nnot_known_yet = "x"\n', encoding=encoding)
    with pytest.raises(ConfigError, match=r"format = 2 is later than 1.*\(line 1\); update ctr-station"):
        read(path)
    path.write_text("format = 0\n", encoding=encoding)
    with pytest.raises(ConfigError, match="format = 0"):
        read(path)


def listed_run(path: Path) -> object:
    return RunHistory(path.parents[1]).run(path.parent.name).model_dump(exclude={"size", "started"})


@pytest.mark.parametrize("encoding", MARKED)
@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("summary.json", '{"title": "Röhre", "label": "stopped"}', read_json),
        ("summary.json", '{"title": "Röhre", "label": "stopped"}', listed_run),
        ("notes.json", '{"notes": "Röhre", "starred": true}', listed_run),
        ("experiment.toml", "title = 'Röhre'", lambda path: experiment_text(path.parent)),
        ("errors.csv", "line,tip_x\n1,0.5\n", lambda path: export_dataset(path.parent, None, "CC0")[0].read_bytes()),
        ("robot.toml", "a = 1", lambda path: carry_over(path.parent, new_folder(path.parent, "x"))[0].read_bytes()),
    ],
)
def test_file_with_a_byte_order_mark_is_read_like_a_file_without(name, text, read, encoding, tmp_path: Path):
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "summary.json").write_text("{}")
    path = tmp_path / "one" / name
    found = []
    for each in ("utf-8", encoding):
        path.write_text(text, encoding=each)
        found.append(read(path))
    assert found[0] == found[1]


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
    with answering({"format": 2}) as (url, requests), Station(url) as station:
        with pytest.raises(
            StationError, match=r"format 2, but this client supports at most format 1.*update ctr-station on this"
        ):
            station.tare()
        assert station.stop() == ""
    assert requests == ["GET /api/status", "POST /api/stop", "DELETE /api/operator"]
