"""Procedures on a station that really runs, with a virtual lab that hides what has to be found."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from core.calibration.commissioning import find_latency
from core.statics import Statics
from station.calibration.course import Report, Stage
from station.calibration.live import LiveCalibration, believed_mount
from station.calibration.plan import Subject
from station.calibration.results import Results
from station.calibration.still_lab import StillLab
from station.lab.loads import NoLoad
from station.lab.simulated_aurora_coil import MOUNT
from station.states import RefusedError, State
from station.station_file import load_station
from station.supervisor import Supervisor
from station.task import Phase

#: What nobody tells the station; the tubes are as described, so that the model's tip is good enough for the latency.
HIDDEN = """
[plant]
poisson_ratio = 0.30
tubes = { inner = {}, outer = {} }
[hidden]
registration_translation = 0.3e-3
registration_rotation = 5.236e-3
rotation_zero = 17.5e-3
tracker_latency = 0.020
"""
SEED = 3
PATIENT = {"hold_in_a_row": 1000, "hold_share": 1.0, "fault_in_a_row": 5000}


@pytest.fixture(scope="module")
def supervisor(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Supervisor]:
    folder = tmp_path_factory.mktemp("live")
    (folder / "lab.toml").write_text(HIDDEN, encoding="utf-8")
    changes = {"lab": str(folder / "lab.toml"), "seed": SEED, "overruns": PATIENT}
    supervisor = Supervisor(load_station(None, changes).bench(), folder / "runs")
    try:
        supervisor.wait_ready(100.0)
        yield supervisor
    finally:
        supervisor.close()


@pytest.fixture
def live(supervisor: Supervisor, tmp_path: Path) -> Iterator[LiveCalibration]:
    if supervisor.status().state in (State.STOPPED, State.HOLD):
        supervisor.reset()
    until(lambda: supervisor.status().state is State.READY, 30.0)
    live = LiveCalibration(supervisor, tmp_path / "calibrations")
    yield live
    live.close()


def until(condition, timeout: float) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


def ended(live: LiveCalibration, timeout: float) -> Report:
    until(lambda: not live.report.on, timeout)
    return live.report


def moving(live: LiveCalibration) -> None:
    """Wait until the first visit is on."""
    until(lambda: live.supervisor.status().state is State.RUNNING, 60.0)


def test_the_latency_that_nobody_told_is_found_and_written_down(live):
    ring, channels = live.supervisor.ring, live.supervisor.channels
    live.start("latency")
    moving(live)
    report, since, kept = live.report, ring.written, []
    assert report.on
    assert 0.0 < report.left < 60.0
    while live.report.on:
        rows, since, _ = ring.read(since)
        kept.append(rows)
        time.sleep(0.1)
    report, rows = live.report, np.concatenate(kept)
    assert (report.stage, report.done, report.says) == (Stage.DONE, 1.0, "")
    found = Results(live.folder).one(report.result)
    # The delay of the stages' own positions is in it: by how much the joints are ahead of the true tip.
    commanded = np.flatnonzero(np.abs(channels.of(rows, "velocity_commanded")).max(axis=1) > 0.0)
    swing, model = rows[commanded[0] : commanded[-1]], Statics(live.supervisor.robot)
    times = channels.of(swing, "time")[:, 0]
    tips = np.array([model.solve(pose, np.zeros(6)).tip for pose in channels.of(swing, "joints")])
    seen = (channels.of(swing, "truth_known")[:, 0] > 0.0) & (np.abs(times - times.mean()) < 7.0)
    ahead = find_latency(times, tips, times[seen], channels.of(swing, "tip_true")[seen]).latency
    assert found.numbers["latency_s"] - ahead == pytest.approx(0.020, abs=0.006)
    assert found.numbers["simulated"] is True
    assert set(found.files) == {"report.html", "report.json", "visits.json"}
    assert "latency" in found.use.text


def test_nobody_else_moves_the_robot_meanwhile_and_an_abort_leaves_nothing(live):
    supervisor = live.supervisor
    live.start("tracker", 0.5)
    moving(live)

    for asked in (
        lambda: live.start("axes"),
        lambda: supervisor.start(supervisor.task, NoLoad(), "another"),
        lambda: supervisor.jog("joints", np.zeros(3)),
        supervisor.tare,
        supervisor.home,
    ):
        with pytest.raises(RefusedError, match="'calibrate tracker' has the robot to itself"):
            asked()
    with pytest.raises(RefusedError, match="asks for anything"):
        live.done()
    live.abort()
    report = ended(live, 10.0)

    assert (report.stage, report.says) == (Stage.ABORTED, "aborted by the operator")
    assert supervisor.status().state is State.STOPPED
    assert not live.folder.exists()
    with pytest.raises(RefusedError, match="no procedure is on"):
        live.abort()
    supervisor.reset()
    until(lambda: supervisor.status().state is State.READY, 10.0)
    supervisor.tare()  # allowed again


def test_a_stop_ends_it_with_the_cause(live):
    live.start("tracker", 0.5)
    moving(live)

    live.supervisor.stop()

    report = ended(live, 10.0)
    assert report.stage is Stage.ABORTED
    assert "STOPPED: stopped by the operator" in report.says
    assert not live.folder.exists()


def test_a_stop_ends_it_while_it_thinks_even_if_it_is_reset_at_once(live):
    live.start("tracker", 0.5)
    live.supervisor.stop()
    live.supervisor.reset()

    report = ended(live, 10.0)
    assert report.stage is Stage.ABORTED
    assert "stopped" in report.says.lower()


def test_a_weight_is_hung_when_a_person_says_so_and_goes_with_an_abort(live):
    """The weight of the virtual lab's tip, felt by its force sensors."""
    live.start("force", 0.5, (0.5,))
    until(lambda: live.report.stage is Stage.ASKING or not live.report.on, 200.0)
    report, before = live.report, force(live)
    assert report.asked == "Hang a weight of 0.5 N at the tip."
    assert report.hangs == 0.5

    live.done()
    until(lambda: live.report.stage is not Stage.ASKING, 2.0)
    until(lambda: abs(np.linalg.norm(force(live) - before) - 0.5) < 0.1, 5.0)
    live.abort()

    assert "a weight of 0.5 N may hang at the tip: take it off" in ended(live, 5.0).says
    until(lambda: np.linalg.norm(force(live) - before) < 0.1, 5.0)


