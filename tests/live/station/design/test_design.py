"""The command `design` with real processes, a real Dask cluster, and an interrupted search."""

import importlib.util
import json
import signal
import subprocess
import sys

import pytest

from station.config.robots import load_robot
from tests.harness.waiting import until

STUDY = """title = "short"
[task]
points = [[0.02459, -0.04154, 0.18892], [0.02459, -0.04154, 0.19392]]
forces = [[0.5, 0.0, 0.0]]
dexterity = 0.004
[[parameters]]
key = "inner.sections.2.curvature"
lower = 3.0
upper = 6.0
[search]
population = 6
generations = 2
"""


def command(study, folder, *more):
    return [sys.executable, "-m", "station", "design", str(study), "--out", str(folder), "--json", *more]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "short.toml"
    path.write_text(STUDY)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of the search in one process."""
    return tmp_path_factory.mktemp("here")


@pytest.fixture(scope="module")
def here(study, environment, folder):
    """Return the results of a search in one process."""
    words = command(study, folder, "--jobs", "1")
    return json.loads(subprocess.run(words, env=environment, capture_output=True, check=True).stdout)


def kept(folder):
    lines = (next(folder.iterdir()) / "candidates.jsonl").read_text().splitlines()
    return sorted(lines[1:])


def test_the_robot_found_by_a_design_search_can_be_loaded_and_holds_a_larger_load(here, folder):
    (found,) = folder.iterdir()
    assert here["after"]["largest_force_n"] > here["before"]["largest_force_n"]
    assert here["after"]["exact_away_mm"] < 0.25
    robot = load_robot(str(found / "robot.toml"))
    assert robot.name == "paper-short"
    assert robot.tubes[0].sections[1].curvature[0] == here["parameters"][0]["after"]
    assert (found / "report.html").read_text(encoding="utf-8").count("data:image/svg+xml") == 3


@pytest.mark.parametrize("engine", ["processes", "dask"])
def test_every_engine_of_a_design_search_stores_the_same_candidates(engine, here, folder, study, environment, tmp_path):
    if engine == "dask" and importlib.util.find_spec("distributed") is None:
        pytest.skip("the extra dask is not installed")
    more = ("--scheduler", "local") if engine == "dask" else ()
    words = command(study, tmp_path / engine, "--jobs", "2", *more)
    found = json.loads(subprocess.run(words, env=environment, capture_output=True, check=True).stdout)
    assert kept(tmp_path / engine) == kept(folder)
    assert {**found, "folder": ""} == {**here, "folder": ""}


def test_a_design_search_stopped_by_ctrl_c_can_be_continued(here, folder, study, environment, tmp_path):
    words = command(study, tmp_path / "stopped", "--jobs", "1")
    first = subprocess.Popen(words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        until(lambda: any((tmp_path / "stopped").glob("*/candidates.jsonl")) and len(kept(tmp_path / "stopped")) >= 2)
        first.send_signal(signal.SIGINT)
        assert b"interrupted" in first.communicate()[1]
    finally:
        first.kill()
        first.wait()
    assert first.returncode == 130
    assert 2 <= len(kept(tmp_path / "stopped")) < len(kept(folder))
    found = json.loads(subprocess.run(words, env=environment, capture_output=True, check=True).stdout)
    assert {**found, "folder": ""} == {**here, "folder": ""}
