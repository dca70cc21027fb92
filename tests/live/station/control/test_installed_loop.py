"""A station uses an installed loop by its name, and ends a motion whose loop breaks."""

import os
from collections.abc import Iterator

import pytest

from core.control.controllers import LoopInputs
from core.control.velocity_ik import VelocityTask
from station.config.plugins import Setup
from tests.harness.entry_points import install_entry_points
from tests.harness.serving import Served, serving

CIRCLE = {"kind": "circle", "radius": 0.005, "period": 4.0}


class Breaking:
    """Inner loop that fails after half a second of the loop's time."""

    def __init__(self, setup: Setup) -> None:
        self.dt, self.calls = setup.dt, 0

    def reset(self) -> None:
        self.calls = 0

    def __call__(self, u_int, view: LoopInputs) -> VelocityTask:
        self.calls += 1
        if self.calls * self.dt > 0.5:
            raise ArithmeticError("integral overflow")
        return VelocityTask(view.loaded.jacobian[:3], u_int)


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    site = tmp_path_factory.mktemp("site")
    here = "tests.live.station.control.test_installed_loop"
    install_entry_points(
        site,
        {
            "ctr_station.outer_loops": {"integral": "station.docs.examples.integral_loop.integral_loop:make"},
            "ctr_station.inner_loops": {"breaking": f"{here}:Breaking"},
            "ctr_station.loads": {"saw": "station.docs.examples.saw_load.saw_load:make"},
        },
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]))
        with serving() as station:
            yield station


def start(station: Served, controller: dict[str, object], **more: object) -> str:
    """Start a circle with a controller; return the run's name."""
    station.ready()
    body = {"trajectory": CIRCLE, "controller": {"feedback": "observer", **controller}, "duration": 3.0, **more}
    begun = station.post("/api/start", body)
    assert begun.status_code == 202, begun.text
    return begun.json()["run_id"]


def test_the_page_is_told_the_installed_names(own: Served) -> None:
    rig = own.rest.get("/api/rig").json()
    assert "integral" in rig["strategies"]
    assert "breaking" in rig["inner"]
    assert rig["loads"] == ["saw"]


def test_a_motion_with_an_installed_loop_and_load_completes_twice(own: Served) -> None:
    load = {"kind": "installed", "name": "saw", "options": {"peak": 0.1, "period": 1.0}}
    for _ in range(2):
        controller = {"strategy": "integral", "inner": "type_2", "options": {"integral": {"ki": 1.0}}}
        run = start(own, controller, load=load)
        status = own.wait_for(lambda now: now["state"] != "RUNNING" and not now["run"]["recording"])
        assert status["state"] == "READY", status["cause"]
        details = own.rest.get(f"/api/runs/{run}").json()
        assert details["id"] == run


def test_a_loop_that_breaks_ends_its_motion_in_hold_and_is_named(own: Served) -> None:
    start(own, {"inner": "breaking"})
    status = own.wait_for(lambda now: now["cause"])  # it arrives shortly after the state
    assert status["state"] == "HOLD"
    assert "inner loop 'Breaking' raised ArithmeticError: integral overflow" in status["cause"]