def force(live: LiveCalibration) -> np.ndarray:
    """Mean of the last tenth of a second (3,) [N]."""
    ring, channels = live.supervisor.ring, live.supervisor.channels
    rows, _, _ = ring.read(ring.written - 50)
    return channels.of(rows, "force").mean(axis=0)


def test_visits_are_not_runs(live):
    supervisor = live.supervisor
    before = sorted(supervisor.recording.runs.glob("*"))
    live.start("tracker", 0.5)
    moving(live)

    assert supervisor.status().title == "calibrate tracker, pose 1"
    assert supervisor.status().phase in (Phase.APPROACHING, Phase.SETTLING)
    live.abort()
    ended(live, 10.0)
    assert sorted(supervisor.recording.runs.glob("*")) == before


def test_a_station_that_is_not_ready_is_not_calibrated(live):
    live.supervisor.stop()

    with pytest.raises(RefusedError, match="STOPPED"):
        live.start("axes")
    assert live.report is None


def test_axes_are_found_with_the_zero_angles_that_the_lab_hides(live):
    live.start("axes")
    report = ended(live, 150.0)

    assert report.stage is Stage.DONE, report.says
    numbers = Results(live.folder).one(report.result).numbers
    assert set(numbers["signs"].values()) == {1.0}
    bench = live.supervisor.bench
    subject = Subject.of(bench.robot, np.array(bench.park))
    hidden = StillLab(subject, bench.lab, SEED).hidden
    true = np.degrees(hidden.joints(subject.start) - subject.start)[1]
    (found,) = [row for row in numbers["found"] if row["name"] == "inner zero angle"]
    assert float(found["found"]) == pytest.approx(true, abs=1.0)
    joints = live.supervisor.status().values["joints"]
    np.testing.assert_allclose(joints, subject.start, atol=2e-3)  # back where it began


def test_what_a_bench_says_about_its_tracker_is_what_is_assumed(tmp_path):
    assert believed_mount(load_station(None).bench()) is MOUNT
    path = tmp_path / "bench.toml"
    path.write_text(
        """
[devices.stages]
driver = "zaber"
port = "/dev/ttyUSB0"
[devices.tracker]
driver = "aurora"
port = "/dev/ttyUSB1"
mount = { position = [0.1, 0.0, -0.3], rotation_vector = [0.0, 0.0, 1.5707963267948966] }
[devices.sensors]
driver = "netft"
tubes.inner.host = "192.168.1.11"
tubes.outer.host = "192.168.1.12"
""",
        encoding="utf-8",
    )

    found = believed_mount(load_station(path).bench())

    np.testing.assert_allclose(found.position, [0.1, 0.0, -0.3])
    np.testing.assert_allclose(found.rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
