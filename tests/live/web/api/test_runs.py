"""Run history over REST: list, notes, files; no name leaves the folder of runs."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.output import ResultFolder, label_of
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.recording.read import read_case
from tests.harness.root import ROOT
from tests.harness.serving import free_port
from tests.harness.waiting import NET


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record two runs of fig7 that last one second; the second run is stopped."""
    folder = tmp_path_factory.mktemp("runs")
    experiment = load_experiment("fig7")
    (case,) = experiment.cases
    case = case._replace(file=case.file.model_copy(update={"duration": 1.0, "settling": 0.0}))
    recording = run_case(case, 0, VirtualClock(), lambda _: None)
    for seed, completed in ((0, True), (1, False)):
        result = ResultFolder(folder, experiment, seed)
        one = recording._replace(completed=completed, cause="" if completed else "the line was cut")
        writer = result.assignment(case).writer()
        writer.write(one.rows)
        writer.close(label_of(completed=completed, cause=one.cause), one.cause)
        result.finish({
            "experiment": "fig7", "seed": seed, "completed": completed, "cases": {"regulation": summarise(one)},
        })  # fmt: skip
    return folder


@pytest.fixture(scope="module")
def client(runs: Path) -> Iterator[httpx.Client]:
    port = free_port()
    command = [sys.executable, "-m", "tests.harness.runs_server", str(runs), str(port)]
    with (
        subprocess.Popen(command, cwd=ROOT) as server,
        httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=NET) as client,
    ):
        deadline = time.monotonic() + 30.0
        while True:
            try:
                client.get("/api/runs")
                break
            except httpx.TransportError:
                assert server.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.05)
        yield client
        server.terminate()


def ids(client: httpx.Client, **query: str) -> list[str]:
    answer = client.get("/api/runs", params=query)
    assert answer.status_code == 200, answer.text
    return [run["id"] for run in answer.json()]


def test_runs_are_listed_newest_first_and_filtered(client, runs):
    names = sorted(path.name for path in runs.iterdir())
    assert ids(client) == names[::-1]
    assert ids(client, label="stopped") == names[1:]
    assert ids(client, experiment="fig7", label="complete") == names[:1]
    assert ids(client, text="LINE WAS CUT") == names[1:]
    assert ids(client, experiment="fig8") == []
    assert ids(client, limit="1") == names[1:]
    assert client.get("/api/runs", params={"limit": 0}).status_code == 422


def test_a_run_has_its_summary(client):
    answer = client.get("/api/runs/latest").json()

    assert (answer["experiment"], answer["label"], answer["cause"]) == ("fig7", "stopped", "the line was cut")
    assert answer["cases"] == ["regulation"]
    assert answer["summary"]["seed"] == 1
    assert len(answer["summary"]["cases"]["regulation"]["true_max_abs_error_mm"]) == 3


def test_a_run_has_errors_and_curves(client, runs):
    run = client.get("/api/runs", params={"label": "complete"}).json()[0]
    outcome, numbers = run["outcomes"]["regulation"], client.get(f"/api/runs/{run['id']}").json()["summary"]
    assert outcome["largest"] == numbers["cases"]["regulation"]["true_max_abs_error_mm"]
    answer = client.get(f"/api/runs/{run['id']}/curves")

    assert answer.status_code == 200, answer.text
    curve = answer.json()["regulation"]
    assert curve["against"] == outcome["against"] == "true"
    assert max(curve["error"]["value"]) == pytest.approx(outcome["largest_distance"], abs=1e-3)
    assert len(answer.content) < 20_000
    (runs / run["id"] / "curves.json").write_text("{", encoding="utf-8")
    assert client.get(f"/api/runs/{run['id']}/curves").json() == answer.json()
    assert client.get("/api/runs/none/curves").status_code == 404


def test_the_recording_of_a_run_is_downloaded_unchanged(client, runs, tmp_path):
    (name,) = ids(client, label="complete")
    answer = client.get(f"/api/runs/{name}/recording")

    assert answer.headers["content-disposition"] == f'attachment; filename="{name}-regulation.mcap"'
    (tmp_path / "x.mcap").write_bytes(answer.content)
    assert np.array_equal(read_case(tmp_path / "x.mcap").rows, read_case(runs / name / "regulation.mcap").rows)
    assert client.get(f"/api/runs/{name}/recording", params={"case": "regulation"}).content == answer.content
    missing = client.get(f"/api/runs/{name}/recording", params={"case": "lift"})
    assert missing.status_code == 404
    assert "'lift' is not one of the cases: regulation" in missing.json()["error"]


