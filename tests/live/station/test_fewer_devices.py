"""A station without force sensors: from start to report."""

from tests.harness.serving import serving

CIRCLE = {"trajectory": {"kind": "circle", "radius": 0.004, "period": 4.0}, "duration": 4.0}


def test_a_station_without_force_sensors_runs_a_circle_and_reports_it() -> None:
    with serving("--without", "sensors") as station:
        station.ready()
        status = station.status()
        assert set(status["devices"]) == {"stages", "tracker"}
        assert status["force"] is not None  # it follows from the deflection
        station.post("/api/operator")
        tare = station.post("/api/tare")
        assert tare.status_code == 409, tare.text
        refused = station.post("/api/start", CIRCLE | {"controller": {"inner": "type_1", "feedback": "tracker"}})
        assert refused.status_code == 422, refused.text
        assert "needs force sensors" in refused.json()["error"]
        run = station.post("/api/start", CIRCLE).json()["run_id"]
        station.wait_for(lambda s: s["phase"] == "moving")
        ended = station.wait_for(lambda s: s["state"] != "RUNNING" and not s["run"]["recording"])
        assert ended["state"] == "READY", ended["cause"]
        procedures = station.rest.get("/api/calibration").json()["offers"]
        offered = {one["name"] for one in procedures if one["missing"] == ""}
        assert offered == {"axes", "latency", "tracker", "tubes", "residual"}
        refused = station.post("/api/calibration/start", {"what": "force", "way_is_clear": True})
        assert refused.status_code == 409, refused.text
        assert "does not have" in refused.json()["error"]
        report = station.rest.get(f"/api/runs/{run}/report")
        assert report.status_code == 200, report.text