def test_notes_of_a_run_are_stored(client):
    (name,) = ids(client, label="complete")
    answer = client.put(f"/api/runs/{name}/notes", json={"notes": "new coil"})

    assert answer.json()["notes"] == client.get(f"/api/runs/{name}").json()["notes"] == "new coil"
    assert ids(client, text="new coil") == [name]
    assert client.put(f"/api/runs/{name}/notes", json={"notes": "x" * 20_001}).status_code == 422
    assert client.put(f"/api/runs/{name}/notes", json={"note": "x"}).status_code == 422
    tagged = client.put(f"/api/runs/{name}/notes", json={"tags": ["a", "b"], "starred": True}).json()
    assert (tagged["tags"], tagged["starred"], tagged["notes"]) == (["a", "b"], True, "new coil")


@pytest.mark.parametrize("format_", ["csv", "parquet", "mat"])
def test_a_recording_is_exported_in_every_format(client, format_):
    (name,) = ids(client, label="complete")
    answer = client.get(f"/api/runs/{name}/export", params={"format": format_, "case": "regulation"})
    assert answer.status_code == 200, answer.text
    assert f'filename="{name}-regulation.{format_}"' in answer.headers["content-disposition"]
    starts = {"csv": b"motion_time [s],time [s]", "parquet": b"PAR1", "mat": b"MATLAB 5.0"}
    assert answer.content.startswith(starts[format_])
    assert client.get(f"/api/runs/{name}/export", params={"format": "xls"}).status_code == 422


def test_a_report_is_rendered_once_and_is_self_contained(client, runs):
    (name,) = ids(client, label="complete")
    answer = client.get(f"/api/runs/{name}/report")

    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/html")
    assert answer.headers["content-security-policy"].startswith("default-src 'none'")
    assert "fig7" in answer.text
    made = (runs / name / "report.html").stat().st_mtime_ns
    assert client.get(f"/api/runs/{name}/report").text == answer.text
    assert (runs / name / "report.html").stat().st_mtime_ns == made


def test_a_missing_report_has_a_reason(client, runs):
    folder = runs / "spoilt"
    folder.mkdir()
    (folder / "summary.json").write_text("{", encoding="utf-8")
    try:
        answer = client.get("/api/runs/spoilt/report")
        assert answer.status_code == 422
        assert "the report of run 'spoilt' failed" in answer.json()["error"]
    finally:
        client.delete("/api/runs/spoilt", params={"confirm": "spoilt"})


def test_a_run_is_deleted_only_with_its_name_as_confirmation(client, runs):
    folder = runs / "old"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps({"started": 0, "bad": float("nan")}), encoding="utf-8")
    assert client.get("/api/runs/old").json()["summary"] == {"started": 0, "bad": None}
    for confirm in ("", "latest", "new"):
        answer = client.delete("/api/runs/old", params={"confirm": confirm})
        assert answer.status_code == 422
        assert "confirm" in answer.json()["error"]
    assert folder.exists()
    assert client.delete("/api/runs/old", params={"confirm": "old"}).json() == {"deleted": "old"}
    assert not folder.exists()
    assert "old" in [run["id"] for run in client.get("/api/runs", params={"deleted": True}).json()]
    assert client.post("/api/runs/old/restore", json={}).json()["id"] == "old"
    assert folder.exists()
    assert client.delete("/api/runs/old", params={"confirm": "old"}).status_code == 200


@pytest.mark.parametrize("name", ["none", "..", "%2e%2e", "..%2f..%2fetc", "%2fetc%2fpasswd", "a%00b", "x" * 5000])
def test_the_name_of_a_run_cannot_address_files_outside_the_runs_folder(client, name):
    before = ids(client)
    for answer in (
        client.get(f"/api/runs/{name}/recording"),
        client.get(f"/api/runs/{name}/report"),
        client.put(f"/api/runs/{name}/notes", json={"notes": "x"}),
        client.delete(f"/api/runs/{name}", params={"confirm": name}),
    ):
        assert answer.status_code in (404, 405)
    assert ids(client) == before
